"""The example that gates pull requests is a workflow, and its commands and files exist."""

import re
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml

from tests.browser import browser
from validation.cli.app import app
from validation.study.sweep.design import load_sweep
from validation.study.sweep.run import task_of

DOCS = Path(__file__).resolve().parents[1] / "docs"
WORKFLOW = DOCS / "examples" / "gate.yml"


@pytest.mark.parametrize(
    ("value", "ends_with"),
    [("", pytest.skip.Exception), ("false", pytest.skip.Exception), ("true", pytest.fail.Exception)],
)
def test_a_missing_browser_is_a_skip_and_under_ci_a_failure(monkeypatch, value, ends_with):
    monkeypatch.setenv("PATH", "")
    monkeypatch.setenv("CI", value)
    with pytest.raises(ends_with, match="apt-get install chromium"):
        browser()


def test_workflow_is_one():
    found: dict[Any, Any] = yaml.safe_load(WORKFLOW.read_text(encoding="utf-8"))
    assert found[True] == {"pull_request": None}  # YAML 1.1 takes `on` for a truth value; no filter
    assert found["permissions"] == {"contents": "read"}
    steps = found["jobs"]["gate"]["steps"]
    assert all(("uses" in step) != ("run" in step) for step in steps)
    makefile = (DOCS.parent / "Makefile").read_text(encoding="utf-8")
    for target in re.findall(r"make -C \w+ (\w+)", WORKFLOW.read_text(encoding="utf-8")):
        assert f"\n{target}:" in makefile


@pytest.mark.parametrize("source", [WORKFLOW, DOCS / "sweeps.md", DOCS / "examples" / "gate.toml"])
def test_commands_exist(source):
    group = typer.main.get_group(app)
    text = re.sub(r"\\\n\s*", " ", source.read_text(encoding="utf-8"))
    found = re.findall(r"(?:^|[\s/`])ampm ([a-z][^|`#\n]*)", text, re.MULTILINE)
    assert found
    for name, *words in (line.split() for line in found):
        command = group.get_command(typer.Context(group), name)
        assert command is not None, name
        options = {option for parameter in command.params for option in parameter.opts}
        assert {word for word in words if word.startswith("--")} <= options, (name, words)


def test_the_sweep_is_small_and_accepted():
    definition = load_sweep(DOCS / "examples" / "gate.toml")
    assert len(definition) == 8
    assert definition.steps in range(13)
    assert all(task_of(definition, run).known is None for run in range(8))

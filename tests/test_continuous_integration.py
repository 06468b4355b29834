"""The example that gates pull requests: valid, its commands exist, and its steps do what the page says."""

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml

from tests.browser import browser
from tests.sweep_table import make_table, replaced, write_sweep
from validation.cli.app import app
from validation.study.sweep.design import load_sweep
from validation.study.sweep.run import task_of

DOCS = Path(__file__).resolve().parents[1] / "docs"
WORKFLOW = DOCS / "examples" / "gate.yml"
PAGE = DOCS / "sweeps.md"


def workflow() -> dict[Any, Any]:
    return yaml.safe_load(WORKFLOW.read_text(encoding="utf-8"))


def scripts() -> dict[str, str]:
    """Shell text of every step that has one, by name."""
    return {step["name"]: step["run"] for step in workflow()["jobs"]["gate"]["steps"] if "run" in step}


def commands(text: str) -> list[list[str]]:
    """Words of every ``ampm`` command in shell text."""
    joined = re.sub(r"\\\n\s*", " ", text)
    found = re.findall(r"(?:^|[\s/`])ampm ([a-z][^|`#\n]*)", joined, re.MULTILINE)
    return [line.split() for line in found]


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
    found = workflow()
    triggers = found.get("on", found.get(True)) or {}  # YAML 1.1 takes `on` for a truth value
    assert "pull_request" in triggers
    assert not triggers["pull_request"]  # a filter would leave a required check pending
    assert found["permissions"] == {"contents": "read"}
    job = found["jobs"]["gate"]
    assert job["timeout-minutes"] <= 60
    assert all(("uses" in step) != ("run" in step) for step in job["steps"])
    uses = [step["uses"] for step in job["steps"] if "uses" in step]
    assert all(re.fullmatch(r"actions/[\w-]+@v\d+", name) for name in uses)
    paths = [step["with"]["path"] for step in job["steps"] if "checkout" in step.get("uses", "")]
    assert paths == ["head"]
    guarded = [step for step in job["steps"] if step.get("if") == "steps.changes.outputs.walk == 'true'"]
    free = [step.get("name") for step in job["steps"] if "if" not in step]
    assert len(guarded) == 6
    assert free == ["Check out the pull request, as merged", "See whether a walk can change"]


@pytest.mark.parametrize("source", [WORKFLOW, PAGE, DOCS / "examples" / "gate.toml"])
def test_commands_exist(source):
    group = typer.main.get_group(app)
    context = typer.Context(group)
    found = commands(source.read_text(encoding="utf-8"))
    assert found
    for name, *words in found:
        command = group.get_command(context, name)
        assert command is not None, name
        options = {option for parameter in command.params for option in parameter.opts}
        assert {word for word in words if word.startswith("--")} <= options, (name, words)


def test_files_that_it_names_exist():
    root = DOCS.parent
    for name in re.findall(r"head/((?:[\w-]+/)+[\w.-]+\.toml)", WORKFLOW.read_text(encoding="utf-8")):
        assert (root / name).is_file()
    makefile = (root / "Makefile").read_text(encoding="utf-8")
    for target in re.findall(r"make -C \w+ (\w+)", "\n".join(scripts().values())):
        assert f"\n{target}:" in makefile


def test_the_sweep_is_small_and_accepted():
    definition = load_sweep(DOCS / "examples" / "gate.toml")
    assert len(definition) == 8
    assert definition.steps <= 12
    assert all(task_of(definition, run).known is None for run in range(8))


# ------------------------------------------------------------------------------- the steps, walked through


@pytest.fixture
def workspace(tmp_path):
    """Two checkouts whose ``ampm sweep`` lays a prepared sweep down; everything else is the real thing."""
    vary = {"gait.c_s": (0.9, 1.1), "gait.c_y": (0.8, 1.1)}
    table = make_table(8, vary=vary, failures=False)
    write_sweep(tmp_path / "prepared" / "good", table)
    worse = replaced(table, "outcome", ["fell", *["completed"] * 7])
    worse = replaced(worse, "verdict", ["not_measured", *table.column("verdict").to_pylist()[1:]])
    write_sweep(tmp_path / "prepared" / "worse", worse)
    merge(tmp_path / "head", "validation/run/validate.py")
    for side in ("head", "base"):
        folder = tmp_path / side / ".venv" / "bin"
        folder.mkdir(parents=True)
        script = folder / "ampm"
        script.write_text(
            "#!/bin/bash\n"
            'if [ "$1" = sweep ]; then\n'
            f'  mkdir -p sweeps && cp -r "prepared/${{{side}_sweep}}" "$4" && exit "${{{side}_status:-0}}"\n'
            "fi\n"
            f'exec "{sys.executable}" -m validation.cli "$@"\n',
            encoding="utf-8",
        )
        script.chmod(0o755)
    return tmp_path


def merge(folder: Path, changed: str) -> None:
    """Make a checkout of a merge that changes one file, as far back as the workflow fetches it."""
    git = ["git", "-C", str(folder), "-c", "user.name=A", "-c", "user.email=a@example.org"]

    def run(*words: str) -> None:
        subprocess.run([*git, *words], check=True, capture_output=True, timeout=60)

    folder.mkdir()
    run("init", "--quiet", "--initial-branch=main")
    for name in ("validation/run/validate.py", "docs/sweeps.md", "README.md", changed):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("before\n", encoding="utf-8")
        run("add", name)
    run("commit", "--quiet", "--message", "base")
    run("checkout", "--quiet", "-b", "change")
    (folder / changed).write_text("after\n", encoding="utf-8")
    run("commit", "--quiet", "--all", "--message", "change")
    run("checkout", "--quiet", "main")
    run("merge", "--quiet", "--no-ff", "--message", "merge", "change")


@pytest.mark.parametrize(
    ("changed", "walked"),
    [
        ("validation/run/validate.py", True),
        ("docs/examples/gate.toml", True),
        (".github/workflows/gate.yml", True),
        ("docs/sweeps.md", False),
        ("docs/images/map.svg", False),
        ("README.md", False),
    ],
)
def test_what_is_walked(tmp_path, changed, walked):
    merge(tmp_path / "head", changed)
    output, summary = tmp_path / "output.txt", tmp_path / "summary.md"
    summary.touch()
    env = {**os.environ, "GITHUB_OUTPUT": str(output), "GITHUB_STEP_SUMMARY": str(summary)}
    script = ["bash", "-eo", "pipefail", "-c", scripts()["See whether a walk can change"]]
    subprocess.run(script, cwd=tmp_path, env=env, check=True, timeout=60)
    assert output.read_text(encoding="utf-8").split() == [f"walk={str(walked).lower()}"]
    assert ("nothing is walked" in summary.read_text(encoding="utf-8")) is not walked
    if walked:
        checkout = ["bash", "-e", "-c", scripts()["Check out the branch that it goes into"]]
        subprocess.run(checkout, cwd=tmp_path, env=env, check=True, capture_output=True, timeout=60)
        assert (tmp_path / "base" / changed).read_text(encoding="utf-8") == "before\n"


def walk_through(workspace: Path, **environment: str) -> tuple[dict[str, int], str]:
    """Run the steps as the runner would: a failed one skips those after it that are not for ``always()``."""
    summary, output = workspace / "summary.md", workspace / "output.txt"
    summary.touch()
    output.touch()
    root = DOCS.parent
    env = {
        **os.environ, **environment, "GITHUB_STEP_SUMMARY": str(summary), "GITHUB_OUTPUT": str(output),
        "PYTHONPATH": str(root),
    }  # fmt: skip
    statuses: dict[str, int] = {}
    for step in workflow()["jobs"]["gate"]["steps"]:
        if "run" not in step or "make " in step["run"] or "worktree" in step["run"]:
            continue
        when = step.get("if", "")
        if any(statuses.values()) and when != "always()":
            continue
        if "outputs.walk" in when and "walk=true" not in output.read_text(encoding="utf-8"):
            continue
        done = subprocess.run(
            ["bash", "--noprofile", "--norc", "-eo", "pipefail", "-c", step["run"]],
            cwd=workspace, env=env, capture_output=True, text=True, timeout=120, check=False,
        )  # fmt: skip
        statuses[step["name"]] = done.returncode
    return statuses, summary.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("base", "head", "failed", "said"),
    [
        ("good 0", "good 0", [], "No regression in 8 matched runs."),
        ("good 0", "worse 3", ["Compare"], "Regression in 8 matched runs: 1 newly failing."),
        ("worse 3", "worse 3", [], "No regression in 8"),  # a base that fails already does not matter
        ("good 0", "good 5", ["Sweep the pull request"], ""),  # it did not run
    ],
)
def test_the_job_fails_on_a_regression(workspace, base, head, failed, said):
    words = zip(("sweep", "status"), zip(base.split(), head.split(), strict=True), strict=True)
    given = {f"{side}_{name}": pair[i] for name, pair in words for i, side in enumerate(("base", "head"))}
    statuses, summary = walk_through(workspace, **given)
    assert [name for name, status in statuses.items() if status] == failed
    assert summary.startswith(said)
    assert bool(summary) == bool(said)
    assert (workspace / "sweeps" / "both" / "report.html").is_file() == bool(said)
    assert ("Compare" in statuses) == bool(said)

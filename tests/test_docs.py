"""The examples of README.md, docs/ and examples/ are run: Python by default, command lines in the slow run.

A block of TOML or Python whose first line is a comment with a file's name is written to that file. All blocks
of a page share one folder and one namespace, in their order.
"""

import ast
import csv
import math
import os
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
import yaml

import ampm
import validation
from ampm.planner.routes import TOE_OUT
from examples import tour
from validation.cli.app import app
from validation.study.sweep.design import load_sweep
from validation.study.sweep.run import task_of

ROOT = Path(__file__).resolve().parents[1]
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "docs/howto").glob("*.md")),
]
PLANNERS = sorted((ROOT / "examples/planners").glob("*.py"))
DRAWING = [path for path in PLANNERS if path.stem in ("capture", "mpc")]
EXAMPLES = [*sorted((ROOT / "examples").glob("*.py")), *DRAWING]
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
INDENTED = re.compile(r"^    (ampm (?:.+\\\n)*.+)$", re.MULTILINE)
FILE = re.compile(r"# ([\w.-]+\.(?:toml|py))\b")
PLACEHOLDER = re.compile(r"\b[A-Z]{1,}\b")
"""Stands for a name in a command: such a command is parsed, not run."""


def blocks(page: Path) -> list[tuple[str, str]]:
    return BLOCK.findall(page.read_text(encoding="utf-8"))


def commands(page: Path, *programs: str) -> list[str]:
    """Command lines of the page that call one of some programs, without their comments."""
    lines = [line for language, text in blocks(page) if language == "sh" for line in text.splitlines()]
    return [line.partition(" #")[0].strip() for line in lines if line.split(" ")[0] in programs]


def write_files(page: Path, folder: Path) -> None:
    for _, text in blocks(page):
        if found := FILE.match(text):
            folder.joinpath(found[1]).write_text(text, encoding="utf-8")
    if "docs/examples/biped.urdf" in page.read_text(encoding="utf-8"):  # the page asks for a copy
        shutil.copy(ROOT / "docs/examples/biped.urdf", folder)


def run(folder: Path, *command: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "MUJOCO_GL": "disable"}
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)


WITH_PYTHON = [page for page in PAGES if any(language == "python" for language, _ in blocks(page))]
WITH_COMMANDS = [page for page in PAGES if commands(page, "ampm")]


LONG = "log own-controller footsteps sweeps measurement architecture run own-robot report recording".split()
"""Pages whose Python takes more than five seconds; that of README and tutorial runs always."""
LONG_EXAMPLES = ("05_sweep", "07_policy", "capture", "mpc")


def by_name(paths, long):
    """Parameters of a test, those marked as slow that take long."""
    marks = {True: [pytest.mark.slow], False: []}
    return [pytest.param(path, marks=marks[path.stem in long], id=path.stem) for path in paths]


@pytest.mark.parametrize("page", by_name(WITH_PYTHON, LONG))
def test_python_runs(page, tmp_path):
    write_files(page, tmp_path)
    code = "\n".join(text for language, text in blocks(page) if language == "python" and not FILE.match(text))
    answer = run(tmp_path, sys.executable, "-c", code)
    assert answer.returncode == 0, answer.stderr
    tests = sorted(tmp_path.glob("test_*.py"))
    if tests:
        options = "-m pytest -q -p no:cacheprovider".split()
        answer = run(tmp_path, sys.executable, *options, *map(str, tests))
        assert answer.returncode == 0, answer.stdout


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_lead_to_files_of_the_repository(page):
    """Links are read as on its web page; `make docs` checks those of the site."""
    text = BLOCK.sub("", page.read_text(encoding="utf-8"))
    paths = [link.partition("#")[0] for link in re.findall(r"\]\((?!\w+:)([^)\s]+)\)", text)]
    assert not [path for path in paths if not (page.parent / path).exists()]


def assert_parses(line):
    group: Any = typer.main.get_command(app)
    name, *arguments = shlex.split(line.partition("|")[0])[1:]
    command = group.get_command(None, name)
    assert command is not None, line
    command.make_context(name, arguments)


@pytest.mark.parametrize("page", WITH_COMMANDS, ids=lambda page: page.stem)
def test_commands_parse(page):
    indented = [line.partition(" #")[0] for line in INDENTED.findall(page.read_text(encoding="utf-8"))]
    for line in (*commands(page, "ampm"), *indented):
        assert_parses(line)


@pytest.mark.slow
@pytest.mark.parametrize("page", WITH_COMMANDS, ids=lambda page: page.stem)
def test_commands_run(page, tmp_path):
    """Each ends with a verdict, never with bad input or a crash."""
    write_files(page, tmp_path)
    for line in commands(page, "ampm", "python", "pytest"):
        if not PLACEHOLDER.search(line) and not line.startswith("ampm view"):
            program, _, rest = line.partition(" ")
            command = f"{sys.executable} {'' if program == 'python' else f'-m {program}'} {rest}"
            answer = run(tmp_path, "sh", "-c", command)
            assert answer.returncode in (0, 1), f"{line}\n{answer.stderr}"


@pytest.mark.parametrize("example", by_name([p for p in EXAMPLES if p.stem != "tour"], LONG_EXAMPLES))
def test_examples_print_and_save_a_picture(example, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(example), run_name="__main__")
    assert capsys.readouterr().out.strip()
    picture = tmp_path / f"{example.stem.lstrip('0123456789_')}.png"
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert example in PLANNERS or (ROOT / "docs/images" / picture.name).is_file()


def test_scripts_of_the_pages_import_what_there_is():
    for path in (ROOT / "docs").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and str(node.module).startswith(("ampm", "validation")):
                exec(ast.unparse(node))


def test_the_planner_of_the_tutorial_is_that_of_the_examples():
    text = next(text for _, text in blocks(ROOT / "docs/tutorial.md") if text.startswith("# lipm.py"))
    planner = text[text.index("GRAVITY") : text.index("if __name__")].strip()
    assert planner in (ROOT / "examples/03_own_planner.py").read_text(encoding="utf-8")


def test_the_reference_has_every_public_name():
    packages = {"ampm": ampm, "val": validation}
    reference = (ROOT / "docs/api.md").read_text(encoding="utf-8").replace("::: validation.", "::: val.")
    listed = set(re.findall(r"^::: (\S+)", reference, re.MULTILINE))
    public = {f"{short}.{name}" for short, package in packages.items() for name in package.__all__}
    assert listed == public


def test_the_columns_of_a_sweep_are_those_of_the_page():
    rows = runpy.run_path(str(ROOT / "docs/sweeps.py"))["rows"]()
    with (ROOT / "docs/data/sweep-columns.csv").open(encoding="utf-8") as file:
        assert [tuple(row) for row in csv.reader(file)] == rows


def test_a_short_tour_is_walked_to_its_target_and_kept(tmp_path, monkeypatch):
    options = "normal", ["simulation.time_step=0.002"], 1, 1, 0.0, 0, tmp_path
    [found] = tour.walk_tours(*options)
    assert (found["outcome"], found["reached"], found["cause"]) == ("completed", 1, "")
    assert found["time"] == pytest.approx(found["planned"], abs=0.01)
    assert found["error"] < 2e-3
    monkeypatch.delattr(tour, "simulate")  # nothing is walked again
    assert tour.walk_tours(*options, resume=True) == [found]


@pytest.mark.parametrize("seed", range(3))
def test_steps_to_targets_stand_at_them_and_go_no_farther_aside_or_turn_more_than_they_may(seed):
    generator = np.random.default_rng(seed)
    targets = [tuple(generator.uniform(-1.5, 1.5, 3).tolist()) for _ in range(8)]
    length, width, aside, most = 0.16, 0.28, 0.06, 0.4
    footsteps = tour.visit(targets, length, width, aside, most)
    side = np.array([1.0 if step.foot == "left" else -1.0 for step in footsteps])
    heading = np.array([step.heading for step in footsteps]) - side * TOE_OUT
    turn = np.remainder(np.diff(heading) + np.pi, 2.0 * np.pi) - np.pi
    assert np.abs(turn).max() <= most + 1e-9
    to_left = np.stack([-np.sin(heading), np.cos(heading)], axis=1)
    middle = np.array([step.position[:2] for step in footsteps]) - 0.5 * width * side[:, None] * to_left
    between = 0.5 * (middle[1:] + middle[:-1])
    for x, y, _ in targets:
        assert np.hypot(*(between - (x, y)).T).min() < 1e-9
    way = np.diff(middle, axis=0)
    left = (way * to_left[:-1]).sum(axis=1)
    assert np.hypot(*way.T).max() <= math.hypot(length, aside) + 1e-9
    assert (side[1:] * left).max() <= aside + 1e-9
    fewer = tour.visit(targets, 2.0 * length, width, 2.0 * aside, most)
    assert len(fewer) < len(footsteps)


DOCS = ROOT / "docs"
WORKFLOW = DOCS / "examples" / "gate.yml"


def test_workflow_is_one():
    text = WORKFLOW.read_text(encoding="utf-8")
    found: dict[Any, Any] = yaml.safe_load(text)
    assert found[True] == {"pull_request": None}  # YAML 1.1 takes `on` for a truth value; no filter
    assert found["permissions"] == {"contents": "read"}
    steps = found["jobs"]["gate"]["steps"]
    assert all(("uses" in step) != ("run" in step) for step in steps)
    for target in re.findall(r"make -C \w+ (\w+)", text):
        assert f"\n{target}:" in (ROOT / "Makefile").read_text(encoding="utf-8")
    for line in re.findall(r"bin/(ampm [^|\n]*)", re.sub(r"\\\n\s*", " ", text)):
        assert_parses(line)


def test_the_sweep_is_small_and_accepted():
    definition = load_sweep(DOCS / "examples" / "gate.toml")
    assert len(definition) == 8
    assert definition.steps in range(13)
    assert all(task_of(definition, run).known is None for run in range(8))

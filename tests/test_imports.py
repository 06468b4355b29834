"""Imports point one way: `ampm` never sees a simulator, its planner not even Pinocchio."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def loaded_by(statement: str) -> set[str]:
    """Top-level modules that a fresh interpreter holds after a statement."""
    code = f"{statement}\nimport sys\nprint(*sorted({{name.split('.')[0] for name in sys.modules}}))"
    answer = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT
    )
    return set(answer.stdout.split())


def modules(package: str) -> list[str]:
    return sorted(
        ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        for path in (ROOT / package).rglob("*.py")
    )


def imported_packages(package: str) -> set[str]:
    """Top-level names that any module of a package imports, at any depth of its code."""
    names: set[str] = set()
    for path in (ROOT / package).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                names.update(alias.name.split(".")[0] for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
                names.add(node.module.split(".")[0])
    return names


def test_the_whole_of_ampm_leaves_the_simulator_unloaded():
    loaded = loaded_by("import " + ", ".join(modules("ampm")))
    assert not loaded & {"mujoco", "dm_control", "models", "validation", "benchmarks"}


def test_the_planner_needs_no_body_library():
    loaded = loaded_by("import ampm.parameters, ampm.planner.gait, ampm.planner.feet, ampm.body.feasibility")
    assert not loaded & {"pinocchio", "osqp", "daqp", "scipy", "mujoco"}


@pytest.mark.parametrize(
    ("package", "forbidden"),
    [
        ("ampm", {"mujoco", "dm_control", "models", "validation", "benchmarks", "tests", "rerun", "pyarrow"}),
        ("models", {"validation", "benchmarks", "tests", "pinocchio", "osqp"}),
        ("validation", {"benchmarks", "tests"}),
    ],
)
def test_imports_point_one_way(package, forbidden):
    assert not imported_packages(package) & forbidden


@pytest.mark.parametrize("module", ["validation.measure.measure", "validation.trial.record"])
def test_measurement_cannot_see_the_plan(module):
    path = ROOT.joinpath(*module.split(".")).with_suffix(".py")
    seen = {
        node.module if isinstance(node, ast.ImportFrom) else alias.name
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Import | ast.ImportFrom)
        for alias in node.names
    }
    assert not {
        name
        for name in seen
        if name and name.startswith(("ampm.planner.gait", "ampm.planner.pendulum", "ampm.body.motion"))
    }


def test_a_run_without_a_recording_loads_no_drawing():
    loaded = loaded_by(
        "import validation.run.validate, validation.judge.examine, validation.trial.plan, "
        "validation.study.sweep.work"
    )
    assert not loaded & {"rerun", "matplotlib"}


def test_the_schema_of_a_sweep_needs_no_simulator():
    loaded = loaded_by("from validation.measure.instruments import INSTRUMENT_COLUMNS, load_instrument")
    assert not loaded & {"mujoco", "pinocchio", "scipy", "rerun", "matplotlib"}


def test_only_the_simulation_side_owns_simulator_data():
    owners = {
        path.relative_to(ROOT).as_posix()
        for package in ("ampm", "models", "validation")
        for path in (ROOT / package).rglob("*.py")
        if "MjData(" in path.read_text(encoding="utf-8")
    }
    assert owners <= {
        "validation/trial/simulate.py",
        "validation/run/replay.py",
        "validation/show/rerun/record.py",
    }


def test_public_names_exist():
    import ampm

    for name in ampm.__all__:
        assert hasattr(ampm, name)

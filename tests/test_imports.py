"""Imports point one way: from room to room in order, without a circle, and `ampm` never sees a simulator."""

import ast
import subprocess
import sys
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

ORDER = {
    "ampm": (
        "exceptions files brief lazy presets geometry compiled vectors linear description qp section "
        "physics_parameters controller_parameters sensor_parameters "
        "parameters run_file planner reference walk body sensors control+stepping planners tune __main__"
    ).split(),
    "validation": (
        "output progress table trial store measure judge show run study cli environment pytest_plugin"
    ).split(),
}
"""Rooms of a package, each of which may import itself and those before it. The package itself comes last.

The tick calls the stabiliser that steps, which reads the workspace of the tick: the two rooms are one place.
"""


@cache
def imports(*packages: str) -> dict[str, set[str]]:
    """Modules and packages that each module of some packages imports, at any depth of its code."""
    files = [path for package in packages for path in (ROOT / package).rglob("*.py")]
    names = [".".join(path.relative_to(ROOT).with_suffix("").parts) for path in files]
    paths = {name.removesuffix(".__init__"): path for name, path in zip(names, files, strict=True)}
    found: dict[str, set[str]] = {}
    for name, path in paths.items():
        seen = found.setdefault(name, set())
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                seen.update(alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
                members = {f"{node.module}.{alias.name}" for alias in node.names}
                # What a package's own file re-exports counts as an import of the package.
                seen.update(members & paths.keys() or {node.module})
        seen.discard(name)
    return found


@pytest.mark.parametrize("package", ORDER)
def test_rooms_import_in_order_and_without_a_circle(package):
    order = {name: place for place, names in enumerate(ORDER[package]) for name in names.split("+")}
    order[""] = len(order)
    known = imports(package)
    inside = {name: others & known.keys() for name, others in known.items()}
    room = {name: [*name.split("."), ""][1] for name in known}
    assert set(room.values()) <= order.keys(), "a room without a place in the order"
    wrong = [
        f"{name} imports {other}"
        for name, others in inside.items()
        for other in others
        if order[room[other]] > order[room[name]]
    ]
    assert wrong == []
    TopologicalSorter(inside).prepare()  # raises CycleError, which names the modules


PLAN = """
import ampm, ampm.body.feasibility
loading = {'FootstepPlanner', 'PeriodicPlanner', 'TablePlanner', 'TrackingController', 'make_plan'}
[getattr(ampm, name) for name in ampm.__all__ if name not in loading]
run = ampm.load_run('momentum', gait={'c_y': 0.6, 'steps': 10})
assert ampm.plan(run).sample([0.1, 0.2]).zmp.shape == (2, 2)
"""
MEASUREMENT = "validation.measure.measure, validation.measure.log"
BLIND = "ampm.planner.periodic ampm.planner.pendulum ampm.planner.feet ampm.body.motion".split()
BLIND += "mujoco dm_control pydrake models".split()
"""Nothing that measures a walk loads these."""
TRIAL = "validation.run.validate, validation.run.walk, validation.trial.plan, validation.study.sweep.run"


@pytest.mark.parametrize(
    ("statement", "forbidden"),
    [
        ("import " + ", ".join(imports("ampm")), "mujoco dm_control models validation benchmarks"),
        (PLAN, "pinocchio osqp scipy mujoco numba"),
        ("import validation.cli.app", "numpy mujoco pinocchio pyarrow pydantic rerun numba"),
        ("import ampm.planners, models.human", "osqp scipy numba dm_control"),
        (f"import {TRIAL}, validation.show.report, validation.study.compare.report", "rerun matplotlib"),
        (f"import {MEASUREMENT}", " ".join(BLIND)),
        ("import ampm, validation", "numpy mujoco pinocchio scipy matplotlib rerun rich typer pyarrow numba"),
        ("import validation.pytest_plugin", "numpy mujoco pinocchio pyarrow pydantic cloudpickle"),
    ],
    ids="ampm,planner,command line,known motion,trial,measurement,public API,pytest plugin".split(","),
)
def test_what_is_not_needed_is_not_loaded(statement, forbidden):
    code = f"{statement}\nimport sys\nprint(*sys.modules)"
    end = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert not set(end.stdout.split()) & set(forbidden.split())


@pytest.mark.parametrize(
    ("name", "forbidden"),
    [
        ("ampm", "mujoco dm_control models validation benchmarks tests rerun pyarrow"),
        ("models", "validation benchmarks tests pinocchio osqp"),
        ("validation", "benchmarks tests"),
        *((module, " ".join(BLIND)) for module in MEASUREMENT.split(", ")),
    ],
)
def test_imports_point_one_way_even_in_functions(name, forbidden):
    of = [others for module, others in imports(name.split(".")[0]).items() if module.startswith(name)]
    found = {part for others in of for other in others for part in (other, other.split(".")[0])}
    assert found
    assert not found & set(forbidden.split())

"""Imports point one way: from room to room in order, without a circle, and `ampm` never sees a simulator."""

from __future__ import annotations

import ast
import subprocess
import sys
from graphlib import TopologicalSorter
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

ORDER = {
    "ampm": (
        "exceptions geometry so3 description qp section parameters run_file planner walk body control "
        "planners tune __main__"
    ).split(),
    "validation": "progress trial store measure judge show run study paper cli".split(),
}
"""Rooms of a package, each of which may import itself and those before it. The package itself comes last."""


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


def module_name(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def imports(package: str) -> dict[str, set[str]]:
    """Modules of the same package that each module imports, at any depth of its code."""
    known = {module_name(path): path for path in (ROOT / package).rglob("*.py")}
    found: dict[str, set[str]] = {}
    for name, path in known.items():
        seen = found.setdefault(name, set())
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                seen.update(alias.name for alias in node.names if alias.name in known)
            elif isinstance(node, ast.ImportFrom) and node.module in known:
                members = {f"{node.module}.{alias.name}" for alias in node.names}
                # What a package's own file re-exports counts as an import of the package.
                seen.update(members & known.keys() or {node.module})
        seen.discard(name)
    return found


@pytest.mark.parametrize("package", ORDER)
def test_rooms_import_in_order(package):
    order = [*ORDER[package], ""]
    room = {name: [*name.split("."), ""][1] for name in imports(package)}
    assert set(room.values()) <= set(order), "a room without a place in the order"
    wrong = [
        f"{name} imports {other}"
        for name, others in imports(package).items()
        for other in others
        if order.index(room[other]) > order.index(room[name])
    ]
    assert wrong == []


@pytest.mark.parametrize("package", ORDER)
def test_no_circle_of_imports(package):
    TopologicalSorter(imports(package)).prepare()  # raises CycleError, which names the modules


def test_the_whole_of_ampm_leaves_the_simulator_unloaded():
    loaded = loaded_by("import " + ", ".join(modules("ampm")))
    assert not loaded & {"mujoco", "dm_control", "models", "validation", "benchmarks"}


def test_the_planner_needs_no_body_library():
    loaded = loaded_by(
        "import ampm, ampm.body.feasibility\nloading = {'AmpmPeriodic', 'WalkRequest'}\n"
        "[getattr(ampm, name) for name in ampm.__all__ if name not in loading]\n"
        "run = ampm.load_run('momentum', gait={'c_y': 0.6, 'steps': 10})\n"
        "assert ampm.plan(run).sample([0.1, 0.2]).zmp.shape == (2, 2)"
    )
    assert not loaded & {"pinocchio", "osqp", "daqp", "scipy", "mujoco"}


def test_the_command_line_starts_without_numbers():
    assert not loaded_by("import validation.cli.app") & {"numpy", "mujoco", "pinocchio", "pyarrow", "rerun"}


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
        if name and name.startswith(("ampm.planner.periodic", "ampm.planner.pendulum", "ampm.body.motion"))
    }


def test_a_run_without_a_recording_loads_no_drawing():
    loaded = loaded_by(
        "import validation.run.validate, validation.run.walk, validation.trial.plan, "
        "validation.study.sweep.task"
    )
    assert not loaded & {"rerun", "matplotlib"}


def uncommented_imports(path: Path) -> list[int]:
    """Lines of imports inside functions, with no comment on the line or above their group."""
    text = path.read_text(encoding="utf-8")
    tree, lines = ast.parse(text), text.splitlines()
    found: dict[int, int] = {}  # first line to last line
    for function in ast.walk(tree):
        if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef):
            inner = [node for node in ast.walk(function) if isinstance(node, ast.Import | ast.ImportFrom)]
            found |= {node.lineno: node.end_lineno or node.lineno for node in inner}
    wrong, good_until = [], -1
    for first, last in sorted(found.items()):
        above = next((n for n in range(first - 2, -1, -1) if lines[n].strip()), 0)
        good = (
            any("# " in line.replace("# noqa", "") for line in lines[first - 1 : last])
            or lines[above].lstrip().startswith("# ")
            or above + 1 == good_until
        )
        if good:
            good_until = last
        else:
            wrong.append(first)
    return wrong


@pytest.mark.parametrize("package", ORDER)
def test_imports_in_functions_give_their_reason(package):
    wrong = {
        module_name(path): lines
        for path in (ROOT / package).rglob("*.py")
        if "cli" not in path.parts and (lines := uncommented_imports(path))
    }
    assert wrong == {}


def test_the_schema_of_a_sweep_needs_no_simulator():
    loaded = loaded_by("import validation.measure.instruments.model, validation.measure.instruments.names")
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
        "validation/trial/shapes.py",
        "validation/show/rerun/record.py",
    }


@pytest.mark.parametrize("package", ORDER)
def test_public_names_exist(package):
    module = import_module(package)
    assert all(hasattr(module, name) for name in module.__all__)


def test_the_public_api_is_imported_as_it_is_used():
    heavy = {"numpy", "mujoco", "pinocchio", "scipy", "matplotlib", "rerun", "rich", "typer", "pyarrow"}
    assert not loaded_by("import ampm, validation") & heavy

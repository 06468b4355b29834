"""A robustness study: ladders, replicas, tables, and short walks of its own."""

import json
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import ampm as planner
from tests.solved import walk_of
from validation.cli.app import Status
from validation.study.robustness import study as robustness
from validation.study.robustness.cells import Cell, chosen, other_cells, push_cells, push_instant
from validation.study.robustness.study import CellResult, Robustness, climb, disturbance_of, needed
from validation.study.row_file import read_rows

FRICTION = Cell("friction", "disturbance.friction_factor", (0.8, 0.6, 0.4, 0.2))
FELL = "fell: the trunk leaned 60 degrees off the reference at 3 s; the first sign was it"


def row(cause=""):
    return {"outcome": "fell" if cause else "completed", "cause": cause}


def climbed(cell, replicas, answer):
    """Result of a cell whose walks are answered by a function of value and replica, and what was walked."""
    walked: list[tuple[float, int]] = []

    def walk(*place):
        walked.append(place)
        return answer(*place)

    found = climb(cell, replicas, walk)
    return CellResult(cell, found["survived"], found["cause"]), walked


def test_values_are_climbed_until_too_many_replicas_failed():
    def answer(value, replica):
        return row("" if (value > 0.5 and replica) or value > 0.7 else FELL)

    found, walked = climbed(FRICTION, 5, answer)
    assert [value for value, _ in walked] == [0.8] * 5 + [0.6] * 5 + [0.4] * 2  # the rest need not be walked
    assert (found.survived, found.cause) == (0.6, FELL)
    assert found.row()[2:] == ("0.6", "fell: the trunk leaned 60 degrees off the reference")
    every, _ = climbed(FRICTION, 1, lambda value, replica: row())
    assert every.row()[2] == "0.2 (all tried)"
    none, walked = climbed(FRICTION, 3, lambda value, replica: row(FELL))
    assert (none.survived, none.cause, len(walked)) == (None, FELL, 1)
    assert none.row()[2] == "none from 0.8 on"
    broken = climb(FRICTION, 1, lambda value, replica: row("broke") | {"outcome": "crashed"})
    assert (broken["outcome"], broken["crashes"]) == ("crashed", ["0.8: broke"])
    assert [needed(n) for n in (1, 2, 3, 5, 10)] == [1, 2, 3, 4, 8]


def test_the_table():
    """Every push of 0.4 m/s and less is survived, and every slope."""
    cells = [*push_cells(quick=True), Cell("up", "disturbance.slope_along", (math.radians(1.0),))]
    results = [climbed(cell, 1, lambda value, _: row("" if abs(value) <= 0.4 else FELL))[0] for cell in cells]
    found = Robustness("normal", "ampm", "human", "ampm", 1, tuple(results))
    (table,) = found.tables()
    assert len(table.rows) == 2 * 2 * 4 + 1
    cause = "fell: the trunk leaned 60 degrees off the reference"
    assert table.rows[0] == ("com early forward", "m/s", "0.4", cause)
    assert table.rows[-1] == ("up", "degrees", "1 (all tried)", "")


def test_the_cells_cover_all_pushes_and_all_keys():
    pushes, others = push_cells(), other_cells()
    assert len({cell.name for cell in (*pushes, *others)}) == len(pushes) + len(others)
    assert len(pushes) == 2 * 4 * 4
    known = set(planner.load_run(None).disturbance.model_dump())
    apart = {"seed", "start_velocity", "step_number", "mass_segment"}
    assert known - {cell.kind for cell in others} == apart | {name for name in known if name[:5] == "push_"}
    assert len(chosen(others, ["mass_change"])) == 2
    for cell in others:
        sizes = [abs(value - ("factor" in cell.key)) for value in cell.values]
        assert sizes == sorted(sizes)
        assert cell.unit != "rad" or max(sizes) < 0.5


def test_a_replica_has_the_momentum_of_its_push_and_a_seed_of_its_own():
    walk = walk_of("gait.steps=7")
    planned: Any = SimpleNamespace(plan=walk.plan)
    for seed in (0, 3):
        run = walk.run.replace(disturbance_of(push_cells()[0], 0.5, seed, planned))
        push = run.disturbance
        momentum = np.hypot(push.push_x, push.push_y) * push.push_duration
        assert momentum == pytest.approx(0.5 * walk.plan.mass)
        assert (push.seed, run.sensors.seed, push.start_velocity > 0.0) == (seed, seed, seed > 0)


def test_pushes_and_others_are_walked_and_a_study_goes_on(tmp_path, monkeypatch, ampm):
    """A push that no body survives, and little friction over three steps."""
    push = next(cell for cell in push_cells() if cell.name == "chest early narrower")
    cells = (Cell(push.name, push.key, (2.0,), push.direction, push.phase, push.height),)
    monkeypatch.setattr(robustness, "push_cells", lambda quick=False: cells)
    monkeypatch.setattr(robustness, "STEPS", 3)
    only, settings = ("pushes", "friction_factor"), ("simulation.time_step=0.002", "gait.steps=3")
    options = {"only": only, "quick": True, "replicas": 1, "workers": 0, "out": tmp_path}
    found = robustness.robustness("normal", settings, **options)
    thrown, slid = found.cells
    assert thrown.survived is None
    assert thrown.cause.startswith(("fell: ", "diverged: "))
    assert slid.survived in (0.25, 0.5)
    assert found.walked == robustness.gait_and_body(planner.load_run("normal"))
    assert [row["survived"] for row in read_rows(tmp_path)] == [None, slid.survived]
    assert json.loads((tmp_path / robustness.ROBUSTNESS_FILE).read_text()) == found.as_dict()
    told = ["--quick", "--replicas=1", "--workers=0"]
    stood = ampm("robustness", "--planner=none", "--set=command.duration=1.2", "--only=delay", *told)
    assert (stood.status, "gait.steps" in stood.err) == (Status.PASS, False)
    monkeypatch.setattr("validation.study.pool.attempt", lambda work, options: pytest.fail("walked again"))
    given = [f"--set={text}" for text in settings] + [f"--only={kind}" for kind in only]
    answer = ampm("robustness", "normal", *given, *told, "--out", tmp_path, "--resume", "--json")
    assert "does not use: gait.steps" in answer.err
    assert (answer.status, answer.json) == (Status.PASS, found.as_dict())
    assert ampm("robustness", "normal", "--out", tmp_path).status == Status.REFUSED


def test_directions_go_by_the_foot_after_the_push():
    contacts = walk_of().plan.contacts
    assert contacts.phases[0].stance == "left"
    for phase, side in {"early": 1.0, "mid": 1.0, "late": -1.0, "double": -1.0}.items():
        signs = {"narrower": side, "wider": -side}
        for direction, sign in signs.items():
            along = push_instant(contacts, direction, phase, 1)[1]
            np.testing.assert_allclose(along, [0.0, sign], rtol=0.0, atol=1e-12)
    single = contacts.phases[0].duration
    assert push_instant(contacts, "forward", "mid", 1)[0] == pytest.approx(0.5 * single)
    assert push_instant(contacts, "forward", "mid", 1, shift=0.1)[0] == pytest.approx(0.6 * single)

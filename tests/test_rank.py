"""Ranks of planners: intervals, what is decided, and planners that fail in a cell."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.sweep_table import parse_sweep, sweep_of, write_sweep
from validation.study.rank import rank
from validation.study.row_file import ROWS
from validation.study.sweep.table import build_table, key_of

LEAGUE = """
[sweep]
gait = ["normal", "flat"]
steps = 4

[[vary]]
method = "grid"
gait.planner = ["ampm", "dcm", "ipm", "lipm"]

[[vary]]
method = "list"
disturbance.seed = [1, 2, 3, 4, 5, 6, 7, 8]
simulation.engine = ["mujoco", "mujoco", "mujoco", "mujoco", "drake", "drake", "drake", "drake"]
"""
SEEDS = '[[vary]]\nmethod = "grid"\nsensors.seed = [1, 2]\ndisturbance.seed = [1, 2]\n'
ERRORS = {"ampm": 1.00e-3, "dcm": 1.04e-3, "ipm": 2.5e-3, "lipm": 1.5e-3}
"""Median error of the planners; `lipm` falls in every walk of the task `flat`."""
RANKS = [("ampm", "1", "1"), ("dcm", "1", "1"), ("ipm", "4", "3"), ("lipm", "3", "4")]
"""In `normal` and in `flat`."""


def league(seed, change=lambda task, planner, row: row):
    """Table of a league whose replicas are drawn with a seed."""
    definition, rng, rows = parse_sweep(LEAGUE), np.random.default_rng(seed), []
    for number in range(len(definition)):
        run, task = definition.parameters(number), definition.gaits[definition.gait_of(number)]
        planner = run.gait.planner
        error = ERRORS[planner] * rng.lognormal(0.0, 0.04) * (1.1 if run.simulation.engine == "drake" else 1)
        row = {
            "outcome": "completed",
            "verdict": "pass",
            "outcome_time": 3.0,
            "energy_cost_of_transport": 0.4,
            "energy_speed": 0.75 if planner == "dcm" else 0.9,
        }
        row |= {f"ahead_0.1_zmp_{axis}": error / np.sqrt(2.0) for axis in "xy"}
        if (task, planner) == ("flat", "lipm"):
            row = {"outcome": "fell", "verdict": "not_measured", "outcome_time": 1.0 + 0.1 * rng.random()}
        rows.append({**change(task, planner, row), "key": key_of(definition, number)})
    return sweep_of(build_table(definition, rows))


def test_shuffled_seeds_keep_every_rank():
    for seed in range(5):
        assert rank(league(seed)).tables()[0].rows == RANKS, seed


def test_a_difference_that_the_engines_disagree_on_is_open():
    found = rank(league(0))
    one, other = (c for c in found.cells if c.task == "normal" and c.name in ("ampm", "lipm"))
    assert found.better(one, other)
    shifted = {at: other.errors[at] + (2e-3 if "drake" in at else 0.0) for at in other.errors}
    moved = replace(other, errors=shifted)
    assert not found.better(one, moved)
    assert not found.better(moved, one)


def test_few_replicas_decide_nothing_and_without_a_walk_there_is_no_rank():
    def change(task, planner, row):
        if planner == "dcm" and task == "flat":
            return {"outcome": "refused", "reason": "bad_parameter", "cause": "footsteps: none."}
        return {"outcome": "crashed", "cause": "broken"} if planner == "dcm" else row

    found = rank(league(1, change))
    assert not [name for _, name in found.ranks if name == "dcm"]
    cell = next(cell for cell in found.cells if (cell.task, cell.name) == ("flat", "dcm"))
    assert (cell.runs, cell.notes) == (0, ("8 refused: footsteps: none.",))
    one, other = (cell for cell in found.cells if cell.task == "normal" and cell.name in ("ampm", "ipm"))
    few = replace(one, errors=dict(list(one.errors.items())[:5]))
    assert found.better(one, other)
    assert not found.better(few, other)
    for share, decided in ((0.05, False), (0.2, True)):  # numerical uncertainty of a tenth
        worse = replace(other, errors={at: error + share * one.error for at, error in one.errors.items()})
        assert found.better(one, worse) is decided
    (first, _), *others = one.completed
    less = replace(one, completed=[(first, False), *others])
    assert not found.better(one, less)


def test_replicas_that_are_equal_count_once():
    """Such as seeds of noise that no sensor has."""

    def change(task, planner, row):
        return row | {f"ahead_0.1_zmp_{axis}": ERRORS[planner] for axis in "xy"}

    found = rank(league(0, change))
    assert {cell.runs for cell in found.cells if cell.survived} == {1}
    assert found.cells[0].notes == ("7 equal another one to the bit: they count once",)
    assert not found.wins


REFUSED = {"outcome": "refused", "reason": "bad_parameter", "cause": "engine."}
UNSOUND, OTHER = {"failed": "zmp_x_rmse,zmp_agreement_rmse"}, {"plan_note": "It is 0 m."}


@pytest.mark.parametrize(
    ("tasks", "planner", "walks", "what", "survived", "runs", "note"),
    [
        ("flat", "lipm", 8, {"outcome_time": 1.5}, 0, 8, ""),  # falls at the same instant are not equal
        ("normal", "dcm", 3, REFUSED, 5, 8, "3 refused: engine."),  # by one planner alone
        ("normal flat", "dcm", 16, {"verdict": "not_measured"}, 8, 8, "8 not measured: "),
        ("normal flat", "dcm", 16, UNSOUND, 0, 0, "8 fail a check of the measurement and do not count"),
        ("normal flat", "dcm", 16, OTHER, 0, 0, "8 with steps unlike the task's do not count: It is 0 m."),
    ],
)
def test_which_walks_count_and_which_survived(tasks, planner, walks, what, survived, runs, note):
    left = iter(range(walks))

    def change(task, name, row):
        return row | what if name == planner and task in tasks and next(left, None) is not None else row

    found = rank(league(0, change))
    cell = next(cell for cell in found.cells if cell.name == planner and cell.task in tasks)
    assert (cell.survived, cell.runs, "".join(cell.notes[:1])) == (survived, runs, note)
    assert len(cell.errors) == survived
    assert ((cell.task, planner) in found.ranks) == (f"{planner}-best" in found.extremes) == bool(runs)


def test_a_walk_without_an_error_has_no_rank():
    lost = {f"ahead_0.1_zmp_{axis}": math.nan for axis in "xy"}
    found = rank(league(0, lambda task, planner, row: row | (lost if planner == "dcm" else {})))
    assert ("normal", "dcm") not in found.ranks
    assert ("normal", "ipm") in found.ranks


def test_survival_of_other_replicas_is_not_compared():
    found = rank(league(0))
    one, other = (c for c in found.cells if c.task == "flat" and c.name in ("ampm", "lipm"))
    assert found.better(one, other)
    ends = [((*at, "another"), end) for at, end in other.completed]
    elsewhere = replace(other, completed=ends, replicas=frozenset(at for at, _ in ends))
    assert not found.better(one, elsewhere)


def test_the_worst_run_is_the_one_that_ended_first():
    falls = iter([1.4, 0.9])

    def change(task, planner, row):
        time = next(falls, None) if (task, planner) == ("normal", "ipm") else None
        return row if time is None else {"outcome": "fell", "verdict": "not_measured", "outcome_time": time}

    found = rank(league(0, change))
    cell = next(cell for cell in found.cells if cell.name == "ipm")
    assert (cell.task, cell.survived, cell.runs, found.extremes["ipm-worst"]) == ("normal", 6, 8, 17)


def test_tables_and_json():
    found = rank(league(2), "gait.planner")
    overview, normal, *_ = found.tables()
    assert [*overview.headers, *normal.headers[-2:]] == ["planner", "normal", "flat", "cost", "notes"]
    cell = found.as_dict()["cells"][0]
    assert (cell["task"], cell["name"], cell["rank"], cell["survived"]) == ("normal", "ampm", 1, 8)
    assert cell["error"] == pytest.approx(1.05e-3, rel=0.1)
    assert normal.rows[0] == ("1", "ampm", f"{1e3 * cell['error']:.3g}", "8 of 8", "68–100", "0.4", "")
    notes = {(cell.task, cell.name): cell.notes for cell in found.cells if cell.name != "lipm"}
    slower = ("17 % slower than the median",)
    assert notes == {place: slower if place[1] == "dcm" else () for place in notes}
    assert found.sentence.endswith(" of 12 differences within a task are decided.")
    assert found.extremes.keys() == {f"{name}-{end}" for name in ERRORS for end in ("best", "worst")}
    assert found.extremes["lipm-best"] < 32 <= found.extremes["lipm-worst"]  # it fell in the second task


def test_bodies_that_stand_are_compared_with_no_pace():
    found = rank(league(0, lambda task, name, row: row | {"energy_speed": 0.007 if name == "dcm" else 0.009}))
    assert not any("median" in note for cell in found.cells for note in cell.notes)


def test_recordings_of_users_files_stand_in_the_folder_that_is_asked_for():
    text = LEAGUE.replace('"lipm"', '"/a/plan.csv"').replace('"ipm"', '"/b/plan.csv"')
    definition = parse_sweep(text)
    row = {"outcome": "completed", "verdict": "pass", "outcome_time": 3.0, "ahead_0.1_zmp_x": 1e-3}
    rows = [{**row, "key": key_of(definition, number)} for number in range(len(definition))]
    found = rank(sweep_of(build_table(definition, rows)))
    assert {"a_plan.csv-best", "b_plan.csv-worst"} <= found.extremes.keys()


def test_a_table_without_newer_columns_is_ranked(tmp_path):
    found = rank(write_sweep(tmp_path / "sweep", league(0).table.drop_columns(["plan_note", "energy_speed"])))
    assert found.tables()[0].rows == RANKS


def test_recordings_of_another_ranking_are_kept(ampm, tmp_path):
    (tmp_path / ROWS).touch()
    answer = ampm("rank", write_sweep(tmp_path / "sweep", league(0).table), "--recordings", tmp_path)
    assert (answer.status, "--resume" in answer.err) == (2, True)

"""A robustness study: ladders, replicas, resumption, tables; walks of its own at the end."""

from __future__ import annotations

import csv
import json
import math

import numpy as np
import pytest

import ampm
import validation as val
from ampm.exceptions import InputError
from docs.robustness import KEYS, keys_table
from tests.solved import body_of
from validation.cli.app import call
from validation.study.robustness.cells import PUSHES, Cell, chosen, needed, other_cells, push_cells
from validation.study.robustness.picture import draw
from validation.study.robustness.result import CellResult
from validation.study.robustness.run import robustness
from validation.study.robustness.text import markdown, other_rows, push_rows
from validation.study.robustness.walks import Level, LevelResult, walk_level
from validation.trial.shapes import Shapes

LIMITS = {"forward": 0.4, "backward": 0.3, "wider": 0.12, "narrower": 0.1}
ONLY = ("pushes", "friction_factor", "slope_along")


def fake(level):
    """Survives up to a limit, and keeps the tolerances up to half of it."""
    cell = level.cell
    if cell.key == PUSHES:
        survives, passes = level.value <= LIMITS[cell.direction], False
    else:
        size = abs(level.value) if "slope" in cell.key else 1.0 - level.value
        survives, passes = size <= 0.04, size <= 0.02
    if not survives:
        cause = "fell: the trunk leaned over by 60 degrees at 3 s; the first sign was it"
        return LevelResult(1, 0, (cause,) * 2, (0.0, 0.0))
    return LevelResult(level.replicas - 1, passes * (level.replicas - 1), ("fell",), (2e-3, 1e-3))


def study(runner=fake, **options):
    return robustness("normal", runner=runner, **{"only": ONLY, "quick": True, "workers": 1, **options})


def test_the_largest_value_counts_with_all_smaller_ones():
    cell = Cell("friction", "disturbance.friction_factor", (0.8, 0.6, 0.4, 0.2))

    def result(*walked):
        levels = tuple(
            (value, LevelResult(n, n - 1, () if n > 3 else ("fell", "fell"), (1e-3, 1e-3)))
            for value, n in zip(cell.values, walked, strict=False)
        )
        return CellResult(cell, levels, 5)

    assert result(5, 4, 3).survived == 0.6
    assert result(5, 4, 3).within == 0.8
    assert result(5, 4, 3).cause == "fell"
    assert result(5, 3, 5).survived == 0.8
    assert result(3).survived is None
    assert result(5, 5, 5, 5).complete
    assert not result(5, 5, 5).cause
    assert [needed(n) for n in (1, 2, 3, 5, 10)] == [1, 2, 3, 4, 8]


def test_a_study_climbs_every_cell_to_its_limit():
    found = study()
    for item in found.pushes:
        limit = LIMITS[item.cell.direction]
        step = item.cell.values[0]
        assert (item.survived or 0.0) == pytest.approx(step * math.floor(limit / step + 1e-9))
        assert len(item.levels) == round((item.survived or 0.0) / step) + 1
        assert item.bound > 0.3
        assert item.share == pytest.approx((item.survived or 0.0) / item.bound)
        assert "trunk" in item.cause
    uphill = next(item for item in found.others if item.cell.name == "slope uphill")
    assert uphill.survived == pytest.approx(math.radians(1.0))
    assert uphill.within == uphill.survived
    assert uphill.zmp == (2e-3, 1e-3)
    chest, com = (found.push(height, "late", "forward").bound for height in ("chest", "com"))
    assert 0.6 < chest / com < 0.8
    with pytest.raises(KeyError):
        found.push("com", "mid", "forward")


def test_tables_and_pictures_show_the_share_of_the_bound(tmp_path):
    found = study()
    row = push_rows(found)[0]
    assert row[:2] == ("com", "12 % of single support")
    bound = found.push("com", "early", "forward").bound
    assert row[2] == f"0.40 of {bound:.2f} ({40 / bound:.0f} %)"
    names = {row[0]: row for row in other_rows(found)}
    assert names["slope uphill"][1:4] == ("degrees", "1", "1")
    assert names["slope uphill"][5] == "fell: the trunk leaned over by 60 degrees"
    assert "## " not in markdown(found)
    assert "| com |" in markdown(found)
    draw(found, tmp_path / "picture.svg")
    assert "narrower" in (tmp_path / "picture.svg").read_text()


def test_a_study_that_was_stopped_goes_on_with_what_is_missing(tmp_path):
    out = tmp_path / "study"
    walked: list[tuple[str, float]] = []

    def stops(level):
        if len(walked) == 5:
            raise KeyboardInterrupt
        walked.append((level.cell.name, level.value))
        return fake(level)

    with pytest.raises(KeyboardInterrupt):
        study(stops, out=out)
    journal = out / "levels.jsonl"
    with journal.open("a") as file:
        file.write('{"cell": "com ea')  # cut off by a kill
    again = []

    def goes_on(level):
        again.append((level.cell.name, level.value))
        return fake(level)

    found = study(goes_on, out=out, resume=True)
    assert not set(again) & set(walked)
    assert found == study()
    assert json.loads((out / "robustness.json").read_text()) == found.as_dict()
    assert {path.name for path in out.iterdir()} == {
        "robustness.json", "robustness.md", "robustness.svg", "robustness.png", "levels.jsonl",
    }  # fmt: skip
    again.clear()
    assert study(goes_on, out=out, resume=True) == found
    assert again == []
    with pytest.raises(InputError, match="differs in replicas;"):
        study(out=out, resume=True, replicas=3)
    with pytest.raises(InputError, match="--force"):
        study(out=out)


def test_workers_find_the_same():
    assert study(workers=2, only=("friction_factor", "slope_along")) == study(
        only=("friction_factor", "slope_along")
    )


@pytest.mark.parametrize(
    ("options", "word"),
    [({"only": ("wind",)}, "'wind' is no .* friction_factor, .* pushes"),
     ({"replicas": 0}, "--replicas 0"), ({"workers": 0}, "--workers 0"),
     ({"resume": True}, "--out")],
)  # fmt: skip
def test_bad_requests_are_refused_before_anything_is_planned(options, word, monkeypatch):
    monkeypatch.setattr("validation.study.robustness.run.plan_walk", lambda *_: pytest.fail("planned"))
    with pytest.raises(InputError, match=word):
        study(**options)


def test_the_cells_cover_all_pushes_and_all_keys():
    pushes, others = push_cells(), other_cells(("thorax", "left_foot"))
    assert len({cell.name for cell in (*pushes, *others)}) == len(pushes) + len(others)
    assert len(pushes) == 2 * 4 * 4
    keys = {cell.key.partition(".")[2] for cell in others}
    known = set(ampm.load_run(None).disturbance.model_dump())
    apart = {"seed", "start_velocity", "step_number", "mass_segment"}
    assert known - keys == apart | {name for name in known if name.startswith("push_")}
    assert [cell.name for cell in others if "foot" in cell.name] == ["left_foot heavier", "left_foot lighter"]
    assert len(chosen(others, ["mass_change"])) == 6
    for cell in others:
        sizes = [abs(value - ("factor" in cell.key)) for value in cell.values]
        assert sizes == sorted(sizes)


def test_the_docs_have_every_key_with_its_unit():
    with KEYS.open(encoding="utf-8", newline="") as file:
        written = [tuple(row) for row in csv.reader(file)]
    assert written == keys_table()
    assert "s" in next(row for row in written if row[0] == "disturbance.sensing_delay")


def level(direction, value, height="com", replicas=1):
    cell = next(item for item in push_cells() if item.name == f"{height} mid {direction}")
    return Level(cell, value, ampm.dump_run(ampm.load_run("normal")), "normal", "default", replicas)


def test_a_weak_push_is_survived_in_all_replicas_a_strong_one_is_not():
    weak = walk_level(level("forward", 0.1, replicas=2))
    assert (weak.walked, weak.causes) == (2, ())
    strong = walk_level(level("narrower", 2.0, "chest", replicas=5))
    assert strong.walked == 0
    assert len(strong.causes) == 2  # the others need not be walked
    assert all("first sign was a ZMP" in cause for cause in strong.causes)


def test_the_command_and_the_api_find_the_same(capsys):
    found = val.robustness("normal", only=("friction_factor",), quick=True, replicas=1, workers=1)
    other = found.others[0]
    assert other.survived is not None
    assert other.survived <= 0.5
    assert other.zmp[0] < 1e-3
    arguments = ["--only", "friction_factor", "--quick", "--replicas", "1", "--workers", "1", "--json"]
    assert call(["robustness", "normal", *arguments]) == 0
    assert json.loads(capsys.readouterr().out) == found.as_dict()


def test_legs_that_meet_are_seen_and_a_hand_on_a_thigh_is_not():
    body = body_of()
    model = body.compile()
    every, legs = Shapes(model), Shapes(model, only_legs=True)
    assert 0 < len(legs) < len(every)
    q = np.array(model.qpos0)
    assert legs.recorded_gaps(q).distance[0] > 0.0
    crossed = q.copy()
    for side, sign in (("left", -1.0), ("right", 1.0)):
        crossed[model.joint(f"{side}_hip_roll").qposadr[0]] = 0.3 * sign
    assert legs.recorded_gaps(crossed).distance[0] < 0.0
    touching = q.copy()
    touching[model.joint("left_shoulder_roll").qposadr[0]] = -0.3
    assert every.recorded_gaps(touching).distance[0] < 0.0
    assert legs.recorded_gaps(touching).distance[0] > 0.0

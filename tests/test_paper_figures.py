"""The paper's figures: what is drawn comes from plan, motion and record, and nothing is overwritten."""

from __future__ import annotations

import json
import runpy
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from matplotlib.figure import Figure

from ampm.exceptions import InputError, SolverError
from ampm.run_file import load_run
from tests.solved import COARSE, motion_of, walk_of
from validation.cli.app import Status, call
from validation.paper.figures import FIGURES, human, make_figures
from validation.paper.figures.accelerations import com_accelerations, joint_accelerations
from validation.paper.figures.bodies import numbers, pose, trunk
from validation.paper.figures.canvas import SPREAD, save, style
from validation.paper.figures.foot_roll import joint_jumps
from validation.paper.figures.walks import Walk, Walks
from validation.run.walk import walk_planned
from validation.trial.outcome import Outcome, OutcomeName
from validation.trial.plan import load_request, plan_walk


@pytest.fixture(scope="module")
def walk() -> Walk:
    asked = load_request("normal", ["gait.steps=6", COARSE])
    return Walk("normal", walk_planned(plan_walk(asked)))


# ------------------------------------------------------------------------------------------ the command


def test_figures_are_written_as_svg_and_png_and_never_lost(tmp_path, monkeypatch, capsys):
    drawn = {name: lambda walks, name=name: (Figure(), {"said": name}) for name in "45"}
    figures = {name: (f"figure-0{name}", draw) for name, draw in drawn.items()}
    monkeypatch.setattr("validation.paper.figures.make.FIGURES", figures)
    out = tmp_path / "new" / "out"
    assert call(["figures", "--out", str(out), "--only", "4"]) == Status.PASS
    assert call(["figures", "--out", str(out), "--only", "5"]) == Status.PASS
    files = sorted(path.name for path in out.iterdir())
    assert files == ["figure-04.png", "figure-04.svg", "figure-05.png", "figure-05.svg", "figures.json"]
    assert {Path(line).name for line in capsys.readouterr().out.split()} == set(files)
    kept = json.loads((out / "figures.json").read_text())
    assert kept == {"figure-04": {"said": "4"}, "figure-05": {"said": "5"}}
    assert call(["figures", "--out", str(out), "--only", "4,5"]) == Status.REFUSED
    assert "--force" in capsys.readouterr().err
    assert call(["figures", "--out", str(out), "--only", "4", "--force"]) == Status.PASS


@pytest.mark.parametrize(
    ("out", "only", "steps", "words"),
    [
        ("", "4,6", 12, r"no figure '6'; the figures are 4, 5, 7"),
        ("", "", 12, "no figure"),
        ("", "8", 3, "take 4 or more"),
        ("file", "4", 12, "is a file"),
    ],
)
def test_unknown_figures_and_too_short_walks_are_refused(tmp_path, out, only, steps, words):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(InputError, match=words):
        make_figures(tmp_path / out, only, steps)
    assert (tmp_path / "file").read_text() == "mine"


def test_a_gait_is_walked_once_and_a_fall_is_not_drawn(monkeypatch):
    walked = []

    def walk(asked, **_):
        walked.append((asked.name, asked.run.gait.steps))
        outcome = Outcome(OutcomeName("fell" if asked.name == "flat" else "completed"), 1.5, "It slipped.", 2)
        return SimpleNamespace(record=SimpleNamespace(outcome=outcome))

    monkeypatch.setattr("validation.paper.figures.walks.plan_walk", lambda asked, _: asked)
    monkeypatch.setattr("validation.paper.figures.walks.walk_planned", walk)
    monkeypatch.setattr("validation.paper.figures.walks.Walk", lambda *_: object())
    walks = Walks(5)
    first = walks.walk("normal")
    assert walks.walk("normal") is first
    assert walks.walk("normal", ("gait.c_y=0.4",)) is not first
    assert walked == [("normal", 5), ("normal", 5)]
    with pytest.raises(SolverError, match=r"flat.*1\.50 s.*It slipped"):
        walks.walk("flat")


# --------------------------------------------------------------------------------------------- the data


def test_body_is_posed_by_its_own_kinematics(walk):
    row = walk.row(walk.middle)
    body = pose(walk.robot, walk.configuration(row))
    np.testing.assert_allclose(body.com, walk.trial.record.com[row], rtol=0.0, atol=1e-9)
    lowest = min(segment.points[:, 2].min() for segment in body.segments)
    assert -0.005 < lowest < 0.005  # the stance foot stands on the floor
    top = body.head[2] + body.head_radius
    assert 0.9 * 1.7 < top < 1.72
    left, right = ([s.points for s in body.segments if s.side == side] for side in ("left", "right"))
    assert np.concatenate(left)[:, 1].mean() > np.concatenate(right)[:, 1].mean()
    for thigh in (left[0], right[0]):
        assert np.linalg.norm(np.diff(thigh, axis=0)) == pytest.approx(0.245 * 1.7, rel=0.02)


def test_trunk_angles_and_momenta_of_a_walk(walk):
    said = numbers(walk)
    assert said["trunk_pitch_smallest_deg"] < 0 < said["trunk_pitch_largest_deg"]
    assert said["measured_L_y_peak_Nms"] == pytest.approx(said["planned_L_y_peak_Nms"], abs=0.4)
    share, motion, simulated = trunk(walk, "pitch")
    assert simulated.shape == (2, len(share)) == (2, len(motion))
    assert np.abs(simulated - motion).max() < 2.0


def test_com_acceleration_of_plan_motion_and_forces_agree_and_is_continuous(walk):
    planned, motion, measured = com_accelerations(walk)
    assert len(measured) == len(walk.stride_starts) == 2  # the first stride is left out
    np.testing.assert_allclose(motion[:, :2], planned[:, :2], atol=0.01)
    assert np.sqrt(((measured - planned)[..., :2] ** 2).mean()) < 0.08
    step = np.abs(np.diff(planned[:, :2], axis=0)).max()
    assert step < 0.1  # 2 ms at the steepest; the plain pendulum would jump by 3 m/s²


def test_joint_acceleration_follows_the_motion(walk):
    knee = walk.robot.description.left_leg.knee
    motion, raw, smooth = joint_accelerations(walk, knee, 1.0)
    assert raw.shape == smooth.shape == (2, len(walk.phase))
    scale_of = float(np.sqrt((motion**2).mean()))
    assert np.sqrt(((smooth - motion) ** 2).mean()) < 0.15 * scale_of
    flipped, _, _ = joint_accelerations(walk, knee, -1.0)
    np.testing.assert_array_equal(flipped, -motion)


def test_motion_has_the_plans_com_force_zmp_and_momentum(walk):
    """The IK's ZMP is from its own momentum rates; only the grid parts it from the plan."""
    for name, limit in (("com", 1e-6), ("zmp", 1e-3), ("force", 1.0), ("angular_momentum", 1e-3)):
        assert np.abs(walk.deviation[name][0]).max() < limit, name
    _, simulated = walk.away("zmp", 0)
    assert simulated.shape == (2, len(walk.phase))
    assert np.sqrt((simulated**2).mean()) < walk.limit("zmp_x_rmse")
    assert walk.limit("zmp_x_rmse") == pytest.approx(2.5e-3)
    assert walk.limit("force_x_rmse") == pytest.approx(0.008 * 60.0 * 9.81, rel=1e-3)


def words_of(figure: Figure) -> str:
    """Words of every legend."""
    legends = [legend for axis in figure.axes if (legend := axis.get_legend())] + list(figure.legends)
    return " ".join(text.get_text() for legend in legends for text in legend.get_texts())


def test_every_figure_of_one_walk_has_plan_motion_simulation_a_band_and_units(walk, tmp_path):
    assert set(FIGURES) == {"4", "5", "7", "8", "9", "10", "11", "12", "human"}
    one = SimpleNamespace(walk=lambda *_, **__: walk, plan=lambda *_: walk.trial.planned)
    with style():
        drawn: dict[str, Any] = {
            name: FIGURES[name][1](cast(Walks, one)) for name in ("4", "5", "8", "9", "10", "11", "12")
        }
        for number, (figure, said) in drawn.items():
            words = words_of(figure)
            assert "plan" in words, number
            assert "inverse kinematics" in words or "IK" in words, number
            assert "simulation" in words, number
            # A tolerance wherever the profile has one.
            assert (SPREAD if number in ("8", "10") else "tolerance of the RMSE") in words, number
            assert any("[" in axis.get_xlabel() + axis.get_ylabel() for axis in figure.axes), number
            json.dumps(said, allow_nan=False)
        once, again = (save(drawn["5"][0], tmp_path / name, "a")[0].read_bytes() for name in "pq")
    assert once == again  # the same bits every time
    assert drawn["9"][1]["COM acceleration x: simulation less plan"]["rmse"] < 0.08
    assert all(item["unit"] == "rad/s²" for item in drawn["10"][1].values())


# ------------------------------------------------------------------------------------------- the pages


def test_tables_of_the_pages_are_those_of_the_figures_numbers():
    """No number of a table is written by hand: ``python docs/images/paper.py --tables`` changes nothing."""
    path = Path(__file__).parent.parent / "docs" / "images" / "paper.py"
    paper = SimpleNamespace(**runpy.run_path(str(path)))
    written = json.loads((paper.FOLDER / "figures.json").read_text(encoding="utf-8"))
    assert set(paper.TABLES) <= set(written)
    assert paper.PAGE.read_text(encoding="utf-8") == paper.page(written)


# -------------------------------------------------------------------------------------------- foot roll


@cache
def jumps(swing: str, grid: float, of: str = "ball") -> dict[str, float]:
    overrides = (f"foot.swing={swing}", f"foot.v_swing_of={of}", f"solver.ik_time_step={grid}")
    return joint_jumps(motion_of(*overrides), walk_of(*overrides).robot)


def test_the_papers_swing_lets_the_joints_jump_and_ours_does_not():
    """E17: half the grid halves the jumps of a C2 motion; a jump of velocity stays, and its slope doubles."""
    coarse, fine = jumps("quintic", 0.008), jumps("quintic", 0.004)
    assert fine["acceleration"] == pytest.approx(0.5 * coarse["acceleration"], rel=0.15)
    assert fine["velocity"] == pytest.approx(0.5 * coarse["velocity"], rel=0.15)
    coarse, fine = jumps("paper", 0.008), jumps("paper", 0.004)
    assert fine["velocity"] == pytest.approx(coarse["velocity"], rel=0.15)
    assert fine["difference"] == pytest.approx(2.0 * coarse["difference"], rel=0.15)
    assert fine["acceleration"] > 5.0 * jumps("quintic", 0.004)["acceleration"]
    coarse, fine = jumps("paper", 0.008, "ankle"), jumps("paper", 0.004, "ankle")
    assert fine["velocity"] == pytest.approx(0.5 * coarse["velocity"], rel=0.15)
    assert fine["acceleration"] == pytest.approx(coarse["acceleration"], rel=0.15)


# ------------------------------------------------------------------------------------------------ human


def test_momentum_is_normalised_by_mass_speed_and_height(walk):
    plan = walk.plan
    assert human.scale(plan) == pytest.approx(60.0 * 0.6 / plan.constants.step_duration * plan.com_height)
    found = human.peaks(walk)
    assert found["y"] * human.scale(plan) == pytest.approx(plan.constants.angular_momentum_y_offset, abs=0.3)
    assert found["x"] < human.HUMAN_MOMENTUM["x"]


def test_human_range_is_about_the_pendulum_without_momentum():
    for found in human.ranges(load_run("normal")).values():
        assert found["low"] < 1.0 < found["high"]
        index = int(np.argmin(found["peaks"]))
        assert found["values"][index] == pytest.approx(1.0)
        assert found["peaks"][index] == pytest.approx(0.0, abs=1e-9)


def test_measured_range_is_found_by_walking_and_stays_within():
    """Peak |0.3 (c - 1) - 0.01|: a constant that adds on one side and takes away on the other."""
    found = human.measured_range(
        lambda value: abs(0.3 * (value - 1.0) - 0.01), "c_s", 1 - 0.05 / 0.3, 1 + 0.05 / 0.3
    )
    assert found["low"] == pytest.approx(1 - 0.04 / 0.3, abs=0.005)
    assert found["high"] == pytest.approx(1 + 0.06 / 0.3, abs=0.005)
    walked = dict(found["walked"])
    assert max(walked[found["low"]], walked[found["high"]]) <= 0.05
    assert len(walked) < 12


def test_peoples_force_has_two_humps_and_says_whose_it_is():
    people = human.human_force()
    share = people["stance_percent"]
    assert (share[0], share[-1], len(share)) == (0.0, 100.0, 51)
    for speed in human.SPEEDS:
        force, forward = people[f"vertical_mean_{speed}"], people[f"forward_mean_{speed}"]
        valley = force[(share > 35) & (share < 65)].min()
        assert min(force[share < 45].max(), force[share > 55].max()) > valley + 0.05
        assert forward[share < 45].min() < -0.1
        assert forward[share > 55].max() > 0.1
        assert (people[f"vertical_sd_{speed}"] > 0).all()
    header = human.HUMAN_FORCE.read_text(encoding="utf-8")
    for word in ("doi:10.1371/journal.pone.0222037", "predsim_benchmark_data", "licence", "Processing"):
        assert word in header


def test_one_foot_carries_the_weight_without_a_double_hump(walk):
    said = human.forces(Figure(), walk)
    assert 0.98 < said["vertical"]["simulated_largest"] < 1.06
    assert said["vertical"]["simulated_valley"] > 0.98
    assert said["medial"]["simulated_largest"] > 0.0

"""The paper's figures: what is drawn comes from plan, motion and record, and nothing is overwritten."""

from __future__ import annotations

import json
import runpy
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure

from ampm.exceptions import InputError, SolverError
from ampm.run_file import load_run
from models.human import sole_geometry
from tests.solved import COARSE, motion_of, walk_of
from validation.cli.app import Status, call
from validation.paper.figures import FIGURES, human, make_figures
from validation.paper.figures.accelerations import com_accelerations, figure_9, figure_10, joint_accelerations
from validation.paper.figures.bodies import figure_8, figure_11, figure_12, numbers, trunk
from validation.paper.figures.canvas import save, style
from validation.paper.figures.centroidal import of_motion
from validation.paper.figures.foot_roll import joint_jumps
from validation.paper.figures.geometry import figure_4, figure_5
from validation.paper.figures.human import HUMAN_FORCE, HUMAN_MOMENTUM, SPEEDS
from validation.paper.figures.panels import SPREAD
from validation.paper.figures.skeleton import pose
from validation.paper.figures.walks import Walk, Walks
from validation.run.walk import walk_planned
from validation.trial.outcome import Outcome, OutcomeName
from validation.trial.plan import load_request, plan_walk


@pytest.fixture(scope="module")
def walk() -> Walk:
    asked = load_request("normal", ["gait.steps=6", COARSE])
    return Walk("normal", walk_planned(plan_walk(asked)))


@pytest.fixture
def paper():
    with style():
        yield


# ------------------------------------------------------------------------------------------ the command


def test_figures_are_written_as_svg_and_png_and_never_lost(tmp_path, monkeypatch, capsys):
    figures: dict[str, tuple] = {name: (f"figure-0{name}", lambda _: (Figure(), {})) for name in "45"}
    monkeypatch.setattr("validation.paper.figures.make.FIGURES", figures)
    out = tmp_path / "new" / "out"
    assert call(["figures", "--out", str(out), "--only", "4,5"]) == Status.PASS
    files = sorted(path.name for path in out.iterdir())
    assert files == ["figure-04.png", "figure-04.svg", "figure-05.png", "figure-05.svg"]
    printed = capsys.readouterr().out.split()
    assert sorted(Path(line).name for line in printed) == files
    assert call(["figures", "--out", str(out), "--only", "4"]) == Status.REFUSED
    assert "--force" in capsys.readouterr().err
    assert call(["figures", "--out", str(out), "--only", "4", "--force"]) == Status.PASS


def test_unknown_figures_and_too_short_walks_are_refused(tmp_path):
    file = tmp_path / "file"
    file.write_text("mine")
    for out, only, steps, words in (
        (tmp_path, "4,6", 12, r"no figure '6'; the figures are 4, 5, 7"),
        (tmp_path, "", 12, "no figure"),
        (tmp_path, "8", 3, "take 4 or more"),
        (file, "4", 12, "is a file"),
    ):
        with pytest.raises(InputError, match=words):
            make_figures(out, only, steps)
    assert file.read_text() == "mine"


def test_numbers_of_earlier_figures_are_kept(tmp_path, monkeypatch):
    drawn = {name: lambda walks, name=name: (Figure(), {"said": name}) for name in ("8", "9")}
    figures = {name: (f"figure-{name}", draw) for name, draw in drawn.items()}
    monkeypatch.setattr("validation.paper.figures.make.FIGURES", figures)
    make_figures(tmp_path, "8")
    paths = make_figures(tmp_path, "9")
    assert json.loads(paths[-1].read_text()) == {"figure-8": {"said": "8"}, "figure-9": {"said": "9"}}


def test_a_gait_is_walked_once(monkeypatch):
    walked = []

    def count(asked, **_):
        walked.append((asked.name, asked.run.gait.steps))
        return walk_that("completed")

    monkeypatch.setattr("validation.paper.figures.walks.plan_walk", lambda asked, _: asked)
    monkeypatch.setattr("validation.paper.figures.walks.walk_planned", count)
    walks = Walks(5)
    first = walks.walk("normal")
    assert walks.walk("normal") is first
    assert walks.walk("normal", ("gait.c_y=0.4",)) is not first
    assert walked == [("normal", 5), ("normal", 5)]


def walk_that(outcome: str) -> SimpleNamespace:
    return SimpleNamespace(
        record=SimpleNamespace(outcome=Outcome(OutcomeName(outcome), 1.5, "It slipped.", 2))
    )


def test_no_figure_is_drawn_of_a_fall(monkeypatch):
    monkeypatch.setattr("validation.paper.figures.walks.plan_walk", lambda *_: None)
    monkeypatch.setattr("validation.paper.figures.walks.walk_planned", lambda *_, **__: walk_that("fell"))
    with pytest.raises(SolverError, match=r"normal: fell after 1\.50 s \(It slipped\.\)"):
        Walks(5).walk("normal")


def test_every_figure_of_the_paper_that_shows_data_is_there():
    assert set(FIGURES) == {"4", "5", "7", "8", "9", "10", "11", "12", "human"}


# --------------------------------------------------------------------------------------------- the data


def test_body_is_posed_by_its_own_kinematics(walk):
    body = pose(walk.robot, walk.configuration(walk.middle))
    record = walk.trial.record
    row = int(np.argmin(np.abs(record.time - walk.middle)))
    np.testing.assert_allclose(body.com, record.com[row], atol=1e-9)
    lowest = min(segment.points[:, 2].min() for segment in body.segments)
    assert -0.005 < lowest < 0.005  # the stance foot stands on the floor
    top = body.head[2] + body.head_radius
    assert 0.9 * 1.7 < top < 1.72
    left = [s for s in body.segments if s.side == "left"]
    right = [s for s in body.segments if s.side == "right"]
    assert np.mean([s.points[:, 1].mean() for s in left]) > np.mean([s.points[:, 1].mean() for s in right])
    for thigh in (left[0], right[0]):
        assert np.linalg.norm(np.diff(thigh.points, axis=0)) == pytest.approx(0.245 * 1.7, rel=0.02)


def test_trunk_angles_have_the_signs_that_are_said(walk):
    said = numbers(walk)
    assert said["trunk_pitch_smallest_deg"] < 0 < said["trunk_pitch_largest_deg"]
    assert said["measured_L_y_peak_Nms"] == pytest.approx(said["planned_L_y_peak_Nms"], abs=0.4)


def test_com_acceleration_of_plan_motion_and_forces_agree(walk):
    planned, motion, measured = com_accelerations(walk)
    assert len(measured) == len(walk.stride_starts) == 2  # the first stride is left out
    np.testing.assert_allclose(motion[:, :2], planned[:, :2], atol=0.01)
    error = measured - planned
    assert np.sqrt((error[..., :2] ** 2).mean()) < 0.08
    said = figure_9(walk)[1]["COM acceleration x: simulation less plan"]
    assert said["rmse"] == pytest.approx(float(np.sqrt((error[..., 0] ** 2).mean())))


def test_com_acceleration_is_continuous_at_the_switches(walk):
    planned, _, _ = com_accelerations(walk)
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
        assert np.abs(walk.deviation[name].motion).max() < limit, name
    simulated = walk.deviation["zmp"].simulation
    assert simulated.shape == (2, len(walk.phase), 2)
    assert np.sqrt((simulated[..., 0] ** 2).mean()) < walk.limit("zmp_x_rmse")
    assert walk.limit("zmp_x_rmse") == pytest.approx(2.5e-3)
    assert walk.limit("force_x_rmse") == pytest.approx(0.008 * 60.0 * 9.81, rel=1e-3)


def test_zmp_of_a_body_that_stands_still_is_under_its_com(walk):
    sample = walk.motion.sample([0.3], walk.robot)
    still = sample._replace(v=0.0 * sample.v, acceleration=0.0 * sample.acceleration)
    found = of_motion(still, walk.robot, walk.plan)
    np.testing.assert_allclose(found.zmp, found.com[:, :2], atol=1e-9)
    np.testing.assert_allclose(found.force[0], [0, 0, walk.plan.mass * walk.plan.gravity], atol=1e-6)


def names(figure: Figure) -> set[str]:
    """Words of every legend."""
    legends = [legend for axis in figure.axes if (legend := axis.get_legend())] + list(figure.legends)
    return {text.get_text() for legend in legends for text in legend.get_texts()}


@pytest.mark.usefixtures("paper")
def test_every_figure_has_plan_motion_simulation_a_band_and_units(walk, tmp_path):
    sole = sole_geometry(1.7)
    figures = {
        "4": figure_4(walk, sole),
        "5": figure_5(walk, sole),
        "8": figure_8(walk),
        "9": figure_9(walk)[0],
        "10": figure_10(walk)[0],
        "11": figure_11([walk, walk]),
        "12": figure_12(walk, walk),
    }
    for number, figure in figures.items():
        words = " ".join(names(figure))
        assert "plan" in words, number
        assert "inverse kinematics" in words or "IK" in words, number
        assert "simulation" in words, number
        assert "tolerance of the RMSE" in words or SPREAD in words, number
        units = " ".join(axis.get_xlabel() + axis.get_ylabel() for axis in figure.axes)
        assert "[" in units, number
    # A tolerance wherever the profile has one.
    for number in ("4", "5", "9", "11", "12"):
        assert "tolerance of the RMSE" in " ".join(names(figures[number])), number
    assert figures["8"].axes[0].get_xlabel() == "x [m]"
    _, answers = figure_10(walk)
    assert all(item["unit"] == "rad/s²" for item in answers.values())
    once, again = (save(figure_5(walk, sole), tmp_path / name, "a")[0].read_bytes() for name in "pq")
    assert once == again  # the same bits every time


def test_trunk_is_compared_stride_by_stride(walk):
    share, motion, simulated = trunk(walk, "pitch")
    assert simulated.shape == (2, len(share)) == (2, len(motion))
    assert np.abs(simulated - motion).max() < 2.0


# ------------------------------------------------------------------------------------------- the pages


def test_tables_of_the_pages_are_those_of_the_figures_numbers():
    """No number of a table is written by hand: ``python docs/images/paper.py --tables`` changes nothing."""
    pytest.importorskip("matplotlib")
    path = Path(__file__).parent.parent / "docs" / "images" / "paper.py"
    paper = SimpleNamespace(**runpy.run_path(str(path)))
    written = json.loads((paper.FOLDER / "figures.json").read_text(encoding="utf-8"))
    assert set(paper.TABLES) <= set(written)
    assert paper.PAGE.read_text(encoding="utf-8") == paper.page(written)


# -------------------------------------------------------------------------------------------- foot roll


@cache
def jumps(swing: str, grid: float) -> dict[str, float]:
    overrides = (f"foot.swing={swing}", f"solver.ik_time_step={grid}")
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


# ------------------------------------------------------------------------------------------------ human


def test_momentum_is_normalised_by_mass_speed_and_height(walk):
    plan = walk.plan
    assert human.scale(plan) == pytest.approx(60.0 * 0.6 / plan.constants.step_duration * plan.com_height)
    found = human.peaks(walk)
    assert found["y"] * human.scale(plan) == pytest.approx(plan.constants.angular_momentum_y_offset, abs=0.3)
    assert found["x"] < HUMAN_MOMENTUM["x"]


def test_human_range_is_about_the_pendulum_without_momentum():
    found = human.ranges(load_run("normal"))
    for key in ("c_y", "c_s"):
        assert found[key]["low"] < 1.0 < found[key]["high"]
        index = int(np.argmin(found[key]["peaks"]))
        assert found[key]["values"][index] == pytest.approx(1.0)
        assert found[key]["peaks"][index] == pytest.approx(0.0, abs=1e-9)


def test_measured_range_is_found_by_walking_and_stays_within():
    """Peak |0.3 (c - 1) - 0.01|: a constant that adds on one side and takes away on the other."""
    walked = []

    def peak(value: float) -> float:
        walked.append(value)
        return abs(0.3 * (value - 1.0) - 0.01)

    found = human.measured_range(peak, "c_s", 1 - 0.05 / 0.3, 1 + 0.05 / 0.3)
    assert found["low"] == pytest.approx(1 - 0.04 / 0.3, abs=0.005)
    assert found["high"] == pytest.approx(1 + 0.06 / 0.3, abs=0.005)
    assert peak(found["low"]) <= 0.05
    assert peak(found["high"]) <= 0.05
    assert len(walked) < 15


def test_peoples_force_has_two_humps_and_says_whose_it_is():
    people = human.human_force()
    share = people["stance_percent"]
    assert (share[0], share[-1], len(share)) == (0.0, 100.0, 51)
    for speed in SPEEDS:
        force = people[f"vertical_mean_{speed}"]
        valley = force[(share > 35) & (share < 65)].min()
        assert force[share < 45].max() > valley + 0.05
        assert force[share > 55].max() > valley + 0.05
        forward = people[f"forward_mean_{speed}"]
        assert forward[share < 45].min() < -0.1
        assert forward[share > 55].max() > 0.1
        assert (people[f"vertical_sd_{speed}"] > 0).all()
    header = HUMAN_FORCE.read_text(encoding="utf-8")
    for word in ("doi:10.1371/journal.pone.0222037", "predsim_benchmark_data", "licence", "Processing"):
        assert word in header


def test_one_foot_carries_the_weight_without_a_double_hump(walk):
    figure = Figure()
    said = human._forces(list(figure.subplots(1, 3)), walk)
    assert 0.98 < said["vertical"]["simulated_largest"] < 1.06
    assert said["vertical"]["simulated_valley"] > 0.98
    assert said["medial"]["simulated_largest"] > 0.0

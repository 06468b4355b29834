"""Free choices found without a simulator: choices, limits, torques, refusals with certificates, commands."""

import math
import re
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pinocchio as pin
import pytest

from ampm.body.inverse_kinematics import InverseKinematics
from ampm.body.limits import LIMITS
from ampm.exceptions import RefusedGait
from ampm.parameters import KEYS, OPEN_KEYS
from ampm.planner.support import plan_steps
from ampm.presets import PRESETS
from ampm.run_file import leaves_open, load_run
from ampm.tune import tuning
from ampm.tune.first_gait import first_gait
from ampm.tune.free_choices import FreeChoices
from ampm.tune.gait_limits import plan_margins, shared_load, step_torques
from ampm.tune.search import rough_orbit
from ampm.tune.tuning import NoFeasibleChoice, tune
from ampm.tune.ways_out import ways_out
from tests.test_body_files import TOML, URDF, write
from validation.cli.app import Status
from validation.run.walk import walk_planned
from validation.study.sweep.run import walk_run
from validation.trial.plan import Request, make_body, plan_walk

HUMAN_94 = (
    "gait.step_length=0.721 gait.switching_velocity=0.694 gait.c_y=0.404 gait.c_s=0.588 "
    "body.height=1.764 body.mass=87.798"
)
"""A gait without a periodic step from the first guess."""
HUMAN_1 = (
    "gait.step_length=0.568 gait.switching_velocity=0.431 gait.c_y=0.083 gait.c_s=1.289 "
    "body.height=1.636 body.mass=90.361"
)
"""A gait without a periodic step from any start."""
LONG = ("gait.step_length=0.7", "gait.switching_velocity=1.2", "gait.steps=3")


@cache
def body_of(*settings):
    run = load_run(None, list(settings))
    return run, make_body(run).robot


@cache
def tuned(*settings):
    run, robot = body_of(*settings)
    return tune(run, robot)


def found_for(toml, urdf=URDF, *settings):
    """The choices of a body as the example's, with a gait of its size."""
    with TemporaryDirectory() as folder:
        run, robot = body_of(f"body.source='{write(Path(folder), urdf, toml)}'", *settings)
    return tune(first_gait(run, robot.description), robot, advise=False)


def test_a_step_may_be_shorter_than_a_wide_foot_of_a_body_with_a_joint_without_range():
    loose = URDF.replace('waist_pitch" type="revolute"', 'waist_pitch" type="continuous"')
    wide = TOML.replace("front = 0.14", "front = 0.2").replace("half_width = 0.045", "half_width = 0.08")
    stiff = wide + 'range."._knee" = [0.0, 1.2]'  # the step would bend the knee by 1.5 rad
    found = found_for(stiff, loose, "gait.step_length=0.15", "gait.switching_velocity=0.3")
    assert (found.worst(), found.run.foot.toe_off_angle, found.run.gait.step_width > 0.16) == (1.0, 0.0, True)


def plan_of(run, robot):
    return plan_steps(run.gait, run.body.mass, run.foot, robot.description.sole)


@pytest.mark.parametrize(("step", "height"), [(0.22, 1.5), (0.45, 1.9), (0.7, 1.5)])
@pytest.mark.parametrize("c_s", [0.6, 1.4])
def test_the_guess_has_a_plan_whose_heel_rises_with_the_zmp_at_the_ball(step, c_s, height):
    run, robot = body_of(f"gait.step_length={step}", f"gait.c_s={c_s}", f"body.height={height}")
    space = FreeChoices(run, run.given, robot.description)
    guessed = space.parameters(space.guess())
    plan = plan_of(guessed, robot)
    values = plan_margins(plan, guessed, robot.description)
    for name in ("zmp_single", "zmp_double", "mid_stance"):
        assert all(LIMITS[name].margin(value) > 0.0 for value in values[name])
    for key in run.given:
        assert guessed.value(key) == run.value(key)


@pytest.mark.parametrize("source", ["human", "suite-humanoid"])
def test_the_heel_of_a_foot_without_toes_rises_later(source):
    run, robot = body_of(f"body.source='{source}'")
    space = FreeChoices(run, run.given, robot.description)
    guess = space.guess()
    late = space.parameters(guess)
    early = space.parameters({**guess, "rise": 0.0}).foot.heel_rise_lead
    double = plan_of(late, robot).constants.double_support_duration
    share = 0.0 if robot.description.sole.has_toes else 0.4  # of the double support that is left
    assert late.foot.heel_rise_lead == pytest.approx(early - share * (double + early))
    quick = late.replace({"foot.heel_rise_lead": 0.003 - double})
    turn = plan_margins(plan_of(quick, robot), quick, robot.description)["turn"][0]
    assert (LIMITS["turn"].margin(turn) < 0.0) != robot.description.sole.has_toes


def test_feet_without_toes_carry_together_at_the_zmp():
    """Their heel rises with the ZMP near the ball: the front foot gets less than its share."""
    run, robot = body_of("body.source='suite-humanoid'", "gait.steps=2")
    plan, sole = plan_of(run, robot), robot.description.sole
    double = next(phase for phase in plan.contacts.phases if phase.kind == "double_support")
    times = double.start + double.duration * np.linspace(0.01, 0.99, 50)
    times = times[plan.zmp_margin(times) >= 0.0]
    feet, at = plan.feet.sample(times), plan.sample(times)
    right, points = shared_load(feet, at.zmp, at.right_load, sole)
    together = (1.0 - right)[:, None] * points[0] + right[:, None] * points[1]
    assert together[:, :2] == pytest.approx(at.zmp, abs=1e-12)
    assert (right < at.right_load - 0.05).any()
    for foot, x in zip(feet, points[..., 0], strict=True):
        touching = np.repeat(foot.contact, 2, axis=1)
        low, high = (np.where(touching, foot.sole_points[..., 0], end) for end in (np.inf, -np.inf))
        assert (low.min(axis=1) - 1e-9 <= x).all()
        assert (x <= high.max(axis=1) + 1e-9).all()


def test_torques_give_the_accelerations_of_the_step_back():
    """Forward dynamics under torques and the one foot's ground force, against the inverse kinematics."""
    run, robot = body_of("gait.c_y=0.7", "gait.c_s=1.1", "gait.steps=2")
    plan = plan_of(run, robot)
    orbit = rough_orbit(InverseKinematics(robot, run), plan, run, nodes=(12, 6))
    torques, twist = step_torques(orbit.trajectory, orbit.reference.time, plan, robot)
    stance = int(robot.model.frames[robot.sole_frames[0]].parentJoint)
    for k in (1, 4, 8):
        q, v, a = (getattr(orbit.trajectory, name)[k] for name in ("q", "v", "acceleration"))
        sample = plan.sample(orbit.reference.time[k])
        data = robot.model.createData()
        pin.computeCentroidalMomentumTimeVariation(robot.model, data, q, v, a)
        rate, com = data.dhg.vector.copy(), data.com[0].copy()
        force = rate[:3] + np.array([0.0, 0.0, robot.mass * robot.gravity])
        assert force == pytest.approx(sample.force[0], abs=1e-6 * robot.mass * robot.gravity)
        wrench = pin.Force(force, rate[3:] + np.cross(com, force))  # about the world's origin
        pin.forwardKinematics(robot.model, data, q)
        external = pin.StdVec_Force()
        for joint in range(robot.model.njoints):
            external.append(data.oMi[joint].actInv(wrench) if joint == stance else pin.Force.Zero())
        tau = np.concatenate([np.zeros(6), torques[k]])
        about = rate[3:] - np.cross(np.append(sample.zmp[0], 0.0) - com, force)
        assert about[:2] == pytest.approx(0.0, abs=1e-5)  # the ZMP is where it is planned
        assert twist[k] == pytest.approx(about[2] / force[2], abs=1e-6)
        walked = pin.aba(robot.model, robot.model.createData(), q, v, tau, external)
        # The light toes turn by what is left of a moment: the ZMP is behind them, so none is theirs.
        assert walked[:6] == pytest.approx(a[:6], abs=1e-6)
        assert walked[6:] == pytest.approx(a[6:], abs=1e-5)


def test_a_motion_is_found_where_the_guess_has_none():
    found = tuned(*HUMAN_94.split(), "gait.steps=2")
    assert found.worst() >= 0.0
    assert found.run.replace({}) == found.run  # the values found are within the bounds of their keys


def test_starts_are_spread_over_the_ranges_and_always_the_same():
    run, robot = body_of(*HUMAN_94.split())
    space = FreeChoices(run, run.given, robot.description)
    guess = np.array([space.guess()[name] for name in space.names])
    starts = space.spread(guess, 8)
    np.testing.assert_array_equal(starts, space.spread(guess, 8))
    assert ((space.lower <= starts) & (starts <= space.upper)).all()
    assert len(np.unique(starts[:, space.names.index("ratio")])) == 8


def test_starts_end_early_where_none_has_a_periodic_step():
    run, robot = body_of(*HUMAN_1.split())
    with pytest.raises(NoFeasibleChoice) as refusal:
        tune(run, robot, advise=False)
    assert (refusal.value.reason, refusal.value.tried) == ("no_periodic_motion", 5 + 32)  # of 64 starts


def test_what_is_named_stays():
    settings = (*LONG, "gait.com_height=0.87", "foot.toe_off_angle=0.55", "gait.a_s=3.2")
    found = tuned(*settings)
    named = {"gait.com_height": 0.87, "gait.a_s": 3.2, "foot.toe_off_angle": 0.55}
    assert {key: found.run.value(key) for key in named} == named
    assert not named.keys() & found.values.keys()


def test_an_infeasible_gait_is_refused_with_the_limit_and_the_best_that_was_found():
    run, robot = body_of("gait.com_height=0.8", "gait.steps=2")  # the ankle bends too far
    run = run.giving(set(KEYS) - {"body.lean", "foot.swing_lag"})
    with pytest.raises(NoFeasibleChoice, match=r"none in \d+ choices .* ankle") as refusal:
        tune(run, robot)
    error = refusal.value
    assert error.reason == "joint_limits"
    assert error.value < error.limit == LIMITS["ankle"].bound
    assert error.tried > 1


def test_a_gait_of_too_short_steps_is_refused_at_once():
    run, robot = body_of("gait.step_length=0.24", "gait.switching_velocity=1.6", "gait.steps=2")
    with pytest.raises(NoFeasibleChoice, match=r"^no choice of ") as refusal:  # it is proved
        tune(run, robot)
    assert refusal.value.values["pace"] < LIMITS["pace"].target
    assert "lower gait.switching_velocity" in refusal.value.way_out
    assert refusal.value.tried == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    "settings",
    [
        "gait.step_length=0.75 gait.switching_velocity=1.4",
        "gait.step_length=0.25 gait.switching_velocity=0.5 gait.c_s=0.6",
        "gait.step_length=0.465 gait.switching_velocity=0.6",
        "gait.step_length=0.684 gait.switching_velocity=1.3",
        "gait.step_length=0.3",
        "gait.step_length=0.5 gait.c_y=0.08",
        "body.height=1.5 body.mass=47.0",
        "body.height=1.9",
        HUMAN_94,
    ],
)
def test_tuned_gaits_walk(settings):
    run = load_run("normal", [*settings.split(), "gait.steps=8"])
    walked = walk_planned(plan_walk(Request("test", run)))
    assert walked.record.outcome.name == "completed", walked.record.outcome.cause
    metrics = walked.metrics
    assert math.hypot(metrics["zmp_x_rmse"].value, metrics["zmp_y_rmse"].value) < 0.004


def test_a_sweep_tunes_its_runs():
    settings = ("gait.step_length=0.3", "gait.switching_velocity=0.7", "gait.steps=2")
    row = walk_run(request=Request("0", load_run("normal", settings)), profile="default")
    assert row["outcome"] == "completed", row["cause"]
    assert row["gait.a_s"] < 2.0  # the default's 2.63 is for long steps
    assert "gait.step_length" not in row  # only values that were found


def test_a_saved_plan_is_walked_with_the_values_found(ampm, tmp_path):
    path, out = tmp_path / "gait.toml", tmp_path / "run"
    changed = ("plan", "--set", "gait.step_length=0.5", "--steps", 2)
    planned = ampm(*changed, "--save", path, "--json").json
    assert planned["found"].keys() == set(OPEN_KEYS)
    others = {"speed", "edge_handover", "edge_least", "zmp_edge", "sole_roll"}
    assert planned["margins"].keys() == LIMITS.keys() - others
    assert path.read_text().startswith("# normal, gait.step_length 0.5\n")
    assert load_run(path).model_dump() == planned["parameters"]
    again = ampm("plan", path, "--json").json
    assert again == {**planned, "gait": "gait", "found": None, "margins": None}
    answer = ampm("validate", *changed[1:], "--out", out, "--json")  # finds the same
    assert answer.status in (Status.PASS, Status.OUT_OF_TOLERANCE)
    assert answer.json["outcome"] == "completed"
    assert "--as-is" in answer.err
    assert load_run(out / "run.toml").model_dump() == planned["parameters"]
    assert not leaves_open(load_run(out / "run.toml"))


def test_a_change_that_keeps_every_limit_with_room_to_spare_changes_nothing_else():
    run = load_run("normal", ["gait.c_y=0.7", "gait.steps=2"])
    found = tune(run, make_body(run).robot)
    assert (found.run.model_dump(), found.tried) == (run.model_dump(), 1)


@pytest.mark.parametrize("name", PRESETS)
def test_nothing_is_found_for_a_preset_or_a_complete_run(name):
    assert not leaves_open(load_run(name, ["gait.steps=2", "controller.friction=0.5"]))
    changed = load_run(name, ["gait.step_length=0.5"])
    assert not leaves_open(changed.as_is())
    assert leaves_open(changed) == (name != "ipm")
    assert not set(OPEN_KEYS) & changed.given
    assert changed.replace({"body.lean": 0.1}).given == changed.given | {"body.lean"}


@pytest.mark.parametrize(
    ("settings", "limit", "way_out"),
    [
        (("gait.step_length=0.65", "gait.com_height=0.95"), math.nan, "leave gait.com_height open"),
        (("gait.c_y=-1",), 0.0, "raise gait.c_y to 1"),
        *(
            pytest.param(settings.split(), limit, way_out, marks=pytest.mark.slow)
            for settings, limit, way_out in (
                ("gait.switching_velocity=0.26", 0.002, "raise gait.switching_velocity to "),
                ("gait.step_length=0.71 gait.c_s=1.45 gait.c_y=0.3", 1.0, "lower gait.c_s to "),
                ("gait.step_length=0.24 gait.switching_velocity=1.6", 0.175, "lower gait.switching_velocity"),
            )
        ),
    ],
)
def test_a_refusal_tells_ways_out_that_are_accepted(settings, limit, way_out):
    with pytest.raises(RefusedGait) as refusal:
        tuned(*settings)
    error = refusal.value
    assert way_out in error.way_out
    assert error.way_out in str(error)
    assert error.limit == pytest.approx(limit, nan_ok=True)
    told, _, tried = error.way_out.partition(" (tried")
    assert tried
    for way in told.split(", or "):
        changes = [f"{key}={value}" for key, value in re.findall(r"(?:raise|lower) (\S+) to (\S+)", way)]
        opened = re.findall(r"leave (\S+) open", way)
        assert changes or opened
        kept = [setting for setting in settings if setting.partition("=")[0] not in opened]
        run, robot = body_of(*kept, *changes)
        tune(run, robot, advise=False)  # raises if it is refused


@pytest.mark.slow
def test_a_search_that_just_finds_nothing_goes_on(monkeypatch):
    gait = (  # rounded, it is refused on some processors
        "gait.step_length=0.6375269117865057 gait.switching_velocity=0.7646006060884595 "
        "gait.c_y=0.5410677223484168 gait.c_s=1.7144369547596943 "
        "body.height=1.8739174871008115 body.mass=60.11068134594015"
    )
    run, robot = body_of(*gait.split())
    assert tune(run, robot).worst() >= 0.0
    monkeypatch.setattr(tuning, "_TO_FINISH", 1)
    with pytest.raises(NoFeasibleChoice):
        tune(run, robot, advise=False)


def judged(accepted, settings=("gait.step_length=0.7", "gait.c_s=1.4", "gait.c_y=0.4")):
    """Ways out by a function that accepts runs, and the runs and choices that it was asked about."""
    asked = []

    def accepts(run, most):
        asked.append((run, most))
        return accepted(run), most

    run, robot = body_of(*settings)
    return ways_out(run, robot.description, accepts, 100), asked


def test_half_of_a_change_is_told_if_it_is_enough():
    assert judged(lambda run: run.gait.c_s <= 1.2)[0] == "lower gait.c_s to 1.2 (tried and accepted)"
    told, asked = judged(lambda run: run.gait.c_s <= 1.1 or run.gait.step_length <= 0.6)
    assert told == "lower gait.c_s to 1 (tried and accepted)"
    assert len(asked) == 2


def test_half_of_a_change_is_not_asked_about_where_all_choices_are_used():
    told, asked = judged(lambda run: run.gait.step_length <= 0.3)
    assert told.endswith(" (tried and accepted)")
    assert min(most for _, most in asked) >= 1
    assert asked[-1][0].gait.step_length <= 0.3  # all values at once are the last that is asked about


def test_a_way_out_that_rounds_values_tells_them():
    nearly = ("gait.step_length=0.2703", "gait.switching_velocity=0.446", "gait.c_s=1", "gait.c_y=1")
    assert "to 0.27 m (tried" in judged(lambda run: run.gait.step_length == 0.27, nearly)[0]


def test_given_values_are_left_open_first():
    settings = ("gait.step_length=0.5", "gait.com_height=0.8", "gait.a_s=2")
    told, asked = judged(lambda run: "gait.com_height" not in run.given, settings)
    assert told == "leave gait.com_height and gait.a_s open (tried and accepted)"
    assert asked[0][0].gait.com_height == load_run("normal").gait.com_height


def test_a_refusal_without_a_way_out_says_what_was_tried():
    told, _ = judged(lambda run: False, ("gait.step_length=0.5", "controller.friction=0.02"))
    assert told.startswith("not even a gait with gait.step_length = 0.27, ")
    assert told.endswith("was accepted; change controller.friction, or take another body")

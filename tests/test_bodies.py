"""Bodies other than the human: read from MJCF and URDF, described by a few lines, planned for and walked."""

import csv
import tomllib
from importlib import metadata
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest
import tomli_w

from ampm.body.feasibility import joint_groups
from ampm.body.inverse_kinematics import InverseKinematics
from ampm.exceptions import BodilyRefusal
from ampm.parameters import BodyParameters, RunParameters
from ampm.planner import routes
from models.source import body_path
from tests.sweep_table import parse_sweep
from tests.test_body_files import TOML, with_box_feet, write
from tests.test_negative_controls import script
from validation.run.body_check import check as check_body
from validation.run.walk import walk
from validation.store.saved import load_saved_run
from validation.study.sweep.design import dump_sweep
from validation.trial.plan import load_request, make_body, tune_walk

ROOT = Path(__file__).parents[1]
BIPED = ROOT / "docs" / "examples" / "biped.toml"
ROBOTS = ("alexander", "g1", "talos", "romeo", "icub", "simple-humanoid")
PACKAGES = dict.fromkeys(ROBOTS, "example-robot-data") | {"t1": "playground"}
OWN = ("suite-humanoid", str(BIPED))
ALL = (*OWN, *PACKAGES)
with (ROOT / "docs" / "data" / "bodies.csv").open(encoding="utf-8", newline="") as file:
    TABLE = list(csv.DictReader(file))
ZMP_SHARE = 0.01
"""Largest RMS error of the ZMP, over the length of the foot [1]."""


def run_of(source: str) -> RunParameters:
    if (package := PACKAGES.get(source)) is not None:
        try:
            metadata.distribution(package)
        except metadata.PackageNotFoundError:
            pytest.skip(f"needs {package}: .venv/bin/pip install {package}")
    return RunParameters(body=BodyParameters(source=source))


@pytest.mark.parametrize("source", ALL)
def test_body_is_upright_symmetric_and_the_same_in_both_libraries(source: str) -> None:
    body = make_body(run_of(source))
    robot, d, model = body.robot, body.robot.description, body.model.compile()
    data = mujoco.MjData(model)
    assert [model.body_mass.sum(), robot.mass] == pytest.approx([d.mass, d.mass])

    q = pin.neutral(robot.model)
    for joint, angle in d.rest:
        if joint not in (*d.arms, *d.trunk):
            q[robot.velocity_indices((joint,)) + 1] = angle
    terms = robot.jacobian(q)
    np.testing.assert_allclose(terms.sole_turn, np.stack([np.eye(3)] * 2), atol=2e-4)
    assert terms.com[2] - terms.sole[0, 2] == pytest.approx(d.hip_height + d.com_over_hip, abs=0.01)

    # A random posture and its mirror image have mirrored COM and soles.
    rng = np.random.default_rng(1)
    q[7:] = rng.uniform(-0.3, 0.3, robot.nu)
    here = robot.jacobian(q)
    image = robot.jacobian(robot.mirror_q(q))
    np.testing.assert_allclose(image.com, here.com * [1, -1, 1], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(image.sole, here.sole[::-1] * [1, -1, 1], rtol=0.0, atol=1e-9)

    # MuJoCo's COM and sole points are Pinocchio's.
    data.qpos[:7], data.qpos[7:] = [*q[:3], 1.0, 0.0, 0.0, 0.0], q[7:]
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.subtree_com[0], here.com, rtol=0.0, atol=1e-9)
    for leg, place in zip(d.legs, here.sole, strict=True):
        np.testing.assert_allclose(data.site(leg.sole_frame).xpos, place, rtol=0.0, atol=1e-9)


def test_a_sweep_of_another_body_walks_its_gait() -> None:
    text = """
        set."body.source" = "suite-humanoid"
        [[vary]]
        method = "list"
        foot.schedule = ["flat", "roll"]
        """
    definition = parse_sweep(text)
    own = load_request(None, ["body.source=suite-humanoid"]).run
    assert load_request("flat", [f"body.source={BIPED}"]).title == "flat, body.source biped.toml"
    assert definition.gait == "suite-humanoid"
    assert definition.tune
    assert definition.parameters(0) == own.replace({"gait.steps": definition.steps, "foot.schedule": "flat"})
    assert parse_sweep(dump_sweep(definition)) == definition


@pytest.mark.slow
@pytest.mark.parametrize("told", TABLE, ids=[told["body"] for told in TABLE])
def test_every_body_walks_or_is_refused_as_the_table_says(told: dict[str, str]) -> None:
    row = script("bodies").row(told["body"])
    if "is not installed" in row["refused because"]:
        pytest.skip(row["refused because"])
    same = ("refused because", "result", "tolerances met")
    assert {key: row[key] for key in same} == {key: told[key] for key in same}


def test_a_body_without_arms_lets_its_legs_swing() -> None:
    """A pelvis of 10 kg that balanced the legs of 39 kg would pitch by 0.65 rad and turn by 0.25."""
    run_of("alexander")
    planned = tune_walk(load_request(None, ["body.source=alexander"]))
    assert (planned.run.gait.c_s, planned.run.gait.c_y) == (0.8, 0.8)
    assert planned.run.body.angular_momentum_z == "free"
    assert planned.tuned is not None
    assert planned.tuned.worst() > 0.5


def test_a_body_whose_ankles_do_not_roll_keeps_its_legs_upright(tmp_path: Path) -> None:
    text, path = body_path("suite-humanoid").read_text(encoding="utf-8"), tmp_path / "body.toml"
    path.write_text(text.replace("[body]", '[body]\nlock = [".*_ankle_x"]'), encoding="utf-8")
    planned = tune_walk(load_request(None, [f"body.source={path}", "gait.steps=6"]))
    robot, d = planned.body.robot, planned.body.robot.description

    # What the hips carry is a pendulum about the axis between them.
    data = robot.model.createData()
    com = pin.centerOfMass(robot.model, data, pin.neutral(robot.model))[2]
    legs = {joint for leg in d.legs for joint in leg.joints}
    carried = [k for k, name in enumerate(robot.model.names) if k > 0 and name not in legs]
    upper = sum((data.oMi[k].act(robot.model.inertias[k]) for k in carried), pin.Inertia.Zero())
    soles = [pin.updateFramePlacement(robot.model, data, frame).translation for frame in robot.sole_frames]
    lever = upper.lever[2] - (hips := data.oMi[robot.model.getJointId("left_hip_x")].translation[2])
    length = (upper.inertia[0, 0] / upper.mass + lever**2) / lever
    assert d.upright is not None
    c_y = (com - soles[0][2]) / (hips - soles[0][2] + length)
    assert d.upright == pytest.approx((soles[0][1] - soles[1][1], c_y))

    ik = InverseKinematics(robot, planned.run)
    ik.body.miss[[9, 12]] = 1.0, 0.5  # a left sole that rolls; a right one that is not reached
    assert "no angles were found that put the right foot" in ik._miss(0.0).what
    assert planned.run.foot.toe_off_angle == planned.run.foot.heel_rise_lead == 0.0
    turns = [robot.jacobian(q).sole_turn for q in planned.motion.q]
    assert np.abs(np.array(turns)[:, 0, 2, 1]).max() < 0.002  # the standing foot
    trial = walk(planned.run)
    assert trial.record.outcome.completed
    assert trial.metrics["zmp_y_rmse"].value < 0.004
    with pytest.raises(
        BodilyRefusal, match="hinges in each leg is 5 and must be at least 6; walk equal steps"
    ):
        walk(planned.run.as_is(), footsteps=routes.straight(4, 0.1, d.upright.width))
    with pytest.raises(BodilyRefusal, match=r"level along y: its rise is 0\.02"):
        walk(planned.run.replace({"gait.cross_slope": 0.02}))


def test_dry_friction_of_joints_is_overcome_where_the_posture_is_constant(tmp_path: Path) -> None:
    """Apollo as it is proposed; friction of up to 21 N m that began at 0.01 rad/s failed these by 28 %."""
    run_of("t1")  # of the same package
    run = RunParameters(body=BodyParameters(source=script("bodies").describe("apollo", tmp_path)))
    assert walk(run, footsteps=routes.straight(8, 0.25, 0.2)).verdict.passed


def test_a_body_of_ones_own_passes_and_its_folder_has_it(ampm, tmp_path: Path) -> None:
    answer = ampm("validate", "--body", BIPED, "--steps", 4, "--out", tmp_path / "run", "--json")
    assert answer.status == 0, answer.err
    for axis in "xy":
        assert answer.json["metrics"][f"zmp_{axis}_rmse"]["value"] < ZMP_SHARE * 0.21
    description = load_saved_run(tmp_path / "run").body
    assert (description.left_leg.knee, description.sole.length) == ("l_knee", pytest.approx(0.21))
    assert "40.6 kg" in (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert ampm("replay", tmp_path / "run").status == 0


@pytest.mark.slow
def test_check_of_a_body_that_walks_and_of_one_that_cannot(ampm, tmp_path: Path) -> None:
    answer = ampm("body", "check", BIPED, "--set", "foot.schedule=flat", "--json")
    assert answer.status == 0, answer.err
    facts, gait = answer.json["facts"], answer.json["gait"]
    assert facts["mass"][0] == pytest.approx(40.6)
    assert 0.05 < facts["least singular value of a leg, knee bent by 0.6 rad"][0] < 0.2
    assert answer.json["torque"]["knee"] < 0.6
    assert gait["c_y"] == 0.8
    assert gait["step_length"] == pytest.approx(0.3 * facts["height of the hips"][0])
    assert answer.json["found"]["gait.com_height"] == gait["com_height"]
    assert 0.0 < facts["largest tilt of pelvis or trunk, as planned"][0] < 0.5
    assert facts["lowest point of the feet over their soles"][0] is None  # they have no shapes

    weak = TOML + 'effort.".*_ankle_.*" = 2.0\ndamping.".*" = 0.1\n'
    refused = ampm("body", "check", write(tmp_path, toml=weak), "--set", "foot.schedule=flat")
    assert refused.status == 2
    assert "an ankle joint's torque limit is 1.3" in refused.out
    assert "known to the controller: 15." in refused.out


def test_feet_that_do_not_fit_their_soles_are_noted(tmp_path: Path) -> None:
    urdf = "0.24 0.09".join(with_box_feet().rsplit("0.2 0.09", 1))  # the right one is longer
    path = write(tmp_path, urdf=urdf, toml=TOML.replace("bottom = -0.07", "bottom = -0.2"))
    notes = " ".join(check_body(str(path)).notes)
    assert "The feet end 0.13 m over their soles" in notes
    assert "Feet differ in shape" in notes


def test_check_predicts_the_torques_of_the_walk() -> None:
    run_of("talos")
    trial = walk(load_request(None, ["body.source=talos", "gait.steps=4", "simulation.time_step=0.001"]).run)
    description = trial.planned.body.model.description
    # Of the ticks: what is extrapolated between them overshoots where a foot lands.
    share = np.abs(trial.record.tick_torque) / [limit for _, limit in description.torque_limits]
    walked = dict(zip((name for name, _ in description.torque_limits), share.max(axis=0), strict=True))
    predicted = check_body("talos").torque
    groups = joint_groups(description)
    assert predicted.keys() == groups.keys()
    for name, joints in groups.items():
        assert predicted[name] == pytest.approx(max(walked[joint] for joint in joints), abs=0.01), name


def without(source: str, key: str, folder: Path) -> None:
    """A robot whose description lacks a key."""
    run_of(source)
    body = tomllib.loads(body_path(source).read_text(encoding="utf-8"))["body"]
    del body[key]
    path = folder / "robot.toml"
    path.write_text(tomli_w.dumps({"body": body}), encoding="utf-8")
    make_body(run_of(str(path)))

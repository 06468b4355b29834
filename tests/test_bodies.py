"""Bodies other than the human: read from MJCF and URDF, described by a few lines, planned for and walked."""

import csv
import runpy
import tomllib
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from tempfile import TemporaryDirectory

import mujoco
import numpy as np
import pinocchio as pin
import pytest
import tomli_w

from ampm.body.feasibility import joint_groups
from ampm.exceptions import InputError, RefusedGait
from ampm.parameters import BodyParameters, RunParameters
from ampm.tune.first_gait import usual_steps
from models.source import body_path
from tests.test_body_files import TOML, URDF, write
from validation.progress import Progress
from validation.run.body_check import check as check_body
from validation.run.walk import walk
from validation.store.saved import load_description
from validation.study.sweep.design import dump_sweep, load_sweep, parse_sweep
from validation.trial.plan import load_request, make_body, own_gait, tune_walk

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
    assert model.body_mass.sum() == pytest.approx(d.mass)
    assert robot.mass == pytest.approx(d.mass)

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


def test_straight_knee_makes_the_leg_longest() -> None:
    robot = make_body(run_of(str(BIPED))).robot
    leg, q = robot.description.left_leg, pin.neutral(robot.model)

    def length(angle: float) -> float:
        q[robot.knee_joints[0] + 1] = angle
        pin.forwardKinematics(robot.model, robot.data, q)
        hip, ankle = (robot.data.oMi[robot.model.getJointId(name)] for name in (leg.hip[2], leg.ankle[0]))
        return float(np.linalg.norm(hip.translation - ankle.translation))

    assert length(leg.straight_knee) == pytest.approx(robot.description.leg_length)
    assert length(leg.straight_knee) > max(length(leg.straight_knee + d) for d in (-0.05, 0.05))
    assert robot.knee_flexion(q)[0] == pytest.approx(0.05)


def test_a_gait_of_its_own_is_that_of_the_body_again() -> None:
    run = load_request(None, ["body.source='suite-humanoid'"]).run
    assert own_gait(run) == run
    assert own_gait(run).given == run.given


def test_a_sweep_of_another_body_walks_its_gait() -> None:
    text = """
        set."body.source" = "suite-humanoid"
        [[vary]]
        method = "list"
        foot.schedule = ["flat", "roll"]
        """
    definition = parse_sweep(text)
    own = load_request(None, ["body.source=suite-humanoid"]).run
    assert definition.gait == "suite-humanoid"
    assert definition.tune
    assert definition.base == (own,)
    assert parse_sweep(dump_sweep(definition)) == definition
    with pytest.raises(InputError, match=r"body\.source cannot be varied"):
        parse_sweep('vary = [{method = "list", body.source = ["human", "suite-humanoid"]}]')


def test_a_sweep_finds_the_body_beside_its_file(tmp_path: Path) -> None:
    write(tmp_path)
    sweep = tmp_path / "sweep.toml"
    sweep.write_text('set."body.source" = "biped.toml"\n[[vary]]\nmethod = "list"\ngait.c_y = [0.8]', "utf-8")
    assert load_sweep(sweep).base[0].body.source == str(tmp_path / "biped.toml")


def check(trial) -> None:
    length = trial.planned.body.model.description.sole.length
    assert trial.record.outcome.completed
    assert trial.verdict.passed, trial.verdict.reason
    for axis in "xy":
        assert trial.metrics[f"zmp_{axis}_rmse"].value < ZMP_SHARE * length


@pytest.mark.slow
@pytest.mark.parametrize("source", [name for name in ALL if name != "romeo"])
def test_shipped_body_walks_thirty_steps_on_flat_feet(source: str) -> None:
    """Not Romeo, whose ankles bend by 0.785 rad only, which is refused."""
    run_of(source)
    check(walk(load_request(None, [f"body.source='{source}'", "foot.schedule=flat"]).run))


@pytest.mark.slow
@pytest.mark.parametrize("told", TABLE, ids=[told["body"] for told in TABLE])
def test_every_body_walks_or_is_refused_as_the_table_says(
    told: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(ROOT / "docs")
    row = runpy.run_path(str(ROOT / "docs" / "bodies.py"))["row"](told["body"])
    if "is not installed" in row["refused because"]:
        pytest.skip(row["refused because"])
    same = ("result", "tolerances met", "refused because")
    assert {key: row[key] for key in same} == {key: told[key] for key in same}


class Heard(Progress):
    """What was said."""

    text = ""

    def say(self, text: str) -> None:
        self.text += text


def test_a_body_without_arms_lets_its_legs_swing() -> None:
    """A pelvis of 10 kg that balanced the legs of 39 kg would pitch by 0.65 rad and turn by 0.25."""
    run_of("alexander")
    heard = Heard()
    planned = tune_walk(load_request(None, ["body.source=alexander"]), heard)
    gait = planned.run.gait
    assert (gait.c_s, gait.c_y) == (0.8, 0.8)
    assert planned.run.body.angular_momentum_z == "free"
    assert planned.tuned is not None
    assert planned.tuned.worst() > 0.5
    assert "gait.c_s 0.8, gait.c_y 0.8; found gait.com_height" in heard.text
    with pytest.raises(RefusedGait, match=r"lower gait\.c_y to 0\.\d+ \(tried and accepted\)"):
        tune_walk(load_request(None, ["body.source=alexander", "gait.c_y=1.0"]))


def test_folder_has_the_body(ampm, tmp_path: Path) -> None:
    answer = ampm("validate", "--body", BIPED, "--steps", 4, "--out", tmp_path / "run", "--json")
    assert answer.status == 0, answer.err
    for axis in "xy":
        assert answer.json["metrics"][f"zmp_{axis}_rmse"]["value"] < ZMP_SHARE * 0.21
    description = load_description(tmp_path / "run")
    assert description.left_leg.knee == "l_knee"
    assert description.sole.length == pytest.approx(0.21)
    assert (tmp_path / "run" / "recording.rrd").is_file()
    page = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert "40.6 kg" in page
    assert BIPED.stem in page
    assert ampm("replay", tmp_path / "run").status == 0


@pytest.mark.slow
def test_check_of_a_body_that_walks_and_of_one_that_cannot(ampm, tmp_path: Path) -> None:
    answer = ampm("body", "check", BIPED, "--set", "foot.schedule=flat", "--json")
    assert answer.status == 0, answer.err
    facts = answer.json["facts"]
    assert facts["mass"][0] == pytest.approx(40.6)
    assert 0.05 < facts["least singular value of a leg, knee bent by 0.6 rad"][0] < 0.2
    assert answer.json["torque"]["knee"] < 0.6
    assert answer.json["gait"]["c_y"] == 0.8
    assert answer.json["found"]["gait.com_height"] == answer.json["gait"]["com_height"]
    assert 0.0 < facts["largest tilt of pelvis or trunk, as planned"][0] < 0.5
    assert answer.json["gait"]["step_length"] == pytest.approx(0.3 * facts["height of the hips"][0])
    assert any("ellipsoids of their inertia" in note for note in answer.json["notes"])
    assert -0.01 < facts["lowest point of the feet over their soles"][0] <= 0.0
    assert not any("The feet end" in note for note in answer.json["notes"])

    weak = TOML + 'effort.".*_ankle_.*" = 2.0\ndamping.".*" = 0.1\n'
    refused = ampm("body", "check", write(tmp_path, toml=weak), "--set", "foot.schedule=flat")
    assert refused.status == 2
    assert "an ankle joint's torque limit is 1.58" in refused.out
    assert "15 joints have dampers or springs" in refused.out


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("bottom = -0.07", "bottom = -0.2", "The feet end 0.124 m over their soles"),
        ("bottom = -0.07", "bottom = -0.03", "m under their soles, or are not level"),
    ],
)
def test_feet_that_do_not_fit_their_soles_are_noted(old: str, new: str, said: str, tmp_path: Path) -> None:
    path = write(tmp_path, toml=TOML.replace(old, new))
    assert said in " ".join(check_body(str(path)).notes)


def test_check_predicts_the_torques_of_the_walk() -> None:
    run_of("g1")
    trial = walk(load_request(None, ["body.source=g1", "gait.steps=4", "simulation.time_step=0.001"]).run)
    description = trial.planned.body.model.description
    share = np.abs(trial.record.torque) / [limit for _, limit in description.torque_limits]
    walked = dict(zip((name for name, _ in description.torque_limits), share.max(axis=0), strict=True))
    predicted = check_body("g1").torque
    groups = joint_groups(description)
    assert predicted.keys() == groups.keys()
    for name, joints in groups.items():
        assert predicted[name] == pytest.approx(max(walked[joint] for joint in joints), abs=0.03), name


@pytest.mark.slow
def test_speed_limits_refuse_a_gait(tmp_path: Path) -> None:
    path = write(tmp_path, URDF.replace('velocity="14"', 'velocity="1"'))
    settings = [f"body.source='{path}'", "foot.schedule=flat", "gait.step_length=0.35"]
    with pytest.raises(RefusedGait, match="speed limit"):
        tune_walk(load_request(None, settings))


@pytest.mark.slow
def test_icub_without_rotors_diverges_as_it_stands(tmp_path: Path) -> None:
    run_of("icub")
    text = body_path("icub").read_text(encoding="utf-8")
    bare, _ = text.split("[body.armature]")
    (tmp_path / "icub.toml").write_text(bare, encoding="utf-8")
    refusal = check_body(str(tmp_path / "icub.toml")).refusal
    assert "it does not stand for 1 s. The numbers of the simulation diverged" in refusal
    assert "the dampers of l_wrist_prosup, r_wrist_prosup are too strong" in refusal
    line = "armature.'l_wrist_prosup|r_wrist_prosup' = 0.0005"
    assert f"add {line} to the body's description" in refusal
    (tmp_path / "icub.toml").write_text(bare.replace("[body.sole]", f"{line}\n[body.sole]"), encoding="utf-8")
    assert check_body(str(tmp_path / "icub.toml")).refusal == ""


def without(source: str, key: str) -> None:
    """A robot whose description lacks a key."""
    run_of(source)
    body = tomllib.loads(body_path(source).read_text(encoding="utf-8"))["body"]
    del body[key]
    with TemporaryDirectory() as folder:
        path = Path(folder) / "robot.toml"
        path.write_text(tomli_w.dumps({"body": body}), encoding="utf-8")
        make_body(run_of(str(path)))


def test_a_robot_with_slow_joints_has_a_slow_gait_of_its_own() -> None:
    run_of("romeo")
    description = make_body(run_of("romeo")).robot.description
    slow = usual_steps(description)
    quick = usual_steps(replace(description, speed_limits=()))
    assert slow[0] == quick[0]
    assert slow[1] == pytest.approx(0.18 * 2.09 * description.hip_height)
    assert quick[1] == pytest.approx(0.15 * (9.81 * description.hip_height) ** 0.5, rel=1e-3)

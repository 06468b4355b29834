"""The same trial in Drake: one body, one record, one replay; contact and solver are Drake's own."""

import mujoco
import numpy as np
import pytest

from ampm import InputError, load_run
from ampm.physics_parameters import DrakeParameters
from tests.solved import body_of, simulated
from tests.test_bodies import run_of
from validation.store.saved import load_saved_run
from validation.trial import engine as engines
from validation.trial.engine import make_engine
from validation.trial.physics import Physics
from validation.trial.plan import make_body

DRAKE = "simulation.engine=drake"


@pytest.fixture
def drake():
    """A run in Drake with its default contact; skips the test where Drake is not installed."""
    pytest.importorskip("pydrake")
    return load_run("normal", [DRAKE])


def in_the_air(model):
    """A model whose sole points touch nothing."""
    model.geom_contype[:] = 0
    return model


@pytest.mark.parametrize("name", ["human", "suite-humanoid", "g1"])
def test_a_random_step_is_the_same_in_both_engines(drake, name):
    """Masses, axes, armatures, springs and dampers; COM and angular momentum."""
    model = in_the_air(make_body(run_of(name)).model.compile())
    both = [mujoco.MjData(model), mujoco.MjData(model)]
    rng = np.random.default_rng(0)
    pair = make_engine(model, both[0], load_run("normal")), make_engine(model, both[1], drake)
    low, high = np.where(model.jnt_limited[1:, None], model.jnt_range[1:], [-1.0, 1.0]).T
    for _ in range(5):
        root = rng.normal(size=7)
        root[3:] /= np.linalg.norm(root[3:])
        hinges = low + (high - low) * rng.uniform(0.2, 0.8, model.nu)
        rates, torque = 0.3 * rng.normal(size=model.nv), rng.normal(size=model.nu)
        push = rng.normal(size=(model.nbody - 1, 6))
        for data, stepper in zip(both, pair, strict=True):
            data.qpos[:], data.qvel[:], data.ctrl[:] = [*root, *hinges], rates, torque
            data.xfrc_applied[1:] = push
            stepper.step1()
            stepper.step2()
        np.testing.assert_allclose(both[1].sensordata, both[0].sensordata, rtol=0.0, atol=1e-9)
        change = np.abs(both[0].qvel - rates).max()
        np.testing.assert_allclose(both[1].qvel, both[0].qvel, rtol=0.0, atol=1e-9 * max(1.0, change))
        np.testing.assert_allclose(both[1].qpos, both[0].qpos, rtol=0.0, atol=1e-9 * max(1.0, change))


@pytest.mark.parametrize("name", ["human", "g1"])
def test_full_contacts_count_all_of_a_points_acceleration(name):
    run = run_of(name).replace({"contact.acceleration": "full"})
    physics = Physics(make_body(run), run)
    model, data, rng = physics.model, physics.data, np.random.default_rng(0)
    data.qpos[7:] += 0.02 * rng.normal(size=model.nu)
    mujoco.mj_kinematics(model, data)
    data.qpos[2] -= physics.soles[:, 2].mean() + 0.002
    data.qvel[:] = rng.normal(size=model.nv)
    physics.engine.step1()
    full = data.efc_aref.copy()
    mujoco.mj_step1(model, data)
    rate, expected = np.zeros((3, model.nv)), data.efc_aref.copy()
    for contact in data.contact:
        segment, first = model.geom_bodyid[contact.geom[1]], contact.efc_address
        mujoco.mj_jacDot(model, data, rate, None, contact.pos, segment)
        expected[first : first + 3] -= contact.frame.reshape(3, 3) @ rate @ data.qvel
    assert data.ncon >= 4
    assert np.abs(full - data.efc_aref).max() > 1.0
    np.testing.assert_allclose(full, expected, rtol=0.0, atol=1e-10)


@pytest.mark.parametrize("settings", [(), ("disturbance.joint_damping=0.2",)], ids=["human", "damped"])
def test_recorded_forces_and_torques_give_mujocos_step_in_drake(drake, settings):
    """So contact law and solver are the only difference. Dampers are implicit in both engines."""
    record = simulated(*settings)
    model = body_of().compile()
    if settings:
        model.dof_damping[6:] = 0.2
    model, data = in_the_air(model), mujoco.MjData(model)
    stepper = make_engine(model, data, drake)
    segments = [int(model.geom(name).bodyid[0]) for name in record.point_sites]
    worst = []
    for k in range(0, record.steps, 7):
        data.qpos[:], data.qvel[:], data.ctrl[:] = record.q[k], record.qd[k], record.torque[k]
        stepper.step1()
        data.xfrc_applied[:] = 0.0
        for segment, force, at in zip(segments, record.point_force[k], record.point_position[k], strict=True):
            moment = np.cross(at - data.xipos[segment], force)
            data.xfrc_applied[segment] += [*force, *moment]
        stepper.step2()
        worst.append(np.abs(data.qvel - record.qd[k + 1]).max())
    assert len(worst) > 60
    assert np.median(worst) < 1e-10
    assert max(worst) < 1e-4  # where MuJoCo's solver stopped early


def test_a_walk_passes_in_drake_and_replays(drake, ampm, tmp_path):
    out = tmp_path / "run"
    words = "normal --engine drake --steps 2 --set simulation.time_step=0.002 --json".split()
    answer = ampm("validate", *words, "--out", out)
    assert answer.status == 0, answer.err
    metrics, versions = answer.json["metrics"], answer.json["environment"]["versions"]
    assert metrics["equations_defect_maximum"]["value"] < 1e-9  # forces and motion fit to rounding
    assert load_saved_run(out).parameters.drake == DrakeParameters()
    assert f"Drake {versions['drake']}" in (out / "report.html").read_text(encoding="utf-8")
    assert "identical" in ampm("replay", out).out


def test_the_body_walks_over_a_place_that_is_higher(drake):
    settings = ("disturbance.step_height=0.004", "disturbance.step_number=3")
    record = simulated(DRAKE, *settings, steps=3)
    assert record.outcome.completed, record.outcome.cause
    loaded = record.point_force[..., 2] > 1.0
    heights = record.point_position[..., 2][loaded]
    np.testing.assert_allclose(np.unique(heights.round(6)), [0.0, 0.004])
    assert record.point_force[..., 2].min() >= 0.0


def test_a_step_that_drake_cannot_make_ends_the_walk(drake):
    model = body_of().compile()
    data = mujoco.MjData(model)
    stepper = make_engine(model, data, drake)
    data.ctrl[:] = 1e300
    stepper.step1()
    stepper.step2()
    assert data.warning.number[mujoco.mjtWarning.mjWARN_BADQACC] == 1
    np.testing.assert_array_equal(data.qpos, model.qpos0)
    model.dof_frictionloss[8] = 0.1
    with pytest.raises(InputError, match=r"the joint \w+ has dry friction.*--engine mujoco"):
        make_engine(model, data, drake)


def test_without_drake_the_message_has_the_pip_line(monkeypatch, ampm):
    monkeypatch.setattr(engines, "find_spec", lambda name: None)
    answer = ampm("validate", "normal", "--engine", "drake", "--json")
    assert answer.status == 2
    assert "pip install -e '.[drake]'" in answer.json["error"]["message"]

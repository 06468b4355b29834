"""Logs in formats of others: written here by their own libraries from a plan, read, and fitted."""

import numpy as np
import pinocchio as pin
import pytest

import validation as val
from ampm import GaitParameters, InputError
from ampm.planner.periodic import plan_gait
from docs.examples import eurobench
from validation.run.judge_log import log_columns
from validation.store.tables import write_columns

GAIT = GaitParameters(c_s=1.2, c_y=0.4, steps=16)
PLAN = plan_gait(GAIT, 60.0)
STAMPED = """std_msgs/Header header
{fields}
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
================================================================================
MSG: geometry_msgs/Wrench
geometry_msgs/Vector3 force
geometry_msgs/Vector3 torque
"""


def vector(values):
    return dict(zip("xyz", map(float, values), strict=True))


def assert_fitted(fit):
    for name, wanted in (("c_single_x", 1.2), ("c_single_y", 0.4), ("inverse_a_single_x", 1.0 / GAIT.a_s)):
        assert fit.constants[name].value == pytest.approx(wanted, abs=0.01), name


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_force_plates_of_c3d(sign, tmp_path, ampm):
    """A long plate for each foot, z up, at 1000 Hz; the COM as a point at 100 Hz in mm; force or reaction."""
    ezc3d = pytest.importorskip("ezc3d")
    time = np.arange(int(PLAN.duration * 100) * 10) / 1000.0
    sample, seen = PLAN.sample(time), PLAN.sample(time[::10])
    place = 1e3 * sample.zmp - [5000.0, 0.0]  # from the middle of the plate
    force = sample.force
    moment = [place[:, 1] * force[:, 2], -place[:, 0] * force[:, 2]]
    moment.append(place[:, 0] * force[:, 1] - place[:, 1] * force[:, 0])
    file = ezc3d.c3d()
    point, analog = file["parameters"]["POINT"], file["parameters"]["ANALOG"]
    point["RATE"]["value"], point["LABELS"]["value"], point["UNITS"]["value"] = [100.0], ("COM",), ("mm",)
    file["data"]["points"] = np.ones((4, 1, len(seen)))
    file["data"]["points"][:3, 0] = 1e3 * seen.com.T
    analog["RATE"]["value"] = [1000.0]
    analog["LABELS"]["value"] = tuple(f"{kind}{axis}{n}" for n in "12" for kind in "FM" for axis in "xyz")
    both, share = np.vstack([force.T, moment]), sample.right_load
    file["data"]["analogs"] = sign * np.vstack([(1.0 - share) * both, share * both])[None]
    plate = file["parameters"]["FORCE_PLATFORM"]
    plate["USED"]["value"], plate["TYPE"]["value"], plate["ZERO"]["value"] = [2], [2, 2], [1, 0]
    corners = [[10000.0, 2000.0, 0.0], [0.0, 2000.0, 0.0], [0.0, -2000.0, 0.0], [10000.0, -2000.0, 0.0]]
    plate["CORNERS"]["value"] = np.dstack([np.transpose(corners)] * 2)
    plate["ORIGIN"]["value"], plate["CHANNEL"]["value"] = np.zeros((3, 2)), np.arange(1, 13).reshape(2, 6).T
    file.write(str(path := tmp_path / "walk.c3d"))
    table, name = log_columns(path)
    assert name == "walk.c3d"
    np.testing.assert_allclose(table["force_y"], force[:, 1], atol=1e-3)
    np.testing.assert_allclose(table["zmp_x"], sample.zmp[:, 0], atol=1e-5)
    assert_fitted(val.fit_log(path, columns={f"com_{axis}": f"COM_{axis}" for axis in "xyz"}))
    answer = ampm("fit", path, "--com-height", 0.865, "--out", tmp_path / "fit", "--json")
    assert answer.status == 0, answer.err
    assert answer.json["constants"]["c_single_x"]["value"] == pytest.approx(1.2, abs=0.01)


def test_wrenches_of_mcap(tmp_path):
    """Wrenches of two feet about the origin of the world, and the COM, at 200 Hz."""
    writing = pytest.importorskip("mcap_ros2.writer")
    time = np.arange(0.0, PLAN.duration, 0.005)
    sample = PLAN.sample(time)
    share = sample.right_load[:, None]
    forces = {"left": (1.0 - share) * sample.force, "right": share * sample.force}
    kinds = {
        "wrench": ("geometry_msgs/WrenchStamped", "geometry_msgs/Wrench wrench"),
        "point": ("geometry_msgs/Vector3Stamped", "geometry_msgs/Vector3 vector"),
    }
    with (tmp_path / "walk.mcap").open("wb") as stream:
        writer = writing.Writer(stream)
        schemas = {
            key: writer.register_msgdef(name, STAMPED.format(fields=fields))
            for key, (name, fields) in kinds.items()
        }

        def write(topic, kind, at, said):
            header = {"stamp": {"sec": int(at), "nanosec": int(at % 1 * 1e9)}, "frame_id": ""}
            writer.write_message(topic, schemas[kind], {"header": header, **said}, int(at * 1e9))

        for k, at in enumerate(time):
            for foot, force in forces.items():
                arm = np.append(sample.zmp[k], 0.0)
                said = {"force": vector(force[k]), "torque": vector(np.cross(arm, force[k]))}
                write(f"/{foot}_ft", "wrench", at, {"wrench": said})
            write("/com", "point", at, {"vector": vector(sample.com[k])})
        writer.finish()
    names = {f"com_{axis}": f"/com.vector.{axis}" for axis in "xyz"} | {"time": "time"}
    for foot in ("left", "right"):
        names |= {f"{foot}_sensor_{axis}": "zero" for axis in "xyz"}
        for kind in ("force", "torque"):
            names |= {f"{foot}_sensor_{kind}_{axis}": f"/{foot}_ft.wrench.{kind}.{axis}" for axis in "xyz"}
    table, _ = log_columns(tmp_path / "walk.mcap")
    np.testing.assert_allclose(table["time"], time, atol=2e-9)
    assert_fitted(val.fit_log({**table, "zero": np.zeros(len(time))}, columns=names))


def test_a_run_of_eurobench(tmp_path):
    """Kinematics of a model, and wrenches at its soles, at other times than the angles."""
    model = pin.buildSampleModelHumanoid()
    soles = {"left": "lleg_effector_body", "right": "rleg_effector_body"}
    rng, time = np.random.default_rng(1), np.arange(0.0, 1.0, 0.02)
    joints = {
        name: rng.normal(size=50)
        for name, joint in zip(model.names, model.joints, strict=True)
        if joint.nq == 1
    }
    base = {f"base_link_{name}": 0.1 * rng.normal(size=50) for name in ("tx", "ty", "tz", "rz", "ry", "rx")}
    loads = {f"{kind}_{axis}": rng.normal(size=50) for kind in ("force", "torque") for axis in "xyz"}
    tables = {"pos": base | joints, "ftl": loads, "ftr": {name: -load for name, load in loads.items()}}
    for name, columns in tables.items():
        write_columns({"time": time, **columns}, path := tmp_path / f"{name}.csv")
        path.write_text(path.read_text().replace(",", ";"))
    table = eurobench.read_run(tmp_path, model, soles)
    state = pin.neutral(model)
    state[:3] = [base[f"base_link_t{axis}"][7] for axis in "xyz"]
    z, y, x = (base[f"base_link_r{axis}"][7] for axis in "zyx")
    state[3:7] = pin.Quaternion(pin.rpy.rpyToMatrix(x, y, z)).coeffs()
    for name, joint in zip(model.names, model.joints, strict=True):
        if joint.nq == 1:
            state[joint.idx_q] = joints[name][7]
    data = model.createData()
    com = pin.centerOfMass(model, data, state)
    np.testing.assert_allclose([table[f"com_{axis}"][7] for axis in "xyz"], com, atol=1e-12)
    pin.framesForwardKinematics(model, data, state)
    sole = data.oMf[model.getFrameId("rleg_effector_body")].translation
    np.testing.assert_allclose([table[f"right_sensor_{axis}"][7] for axis in "xyz"], sole, atol=1e-12)
    np.testing.assert_allclose(table["left_sensor_torque_y"], loads["torque_y"])
    under = [table[f"{foot}_sensor_z"] for foot in ("left", "right")]
    np.testing.assert_array_equal(table["floor"], np.where(loads["force_z"] > 0.0, *under))
    with pytest.raises(InputError, match="the model has no frame 'paw'"):
        eurobench.read_run(tmp_path, model, {"left": "paw", "right": "paw"})
    (tmp_path / "ftr.csv").write_text("time;force_x\n0;1\n")
    with pytest.raises(InputError, match="has no column 'force_y'"):
        eurobench.read_run(tmp_path, model, soles)


@pytest.mark.parametrize("suffix", ["c3d", "mcap"])
def test_a_broken_file_is_named(suffix, tmp_path, ampm):
    pytest.importorskip("ezc3d")
    pytest.importorskip("mcap_ros2")
    path = tmp_path / f"walk.{suffix}"
    assert "there is no file" in ampm("fit", path, "--out", tmp_path / "a").err
    path.write_bytes(b"no log" * 200)
    answer = ampm("fit", path, "--out", tmp_path / "a")
    assert answer.status == 2
    assert "cannot be read" in answer.err

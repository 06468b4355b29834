"""Constants of the AMPM, fitted to walks whose constants are known, and refusals of what cannot be fitted.

Logs in formats of others are written by their own libraries from a plan, read, and fitted.
"""

import math
import tomllib
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import validation as val
from ampm import GaitParameters, InputError, load_run
from ampm.planner.periodic import plan_gait
from docs.examples import eurobench
from validation.judge.fit import MODELS
from validation.run.judge_log import log_columns
from validation.store.record import write_columns

MASS = 60.0
GAITS: list[dict[str, Any]] = [
    {},
    {"c_s": 1.2, "c_y": 0.4},
    {"step_length": 0.4, "switching_velocity": 0.8},
    {"step_length": 0.7, "switching_velocity": 1.3},
    {"c_s": 0.8, "switching_velocity": 1.2},
    {"c_y": 0.7, "step_width": 0.12},
    {"c_y": 1.3, "step_width": 0.25},
    {"a_s": 4.0, "c_s": 1.3, "single_support_ratio": 0.7},
    {"a_s": math.inf, "single_support_ratio": 0.7, "switching_velocity": 1.2},
    {"com_height": 0.5, "step_length": 0.25, "switching_velocity": 0.6},
]


def table_of(gait, rate=500.0, noise=0.0, seed=0):
    """What sensors would have told of a plan, with noise of 3 N, 2 mm of the ZMP and 1 mm of the COM."""
    plan = plan_gait(gait, MASS)
    random, table = np.random.default_rng(seed), {"time": np.arange(0.0, plan.duration, 1.0 / rate)}
    sample = plan.sample(table["time"])
    for name, size in (("force", 3.0), ("zmp", 2e-3), ("com", 1e-3)):
        for axis, values in zip("xyz", getattr(sample, name).T, strict=False):
            table[f"{name}_{axis}"] = values + random.normal(0.0, noise * size, len(values))
    return table


def truth(gait):
    """Constants of a plan by the names of the fit."""
    of = plan_gait(gait, MASS).constants
    across = of.s / of.beta
    own = ("com_height", "step_length", "step_width", "switching_velocity", "single_support_ratio")
    return {name: getattr(gait, name) for name in own} | {
        "single_support": of.single_support_duration,
        "double_support": of.double_support_duration,
        "inverse_a_single_x": of.inverse_a_s,
        "c_single_x": gait.c_s,
        "inverse_a_double_x": 1.0 / of.a_d,
        "c_double_x": of.c_d,
        "inverse_a_single_y": 0.0,
        "c_single_y": gait.c_y,
        "inverse_a_double_y": 1.0 + across,
        "c_double_y": 1.0 + (1.0 - gait.c_y) * across,
        **{f"b_{support}_{axis}": 0.0 for support in ("single", "double") for axis in "xy"},
    }


def distances(fit, gait):
    """Distances from the true constants over the intervals, with 5e-5 for rounding and interpolation."""
    wanted = truth(gait)
    assert wanted.keys() == fit.constants.keys()
    return {
        name: abs(item.value - wanted[name]) / (item.interval + 5e-5 * max(1.0, abs(wanted[name])))
        for name, item in fit.constants.items()
    }


@pytest.mark.parametrize(
    ("rate", "noise", "measured", "gaits"),
    [(500.0, 0.0, "com", GAITS[1::3]), (500.0, 1.0, "height", GAITS), (100.0, 1.0, "com", GAITS)],
)
def test_gaits_return_their_constants_within_their_intervals(rate, noise, measured, gaits):
    found = []
    for seed, changes in enumerate(gaits):
        gait = GaitParameters(**changes)
        table, height = table_of(gait, rate, noise, seed), None
        if measured == "height":
            height = gait.com_height
            table = {name: values for name, values in table.items() if not name.startswith("com")}
        found += distances(val.fit_log(table, mass=MASS, com_height=height), gait).values()
    assert len(found) == 19 * len(gaits)
    assert np.mean(np.array(found) <= 1.0) >= 0.95
    assert max(found) < 1.5


def test_offsets_and_drift_of_the_plates_are_in_the_intervals():
    gait = GaitParameters(c_s=1.2, c_y=0.4)
    table = table_of(gait, noise=1.0)
    table["force_x"] += 3.0
    table["force_y"] -= 2.0
    table["force_z"] += np.linspace(0.0, 10.0, len(table["time"]))
    clean = val.fit_log(table_of(gait, noise=1.0), mass=MASS)
    for mass in (MASS, None):
        fit = val.fit_log(table, mass=mass)
        assert max(distances(fit, gait).values()) < 1.5
        assert fit.constants["c_single_x"].interval > 2.0 * clean.constants["c_single_x"].interval
    assert any("The body has 60.5" in note for note in fit.notes)


def test_without_angular_momentum_a_rolling_zmp_explains_as_much():
    """Negative control: with c = 1 the AMPM adds nothing; with a ZMP that rests a resting ZMP is enough."""
    fit = val.fit_log(table_of(GaitParameters(**GAITS[8]), noise=1.0), mass=MASS)
    scores = fit.scores
    for signal in ("zmp_x", "zmp_y", "force_x", "force_y"):
        rolling, ampm = (scores[signal][model]["stride"]["share"] for model in MODELS[1:])
        assert rolling > 0.99, signal
        assert ampm == pytest.approx(rolling, abs=2e-3), signal
    assert scores["force_x"]["pendulum"]["single"]["share"] > 0.99
    assert math.isnan(scores["angular_momentum_y"]["ampm"]["stride"]["share"])
    assert "explains 100 % of the ZMP and 100 % of the force" in fit.sentence
    assert "L_y rests" in fit.sentence


def test_a_simulated_walk_returns_its_plan_and_a_gait_to_walk(run_of, tmp_path, ampm, monkeypatch):
    folder = run_of("normal", steps=10)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "normal").symlink_to(folder)  # the name of a preset
    answer = ampm("fit", "./normal", "--out", tmp_path / "fit", "--json")
    assert answer.status == 0, answer.err
    fit, gait = val.fit_log(folder), load_run("normal").gait
    assert max(distances(fit, gait).values()) < 1.5
    assert answer.json["constants"]["c_single_x"]["value"] == fit.constants["c_single_x"].value
    walked = load_run(tmp_path / "fit" / "gait.toml")
    assert walked.gait.step_length == pytest.approx(0.6, abs=1e-3)
    assert answer.json["gait"]["gait"]["step_length"] == walked.gait.step_length
    assert walked.body.mass == pytest.approx(60.0, rel=1e-3)
    assert ampm("plan", tmp_path / "fit" / "gait.toml").status == 0
    assert fit.sentence in (tmp_path / "fit" / "report.html").read_text(encoding="utf-8")
    assert ampm("fit", folder, "--out", tmp_path / "fit").status == 2
    assert ampm("fit", folder, "--out", tmp_path / "fit", "--force").status == 0


def test_a_walk_up_a_slope_returns_its_plan(run_of):
    """Its ZMP and the height of its COM are over the floor under the soles."""
    folder = run_of("normal", {"gait.slope": 0.05, "simulation.time_step": 0.002}, steps=10)
    assert max(distances(val.fit_log(folder), load_run("normal").gait).values()) < 1.5


def test_the_gait_of_a_person_can_be_planned(tmp_path, ampm):
    """Constants as of a person at 1.12 m/s: with the preset's feet the heel would rise too early."""
    gait = GaitParameters(
        com_height=0.995,
        step_length=0.685,
        switching_velocity=1.175,
        single_support_ratio=0.694,
        a_s=3.47,
        c_s=0.84,
        c_y=1.5,
        step_width=0.207,
    )
    val.fit_log(table_of(gait)).save(tmp_path / "fit")
    assert set(tomllib.loads((tmp_path / "fit" / "gait.toml").read_text())) == {"gait", "body"}
    answer = ampm("plan", tmp_path / "fit" / "gait.toml")
    assert answer.status == 0, answer.err


def refit(statement, **options):
    """A fit of a table that a statement changed."""
    table = table_of(GaitParameters())
    exec(statement, {"np": np}, {"table": table})
    val.fit_log(table, **options)


def test_strides_that_differ_are_left_out_and_counted():
    """A gap of half a second, one of the COM alone, and a pause of two seconds in double support."""
    table = table_of(GaitParameters())
    fit = val.fit_log({name: np.delete(values, slice(3000, 3250)) for name, values in table.items()})
    assert len(fit.strides) == 11  # each is fitted with a margin, so that the gap touches two
    unseen = {**table, "com_y": np.where(np.abs(table["time"] - 8.0) < 0.2, np.nan, table["com_y"])}
    assert len(val.fit_log(unseen).strides) == 11
    at = int(np.argmin(np.abs(table["zmp_y"][2000:3000]))) + 2000
    held = {name: np.insert(values, at, np.full(500, values[at])) for name, values in table.items()}
    held["time"] = np.arange(len(held["time"])) / 500.0
    fit = val.fit_log(held)
    assert "others left out" in fit.notes[0]
    assert len(fit.strides) < 13


def test_single_rows_without_force_are_bridged_and_20_hz_is_enough():
    gait = GaitParameters(c_s=1.2, c_y=0.4)
    table = table_of(gait, rate=100.0)
    table["force_z"][::7] = np.nan
    fit = val.fit_log(table, mass=MASS)
    assert len(fit.strides) == 13
    assert max(distances(fit, gait).values()) < 1.0
    assert len(val.fit_log(table_of(gait, rate=20.0)).strides) == 13


def test_a_fall_is_flagged_and_the_strides_before_it_are_fitted():
    """From 8 s on the floor carries nothing, and the COM drops."""
    table = table_of(GaitParameters())
    falls = np.clip(4.0 * (table["time"] - 8.0), 0.0, 1.0)
    for axis in "xyz":
        table[f"force_{axis}"] *= 1.0 - falls
    table["com_z"] *= 1.0 - 0.7 * falls
    fit = val.fit_log(table, mass=MASS)
    assert len(fit.strides) == 4
    assert max(distances(fit, GaitParameters()).values()) < 1.5
    (flag,) = (note for note in fit.notes if "the body falls" in note)
    assert 7.5 < float(flag.split()[1]) < 8.0
    assert not any("the body falls" in note for note in val.fit_log(table_of(GaitParameters())).notes)


def test_without_a_periodic_gait_there_is_no_file(tmp_path):
    """A pendulum with rounding of its constants may stop over the foot; the folder says why."""
    gait = GaitParameters(switching_velocity=0.8)
    fit = val.fit_log(table_of(gait))
    assert fit.gait is not None
    fit.save(tmp_path / "fit")
    plates = {name: values for name, values in table_of(gait).items() if not name.startswith("com")}
    slow = val.fit_log({**plates, "time": 2.0 * plates["time"]}, com_height=gait.com_height)
    slow.save(tmp_path / "fit", force=True)
    assert slow.gait is None
    assert not (tmp_path / "fit" / "gait.toml").exists()
    assert "There is no periodic gait with these constants" in slow.notes[-1]


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


@pytest.mark.parametrize(("sign", "unit"), [(1.0, "mm"), (-1.0, "MM ")])
def test_force_plates_of_c3d(sign, unit, tmp_path, ampm):
    """A long plate for each foot, z up, at 1000 Hz; the COM as a point at 100 Hz in mm; force or reaction.

    A second point has the name of a column of the plates.
    """
    ezc3d = pytest.importorskip("ezc3d")
    time = np.arange(int(PLAN.duration * 100) * 10) / 1000.0
    sample, seen = PLAN.sample(time), PLAN.sample(time[::10])
    place = 1e3 * sample.zmp - [5000.0, 0.0]  # from the middle of the plate
    force = sample.force
    moment = [place[:, 1] * force[:, 2], -place[:, 0] * force[:, 2]]
    moment.append(place[:, 0] * force[:, 1] - place[:, 1] * force[:, 0])
    file = ezc3d.c3d()
    point, analog = file["parameters"]["POINT"], file["parameters"]["ANALOG"]
    point["RATE"]["value"], point["LABELS"]["value"] = [100.0], ("COM", "force")
    point["UNITS"]["value"] = (unit,)
    file["data"]["points"] = np.ones((4, 2, len(seen)))
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
    (cut := tmp_path / "cut.c3d").write_bytes(path.read_bytes()[:100_000])
    with pytest.raises(InputError, match=r"cut\.c3d is cut off after \d+ of \d+ frames; give all of it"):
        log_columns(cut)
    point["UNITS"]["value"] = ()
    file.write(str(path))
    with pytest.raises(InputError, match=r"walk\.c3d: POINT:UNITS is ''; write m, cm or mm"):
        log_columns(path)


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
    with (path := tmp_path / "walk.MCAP").open("wb") as stream:
        writer = writing.Writer(stream)
        text = writer._writer.register_channel("/log", "json", 0)  # read past, as it is not of ROS 2
        writer._writer.add_message(text, 0, b"{}", 0)
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
    table, _ = log_columns(path)
    np.testing.assert_allclose(table["time"], time, atol=2e-9)
    assert_fitted(val.fit_log({**table, "zero": np.zeros(len(time))}, columns=names))
    path.write_bytes(path.read_bytes()[:5000] + bytes(100) + path.read_bytes()[5100:])
    with pytest.raises(InputError, match=r"walk\.MCAP cannot be read as MCAP of ROS 2 \("):
        log_columns(path)


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
    path.write_bytes(b"no log" * 200)
    assert "cannot be read" in ampm("fit", path, "--out", tmp_path / "a").err

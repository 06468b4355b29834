"""Each fault of an instrument has the size that its figures say, a faultless one shows the truth."""

from __future__ import annotations

import json
import math

import mujoco
import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy.signal import butter, sosfreqz

from ampm.exceptions import InputError
from ampm.run_file import load_run
from models.human import build
from tests.saved_run import make_run
from validation.cli.app import Status, call
from validation.measure.instruments.chain import Chain
from validation.measure.instruments.model import (
    PRESETS,
    Acquisition,
    Channel,
    load_instrument,
    make_instrument,
)
from validation.measure.instruments.names import CAUSES, INSTRUMENT_COLUMNS
from validation.measure.instruments.observe import Observation, observe, observe_folder
from validation.measure.instruments.rigs import RIGS
from validation.measure.measure import foot_wrenches
from validation.store.record import load_record
from validation.trial.outcome import Outcome, OutcomeName

DT = 2e-3
FACTS = {"kind": "force-plate"}


def times(rows: int) -> np.ndarray:
    return np.asarray(DT * np.arange(rows), dtype=np.float64)


def chain(rows: int = 20_000, seed: int = 3, key: str = "run", **figures) -> Chain:
    """A chain of one channel; ``figures`` are of the channel or of the acquisition."""
    passed = {name: figures.pop(name) for name in set(figures) & set(Acquisition.model_fields)}
    return Chain([Channel(**figures)], Acquisition(**passed), seed, key, times(rows), DT)


def rms(values) -> float:
    return float(np.sqrt(np.mean(np.asarray(values) ** 2)))


@pytest.fixture
def run_dir(run_of):
    return run_of("normal", steps=8)


@pytest.fixture
def record(run_dir):
    return load_record(run_dir)


@pytest.fixture(scope="module")
def human():
    run = load_run("normal", ())
    model = build(run.body, run.contact, run.simulation)
    return model.compile(), model.description


def look(instrument, record, human, key="run") -> Observation:
    if isinstance(instrument, dict):
        instrument = make_instrument(instrument, "mine")
    seen = observe(instrument, record, key, lambda: human)
    assert seen is not None
    return seen


# ------------------------------------------------------------------------------------------ one by one


@pytest.mark.parametrize("bias", [0.4, 0.0])
def test_bias_is_a_constant_within_its_bound(bias):
    truth = np.sin(np.arange(500.0))[:, None]
    error = chain(500, bias=bias, offset=2.0).read(truth, {"bias"}) - truth
    assert np.ptp(error) < 1e-12
    assert abs(error[0, 0] - 2.0) <= bias + 1e-12


def test_cross_talk_is_a_share_of_the_other_channels_range():
    channels = [Channel(range=10.0), Channel(range=200.0)]
    pair = Chain(channels, Acquisition(), 1, "a", times(3), DT, cross_talk=0.02)
    read = pair.read(np.array([[0.0, 100.0]] * 3), {"cross_talk"})
    assert 0 < abs(read[0, 0]) <= 0.02 * 10.0 * 0.5
    assert read[0, 1] == 100.0


@pytest.mark.parametrize(("order", "cutoff"), [(4, None), (1, 20.0), (2, 50.0), (4, 100.0)])
def test_noise_has_the_bandwidth_of_the_low_pass_or_of_the_steps(order, cutoff):
    bandwidth = 0.5 / DT
    if cutoff is not None:
        sections = butter(order, cutoff, fs=1 / DT, output="sos")
        frequency, response = sosfreqz(sections, worN=8192, fs=1 / DT)
        bandwidth = np.trapezoid(np.abs(response) ** 2, frequency)
    noisy = chain(200_000, noise=0.1, cutoff=cutoff, order=order)
    read = noisy.read(np.zeros((200_000, 1)), {"noise"})
    assert rms(read) == pytest.approx(0.1 * math.sqrt(bandwidth), rel=0.03)
    assert rms(read[:200]) == pytest.approx(rms(read), rel=0.5), "noise is there from the start"
    assert abs(read.mean()) < 25 * rms(read) / math.sqrt(len(read))


def test_quantisation_errs_by_its_step_over_root_twelve_and_range_cuts_off():
    truth = np.cumsum(np.random.default_rng(0).normal(size=(20_000, 1)), axis=0)
    coarse = chain(resolution=0.25, range=1.5)
    read = coarse.read(truth, {"quantisation"})
    assert rms(read - truth) == pytest.approx(0.25 / math.sqrt(12), rel=0.02)
    np.testing.assert_array_equal(read / 0.25, np.round(read / 0.25))
    np.testing.assert_array_equal(coarse.read(truth, {"saturation"}), np.clip(truth, -1.5, 1.5))


@pytest.mark.parametrize("delay", [0.004, 0.0035])
def test_delay_errs_by_the_delay_times_the_slope(delay):
    angle = 2 * np.pi * 0.7 * times(5000)[:, None]
    late = chain(5000, delay=delay)
    error = (late.read(np.sin(angle), {"delay"}) - np.sin(angle))[10:]
    np.testing.assert_allclose(error, -delay * 2 * np.pi * 0.7 * np.cos(angle[10:]), atol=2e-4)
    assert late.latency() == pytest.approx(delay, rel=1e-6)


def test_low_pass_is_a_causal_butterworth():
    time = times(20_000)
    sections = butter(2, 30.0, fs=1 / DT, output="sos")
    _, (fast, slow) = sosfreqz(sections, worN=[2 * np.pi * 10.0 * DT, 2 * np.pi * 0.1 * DT])
    seen = chain(cutoff=30.0, order=2)
    read = seen.read(np.cos(2 * np.pi * 10.0 * time)[:, None], {"filter"})[5000:, 0]
    expected = np.abs(fast) * np.cos(2 * np.pi * 10.0 * time[5000:] + np.angle(fast))
    np.testing.assert_allclose(read, expected, rtol=0.0, atol=1e-9)
    assert seen.latency() == pytest.approx(-np.angle(slow) / (2 * np.pi * 0.1), rel=1e-3)
    step = seen.read(np.full((20_000, 1), 5.0), {"filter"})
    np.testing.assert_allclose(step, 5.0, rtol=0.0, atol=1e-9)  # no transient at the start


def test_sampling_holds_each_sample():
    time = times(5000)
    held, every = chain(5000, rate=100.0), chain(5000, rate=500.0)
    read = held.read(time[:, None], {"sampling"})[:, 0]
    np.testing.assert_allclose(read, np.floor(time * 100.0 + 1e-6) / 100.0, rtol=0.0, atol=1e-12)
    assert held.latency() == pytest.approx(0.004, rel=1e-6)  # of ages 0, 2, ... 8 ms
    np.testing.assert_array_equal(every.read(time[:, None], {"sampling"})[:, 0], time)


def test_all_together_in_the_physical_order():
    both = chain(2000, noise=0.1, bias=1.0, resolution=0.5, range=3.0, cutoff=40.0, rate=100.0, delay=0.004)
    read = both.read(np.full((2000, 1), 2.9), both.effects)
    assert np.abs(read).max() <= 3.0
    np.testing.assert_array_equal(read / 0.5, np.round(read / 0.5))


# ------------------------------------------------------------------------------------------- ZMP


@pytest.mark.parametrize("table", [FACTS, {"kind": "foot-ft"}, {"kind": "foot-ft", "pose": "encoders"}])
def test_a_faultless_instrument_shows_the_truth(table, record, human):
    seen = look(table, record, human)
    np.testing.assert_allclose(seen.zmp, seen.true_zmp, rtol=0.0, atol=1e-12)
    np.testing.assert_array_equal(seen.readings, seen.signals)
    assert set(seen.causes) <= {"method", "kinematics"}
    assert seen.latency == 0.0


def test_plate_bias_moves_the_zmp_by_moment_over_force(record, human):
    seen = look({**FACTS, "moment_xy": {"offset": 3.0}}, record, human)
    vertical = foot_wrenches(record)[0][:, :, 2].sum(axis=1)
    expected = np.column_stack([-6.0 / vertical, 6.0 / vertical])  # both plates
    np.testing.assert_allclose(seen.zmp - seen.true_zmp, expected, rtol=0.0, atol=1e-12)
    assert set(seen.causes) == {"method", "bias"}
    assert seen.causes["bias"]["run"].rmse == pytest.approx(seen.errors["run"].rmse)
    run, single, double = (window.count for window in seen.errors.values())
    assert run == single + double  # by measured contact
    assert min(single, double) > 0
    force = seen.signals[:, 2]
    arm = np.abs(seen.signals[force > 50.0, 4] / force[force > 50.0])
    assert arm.max() < 0.3  # within a foot's length of the plate's middle, however far the walk goes


def test_delay_moves_the_zmp_and_can_be_taken_out(record, human):
    seen = look({**FACTS, "acquisition": {"delay": 0.004}}, record, human)
    late = round(0.004 / record.time_step)
    np.testing.assert_allclose(
        seen.zmp[late:], seen.true_zmp[:-late], atol=2e-3
    )  # the plates' origins change in the swing
    assert seen.latency == pytest.approx(0.004)
    plain, moved = seen.errors["run"], seen.errors_compensated["run"]
    assert moved.rmse[0] < 1e-9 < 1e-3 < plain.rmse[0]
    assert moved.unmeasured == late


def test_threshold_leaves_out_a_foot_that_hardly_presses(record, human):
    seen = look({**FACTS, "threshold": 60.0}, record, human)
    assert seen.errors["run"].rmse[0] > 0.0
    assert seen.causes["method"]["run"].rmse == seen.errors["run"].rmse
    pushed = look({**FACTS, "threshold": 5000.0}, record, human)
    assert pushed.errors["run"].count == 0
    assert pushed.errors["run"].unmeasured == len(pushed.time)
    json.dumps(pushed.row(), allow_nan=False)


def test_same_seed_and_run_give_the_same_readings(record, human):
    table = {**FACTS, "force_z": {"noise": 0.1, "bias": 2.0}}
    first, again, other = (look(table, record, human, key) for key in ("run", "run", "other"))
    np.testing.assert_array_equal(first.readings, again.readings)
    for another in (other, look({**table, "seed": 2}, record, human)):
        assert not np.array_equal(first.readings, another.readings)
    assert first.drawn["bias_left_force_z"] != first.drawn["bias_right_force_z"]
    assert abs(first.drawn["bias_left_force_z"]) <= 2.0


def test_foot_sensor_feels_what_mujocos_own_sensor_feels(run_of):
    directory = run_of("normal", steps=8)
    record = load_record(directory)
    run = load_run(directory / "run.toml", ())
    description = build(run.body, run.contact, run.simulation).description
    text = (directory / "model.xml").read_text(encoding="utf-8")
    model = mujoco.MjModel.from_xml_string(text)
    instrument = make_instrument({"kind": "foot-ft"})
    rig = RIGS[type(instrument)](instrument, record, "", lambda: (model, description))
    spec = mujoco.MjSpec.from_string(text)
    for leg in description.legs:
        spec.body(leg.foot_segment).add_site(name=f"ft_{leg.foot_segment}")
        for kind in (mujoco.mjtSensor.mjSENS_FORCE, mujoco.mjtSensor.mjSENS_TORQUE):
            spec.add_sensor(
                type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=f"ft_{leg.foot_segment}",
                name=f"{kind}_{leg.foot_segment}",
            )  # fmt: skip
    sensing = spec.compile()
    data = mujoco.MjData(sensing)
    rows = np.arange(300, 1500)
    felt = np.empty((len(rows), 12))
    for index, row in enumerate(rows):
        data.qpos[:], data.qvel[:] = record.q[row], record.qd[row]
        mujoco.mj_step1(sensing, data)
        data.ctrl[:] = record.torque[row]
        mujoco.mj_step2(sensing, data)
        felt[index] = -data.sensordata[model.nsensordata :]  # it counts what the leg does to the foot
    error = np.sqrt(np.mean((rig.signals[rows] - felt) ** 2, axis=0))
    size = np.sqrt(np.mean(felt**2, axis=0))
    assert (error < 2e-3 * size + 5e-3).all(), (error, size)


def test_uncompensated_foot_weight_is_an_error_of_the_method(record, human):
    size = {
        how: look({"kind": "foot-ft", "compensation": how}, record, human).errors["run"].rmse[0]
        for how in ("none", "weight", "inertia")
    }
    assert size["inertia"] < 1e-12 < size["weight"] < size["none"]


@pytest.mark.parametrize("mount", ["pelvis", "chest"])
def test_a_perfect_imu_feels_the_motion(record, human, mount):
    seen = look({"kind": "imu", "mount": mount}, record, human)
    assert np.abs(seen.signals[:, 3:].mean(axis=0)[2]) == pytest.approx(9.81, abs=0.5)
    if mount == "pelvis":
        np.testing.assert_array_equal(seen.signals[:, :3], record.qd[:-1, 3:6])
    np.testing.assert_allclose(seen.errors_of_readings["run"].rmse, 0.0, rtol=0.0, atol=1e-12)
    tilted = look({"kind": "imu", "mount": mount, "tilt": 0.02}, record, human)
    # A tilt moves the ZMP by height times angle, but for the accelerations.
    expected = record.com[:, 2].mean() * abs(tilted.drawn["tilt_x"])
    assert abs(tilted.causes["tilt"]["run"].bias[1]) == pytest.approx(expected, rel=0.1)


# --------------------------------------------------------------------------------------- figures, files


@pytest.mark.parametrize("name", PRESETS)
def test_presets_load_and_have_every_cause(name, record, human):
    seen = look(load_instrument(name), record, human)
    assert seen.instrument.name == name
    assert {"noise", "bias", "filter", "delay", "sampling", "quantisation"} <= set(seen.causes) <= set(CAUSES)
    row = seen.row()
    assert set(row) == set(INSTRUMENT_COLUMNS)
    assert row["instrument_zmp_x_rmse"] == seen.errors["run"].rmse[0]
    json.dumps(row, allow_nan=False)


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"kind": "plate"}, "force-plate"),
        ({}, "no kind"),
        ({**FACTS, "treshold": 3.0}, "did you mean 'threshold'"),
        ({**FACTS, "force_z": {"noise": -1.0}}, r"force_z: noise = -1 N/sqrt\(Hz\) must be at least 0"),
        ({**FACTS, "force_z": {"nois": 1.0}}, "force_z: .*did you mean 'noise'"),
        ({**FACTS, "acquisition": {"cutoff": 0.0}}, "must be at least 0.01 Hz"),
        ({**FACTS, "acquisition": {"order": 2.5}}, "whole number"),
        ({**FACTS, "acquisition": {"delay": math.nan}}, "acquisition: delay"),
        ({**FACTS, "force_z": 3.0}, "table of keys"),
        ({"kind": "foot-ft", "pose": "guessed"}, "'true' or 'encoders'"),
        ({"kind": "imu", "threshold": 1.0}, "unknown key"),
    ],
)
def test_bad_figures_are_refused_in_one_sentence(table, words):
    with pytest.raises(InputError, match=words):
        make_instrument(table)


def test_a_low_pass_above_the_steps_rate_is_left_out_and_said_so(record, human):
    seen = look(
        {**FACTS, "acquisition": {"cutoff": 0.8 / record.time_step, "rate": 4.0 / record.time_step}},
        record,
        human,
    )
    assert "left out" in seen.notes[0]
    assert "interpolated" in seen.notes[1]
    assert seen.errors["run"].rmse[0] < 1e-12


def test_a_walk_that_ended_at_once_cannot_be_observed(tmp_path, human):
    end = Outcome(OutcomeName.FELL, 0.0, "It fell.", 0)
    folder = make_run(tmp_path / "run", steps=2, outcome=end)
    for name in PRESETS:
        assert observe(load_instrument(name), load_record(folder), "run", lambda: human) is None
    with pytest.raises(InputError, match="nothing to observe"):
        observe_folder(folder, load_instrument("imu"))


def test_command_prints_json_and_writes_its_files(run_dir, tmp_path, capsys):
    out, plot, own = tmp_path / "seen.parquet", tmp_path / "seen.png", tmp_path / "own.toml"
    own.write_text('kind = "force-plate"\n[moment_xy]\noffset = 3.0\n', encoding="utf-8")
    arguments = ["instrument", str(run_dir), "--instrument", str(own), "--out", str(out), "--plot", str(plot)]
    assert call([*arguments, "--json"]) == Status.PASS
    answer = json.loads(capsys.readouterr().out)
    assert answer["name"] == "own"
    assert answer["causes"]["bias"]["run"]["rmse"][0] == answer["zmp_error"]["run"]["rmse"][0] > 0
    table = pq.read_table(out)
    assert {"time", "true_zmp_x", "instrument_zmp_x", "reading_left_moment_y"} <= set(table.column_names)
    assert plot.read_bytes()[:4] == b"\x89PNG"
    assert call([*arguments]) == Status.REFUSED  # the file exists


def test_a_trial_with_an_instrument_keeps_and_shows_it(run_of, tmp_path, capsys):
    out = tmp_path / "run"
    arguments = ["validate", "normal", "--steps", "2", "--instrument", "force-plate", "--out", str(out)]
    assert call(arguments) == Status.PASS
    assert "force-plate" in capsys.readouterr().out
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert call(["instrument", str(out), "--json"]) == Status.PASS
    again = json.loads(capsys.readouterr().out)
    assert summary["instrument"] == again, "the same from memory as from the folder"
    page = (out / "report.html").read_text(encoding="utf-8")
    assert 'id="instrument"' in page
    assert pq.read_table(out / "instrument.parquet").num_rows == load_record(out).steps
    assert call([*arguments, "--force"]) == Status.PASS  # the folder is still known as a run's

"""Recordings hold the data they are drawn from, and stand side by side on the gait's phase."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from rerun.chunk import RrdReader
from scipy.spatial.transform import Rotation

from ampm.exceptions import InputError
from tests.saved_run import TWO_MS, make_run
from validation.cli.app import Status
from validation.show.curves import DIFFERENCES
from validation.show.rerun.record import SINGLE_SUPPORT, write_recording
from validation.show.rerun.views import PHASE
from validation.store.record import load_record
from validation.store.saved import load_saved_run
from validation.store.signals import load_signals
from validation.trial.files import RunFile

SLOW = ("gait.switching_velocity=0.9", "gait.a_s=2.4")


@pytest.fixture(scope="module")
def walks(tmp_path_factory):
    """Folders of runs with recordings: a gait, the same again but shorter, and a slower one."""
    base = tmp_path_factory.mktemp("walks")
    folders = {
        "one": make_run(base / "one", steps=4),
        "two": make_run(base / "two", steps=2),
        "slow": make_run(base / "slow", steps=4, settings=(*TWO_MS, *SLOW)),
    }
    for folder in folders.values():
        assert write_recording(folder) == folder / RunFile.RECORDING
    return folders


@pytest.fixture
def one(walks):
    return walks["one"]


def assert_rrd(command: str, *files: Path) -> None:
    """Check files by the viewer's own program."""
    words = [sys.executable, "-m", "rerun", "rrd", command, *map(str, files)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr


def entities(path: Path) -> set[str]:
    found = {chunk.entity_path for chunk in RrdReader(path).stream()}
    return {entity for entity in found if not entity.startswith("/__")}  # properties of the recording


def identity(path: Path) -> str:
    """What a viewer tells recordings apart by."""
    (recording,) = RrdReader(path).recordings()
    return str(recording.recording_id)


def batches(path: Path, entity: str, *, static: bool = False) -> list[Any]:
    chunks = RrdReader(path).stream().filter(content=entity)
    return [chunk.to_record_batch() for chunk in chunks if chunk.is_static == static and chunk.num_rows]


def column(path: Path, entity: str, name: str) -> np.ndarray:
    """Values of a component at all times, or one of its time lines [s]."""
    values = batches(path, entity)[0].column(name)
    return np.array(values.to_pylist()) if ":" in name else values.to_numpy() / np.timedelta64(1, "s")


def last_static(path: Path, entity: str, column: str) -> Any:
    """Value of a static component in the viewer: the newest by row id."""
    rows = [
        (batch.column(0)[row].as_py(), batch.column(column)[row].as_py())
        for batch in batches(path, entity, static=True)
        if column in batch.schema.names
        for row in range(batch.num_rows)
    ]
    return max(rows)[1]


def test_series_are_the_signals_bit_for_bit(one):
    signals, path = load_signals(one / "signals.parquet"), one / RunFile.RECORDING
    force = column(path, "/signals/force_z", "Scalars:scalars")
    for index, kind in enumerate(("plan", "command", "measured")):
        assert np.array_equal(force[:, index], signals[f"{kind}_force_z"])
    np.testing.assert_allclose(column(path, "/signals/force_z", "sim_time"), signals["time"], 0, 1e-12)
    zmp = column(path, "/residual/zmp", "Scalars:scalars")
    error = [signals[f"measured_zmp_{axis}"] - signals[f"plan_zmp_{axis}"] for axis in "xy"]
    np.testing.assert_allclose(zmp, 1e3 * np.stack(error, axis=1), rtol=0.0, atol=1e-9)


def test_segments_move_as_the_model_says(one):
    record, path = load_record(one), one / RunFile.RECORDING
    model = mujoco.MjModel.from_xml_string((one / "model.xml").read_text(encoding="utf-8"))
    data = mujoco.MjData(model)
    for name in ("pelvis", "left_foot"):
        places, turns = (
            column(path, f"/world/body/{name}", f"Transform3D:{part}")
            for part in ("translation", "quaternion")
        )
        for row in (0, len(places) // 2, len(places) - 1):
            data.qpos[:] = record.q[row]
            mujoco.mj_kinematics(model, data)
            np.testing.assert_allclose(places[row, 0], data.body(name).xpos, atol=1e-6)
            turned = Rotation.from_quat(turns[row, 0]).as_matrix()
            np.testing.assert_allclose(turned.ravel(), data.body(name).xmat, atol=1e-5)


def test_a_recording_is_sound_small_and_has_what_a_viewer_must_show(walks, one, tmp_path):
    path = one / RunFile.RECORDING
    assert_rrd("verify", path)
    wanted = """world/follow world/plan/polygon world/plan/footprints world/floor/zmp/plan
        world/floor/zmp/measured world/force/plan world/force/measured world/force/left world/force/right
        world/com/measured/trail world/feet/left/sole phase/planned_stance verdict events effort/torque"""
    assert {f"/{name}" for name in [*wanted.split(), *DIFFERENCES]} <= entities(path)
    assert path.stat().st_size / load_record(one).outcome.time < 1e6
    again = write_recording(make_run(tmp_path / "run", steps=4))
    assert_rrd("compare", path, again)  # of an identical run
    assert identity(path) == identity(again) != identity(walks["slow"] / RunFile.RECORDING)
    assert last_static(path, "/__properties", "RecordingInfo:name") == ["normal, simulation.time_step 0.002"]
    os.truncate(again, 99)
    with pytest.raises(InputError, match=r"recording\.rrd has changed"):
        load_saved_run(again.parent)
    again.unlink()  # it can be drawn again
    assert load_saved_run(again.parent)


def test_several_runs_are_in_one_file_with_curves_in_a_colour_of_each(walks, tmp_path, ampm):
    target = tmp_path / "both.rrd"
    assert ampm("view", walks["one"], walks["two"], "--save", target).status == Status.PASS
    assert_rrd("verify", target)
    for letter, name in (("a", "one"), ("b", "two")):
        own = entities(walks[name] / RunFile.RECORDING)
        assert {f"/{letter}{entity}".rstrip("/") for entity in own} <= entities(target)
        shown = last_static(target, f"/{letter}/residual/zmp", "SeriesLines:names")
        assert shown == [f"{name} x", f"{name} y"]
    colours = [last_static(target, f"/{which}/signals/zmp_x", "SeriesLines:colors") for which in "ab"]
    assert not {*colours[0]} & {*colours[1]}


def test_phases_of_different_gaits_coincide_and_data_is_not_touched(walks, tmp_path, ampm):
    target = tmp_path / "both.rrd"
    assert ampm("view", walks["one"], walks["slow"], "--save", target).status == Status.PASS
    signals = load_signals(walks["slow"] / "signals.parquet")
    values = column(target, "/b/signals/force_z", "Scalars:scalars")
    np.testing.assert_array_equal(values[:, 2], signals["measured_force_z"])
    for which, name in (("a", "one"), ("b", "slow")):
        plan = load_saved_run(walks[name]).plan()
        assert plan is not None
        seconds, phase = (column(target, f"/{which}/signals/zmp_x", line) for line in ("sim_time", PHASE))
        assert (np.diff(phase) > 0).all()
        starts = np.array([p.start for p in plan.contacts.phases])
        expected = np.arange(len(starts)) // 2 + np.where(np.arange(len(starts)) % 2, SINGLE_SUPPORT, 0.0)
        # The label of a phase begins at the first sample in it, one step of the simulation late at most.
        pace = 0.005
        np.testing.assert_allclose(np.interp(starts, seconds, phase), expected, atol=pace)
        assert phase[-1] == pytest.approx(4.0, abs=2 * pace)


def test_one_target_is_saved_as_it_is(one, tmp_path, ampm):
    target = tmp_path / "copy.rrd"
    target.write_bytes(b"replaced")
    assert ampm("view", one, "--save", target, "--force").status == Status.PASS
    assert target.read_bytes() == (one / RunFile.RECORDING).read_bytes()

"""Recordings hold the data they are drawn from."""

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
from tests.saved_run import make_run
from validation.cli.view import recording_of
from validation.show.curves import DIFFERENCES
from validation.show.rerun.record import RECORDING_FILE, write_recording
from validation.store.record import load_record
from validation.store.signals import load_signals


@pytest.fixture(scope="module")
def one(tmp_path_factory):
    """Folder of a run with its recording."""
    folder = make_run(tmp_path_factory.mktemp("walks") / "one", steps=4)
    assert write_recording(folder) == folder / RECORDING_FILE
    return folder


def assert_rrd(command: str, *files: Path) -> None:
    """Check files by the viewer's own program."""
    words = [sys.executable, "-m", "rerun", "rrd", command, *map(str, files)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr


def entities(path: Path) -> set[str]:
    return {chunk.entity_path for chunk in RrdReader(path).stream()}


def batches(path: Path, entity: str, *, static: bool = False) -> list[Any]:
    """Record batches of an entity."""
    chunks = RrdReader(path).stream().filter(content=entity)
    return [chunk.to_record_batch() for chunk in chunks if chunk.is_static == static and chunk.num_rows]


def column(path: Path, entity: str, name: str) -> np.ndarray:
    """Values of a component at all times, or one of its time lines [s]."""
    values = batches(path, entity)[0].column(name)
    return np.array(values.to_pylist()) if ":" in name else values.to_numpy() / np.timedelta64(1, "s")


def test_series_are_the_signals_bit_for_bit(one):
    signals, path = load_signals(one / "signals.parquet"), one / RECORDING_FILE
    force = column(path, "/signals/force_z", "Scalars:scalars")
    for index, kind in enumerate(("plan", "command", "measured")):
        assert np.array_equal(force[:, index], signals[f"{kind}_force_z"])
    np.testing.assert_allclose(
        column(path, "/signals/force_z", "sim_time"), signals["time"], rtol=0, atol=1e-12
    )
    zmp = column(path, "/residual/zmp", "Scalars:scalars")
    error = [signals[f"measured_zmp_{axis}"] - signals[f"plan_zmp_{axis}"] for axis in "xy"]
    np.testing.assert_allclose(zmp, 1e3 * np.stack(error, axis=1), rtol=0.0, atol=1e-9)


def test_segments_move_as_the_model_says(one):
    record, path = load_record(one), one / RECORDING_FILE
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


def test_a_recording_is_sound_small_and_has_what_a_viewer_must_show(one, tmp_path):
    path = one / RECORDING_FILE
    assert_rrd("verify", path)
    wanted = """world/follow world/plan/polygon world/plan/footprints world/floor/zmp/plan
        world/floor/zmp/measured world/force/plan world/force/measured world/force/left world/force/right
        world/com/measured/trail world/feet/left/sole phase/planned_stance verdict events effort/torque"""
    assert {f"/{name}" for name in [*wanted.split(), *DIFFERENCES]} <= entities(path)
    assert path.stat().st_size / load_record(one).outcome.time < 1e6
    again = write_recording(make_run(tmp_path / "run", steps=4))
    assert_rrd("compare", path, again)  # of an identical run


def test_runs_of_other_signals_are_other_recordings(one, tmp_path):
    """A viewer puts recordings of one key into one."""
    short = write_recording(make_run(tmp_path / "short", steps=2))
    keys = [RrdReader(path).recordings()[0].recording_id for path in (one / RECORDING_FILE, short)]
    assert keys[0] != keys[1]


def test_a_run_without_a_recording_gets_one_and_a_file_is_shown_as_it_is(tmp_path):
    folder = make_run(tmp_path / "run", steps=2)
    recording = recording_of(folder)
    assert recording == folder / RECORDING_FILE
    assert recording_of(recording) == recording
    with pytest.raises(InputError, match="such as recordings/NAME of a sweep"):
        recording_of(tmp_path)

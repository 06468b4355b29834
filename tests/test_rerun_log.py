"""The recording verifies, holds the data it is drawn from, and can be written of any run."""

import errno
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
from rerun.chunk import RrdReader
from scipy.spatial.transform import Rotation

from tests.saved_run import make_run
from validation.show.curves import DIFFERENCES
from validation.show.rerun.record import RECORDING_FILE, plain_text, verdict_markdown, write_recording
from validation.show.rerun.views import axis_range
from validation.store.record import load_record
from validation.store.saved import load_saved_run
from validation.store.signals import load_signals

COARSE = ("simulation.time_step=0.002",)
"""The recording then has a sample for every row of the signals."""


def assert_rrd(command: str, *files: Path) -> None:
    """Check files by the viewer's own program."""
    words = [sys.executable, "-m", "rerun", "rrd", command, *map(str, files)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory):
    directory = make_run(tmp_path_factory.mktemp("run"), steps=4, settings=COARSE)
    assert write_recording(directory) == directory / RECORDING_FILE
    return directory


def columns(path: Path, entity: str) -> dict[str, np.ndarray]:
    """Temporal columns of one entity, list values as arrays."""
    for chunk in RrdReader(path).stream().filter(content=entity):
        if not chunk.is_static and chunk.num_rows:
            batch = chunk.to_record_batch()
            return {
                name: np.array(batch.column(name).to_pylist()) for name in batch.schema.names if ":" in name
            } | {"time": batch.column("sim_time").to_numpy() / np.timedelta64(1, "s")}
    raise AssertionError(f"{entity} has no rows")


FULL = """
import resource, sys
from validation.show.report import write_report
from validation.show.curves import DIFFERENCES
from validation.show.rerun.record import write_recording

resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
for write in (write_recording, write_report):
    try:
        write(sys.argv[1])
    except OSError as error:
        print(error.errno)
"""


@pytest.mark.slow
def test_a_full_disk_is_an_error_that_leaves_the_earlier_file(run_dir):
    words = [sys.executable, "-c", FULL, str(run_dir)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=120)
    assert done.stdout.split() == [str(errno.EFBIG)] * 2, done.stderr
    assert_rrd("verify", run_dir / RECORDING_FILE)
    assert {path.suffix for path in run_dir.iterdir()} == {".parquet", ".json", ".toml", ".xml", ".rrd"}


def test_series_are_the_signals_bit_for_bit(run_dir):
    signals = load_signals(run_dir / "signals.parquet")
    kept = columns(run_dir / RECORDING_FILE, "/signals/force_z")
    for index, kind in enumerate(("plan", "command", "measured")):
        assert np.array_equal(kept["Scalars:scalars"][:, index], signals[f"{kind}_force_z"])
    np.testing.assert_allclose(kept["time"], signals["time"], rtol=0, atol=1e-12)
    zmp = columns(run_dir / RECORDING_FILE, "/residual/zmp")["Scalars:scalars"]
    error = [signals[f"measured_zmp_{axis}"] - signals[f"plan_zmp_{axis}"] for axis in "xy"]
    np.testing.assert_allclose(zmp, 1e3 * np.stack(error, axis=1), rtol=0.0, atol=1e-9)


def test_segments_move_as_the_model_says(run_dir):
    record = load_record(run_dir)
    model = mujoco.MjModel.from_xml_string((run_dir / "model.xml").read_text(encoding="utf-8"))
    data = mujoco.MjData(model)
    for name in ("pelvis", "left_foot"):
        moved = columns(run_dir / RECORDING_FILE, f"/world/body/{name}")
        for row in (0, len(moved["time"]) // 2, len(moved["time"]) - 1):
            data.qpos[:] = record.q[row]
            mujoco.mj_kinematics(model, data)
            np.testing.assert_allclose(
                moved["Transform3D:translation"][row, 0], data.body(name).xpos, atol=1e-6
            )
            turned = Rotation.from_quat(moved["Transform3D:quaternion"][row, 0]).as_matrix()
            np.testing.assert_allclose(turned.ravel(), data.body(name).xmat, atol=1e-5)
    drawn = np.count_nonzero((model.geom_bodyid > 0) & (model.geom_rbound > 0.005))
    shapes = {
        c.entity_path for c in RrdReader(run_dir / RECORDING_FILE).stream() if c.entity_path.count("/") == 4
    }
    assert sum(name.startswith("/world/body/") for name in shapes) == drawn


def test_recording_is_sound_and_has_what_a_viewer_must_show(run_dir, tmp_path):
    path = run_dir / RECORDING_FILE
    assert_rrd("verify", path)
    wanted = """world/follow world/plan/polygon world/plan/footprints world/floor/zmp/plan
        world/floor/zmp/measured world/force/plan world/force/measured world/force/left world/force/right
        world/com/measured/trail world/feet/left/sole phase/planned_stance verdict events effort/torque"""
    entities = {chunk.entity_path for chunk in RrdReader(path).stream()}
    assert {f"/{name}" for name in [*wanted.split(), *DIFFERENCES]} <= entities
    assert path.stat().st_size / load_record(run_dir).outcome.time < 1e6
    again = write_recording(make_run(tmp_path / "run", steps=4, settings=COARSE))
    assert_rrd("compare", path, again)  # of an identical run


@pytest.mark.slow
def test_a_small_time_step_makes_no_larger_recording(tmp_path):
    run = make_run(tmp_path, steps=2, settings=("simulation.time_step=0.0005",))
    write_recording(run)
    signals = load_signals(run / "signals.parquet")
    time = signals["time"]
    assert (run / RECORDING_FILE).stat().st_size / time[-1] < 1e6
    kept = columns(run / RECORDING_FILE, "/signals/force_z")
    rows = np.searchsorted(time, kept["time"] - 1e-9)
    assert np.array_equal(kept["Scalars:scalars"][:, 2], signals["measured_force_z"][rows])
    switches = np.flatnonzero(signals["phase"][1:] != signals["phase"][:-1]) + 1
    assert len(switches)
    assert {*switches, *(switches - 1), 0, len(time) - 1} <= set(rows)
    changes = sum(np.count_nonzero(np.diff(signals[f"{foot}_contact"])) for foot in ("left", "right"))
    assert len(rows) <= len(time) / 4 + 2 * (len(switches) + changes) + 2
    assert "signals.parquet" in verdict_markdown(load_saved_run(run))


@pytest.mark.parametrize(
    ("low", "high"), [(-90.0, 90.0), (-2.2, 6.4), (0.0, 640.0), (0.862, 0.8684), (3.0, 3.0), (np.nan, np.nan)]
)
def test_an_axis_has_labels_and_room_for_its_values(low, high):
    begin, end = axis_range(np.array([low, np.nan, high]))
    assert not np.isfinite(low) or begin < low <= high < end
    step = 10.0 ** np.floor(np.log10(end - begin))
    # The viewer labels multiples of a power of ten, if there is room for them.
    assert any(2 <= np.floor(end / s) - np.ceil(begin / s) <= 8 for s in (step / 10.0, step))


def test_text_is_kept_to_glyphs_that_the_viewer_has():
    assert plain_text("± ∞, ≥ \N{MINUS SIGN}1 \N{SKULL} °") == "± inf, >= -1 ? °"

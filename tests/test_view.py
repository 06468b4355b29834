"""Several recordings in one: verified, aligned on the gait's phase, without a screen."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rerun.chunk import RrdReader

from ampm.exceptions import InputError
from tests.saved_run import make_run
from tests.test_rerun_log import assert_rrd
from validation.cli.app import Status, call
from validation.cli.view import choose
from validation.show.rerun.record import SINGLE_SUPPORT, write_recording
from validation.show.rerun.views import PHASE
from validation.store.saved import load_saved_run
from validation.store.signals import load_signals
from validation.trial.outcome import Outcome, OutcomeName

COARSE = ("simulation.time_step=0.002",)  # as many samples recorded as measured
SLOW = ("gait.switching_velocity=0.9", "gait.a_s=2.4")


@pytest.fixture(scope="module")
def walks(tmp_path_factory):
    """Folders of runs with recordings: a gait, the same again but shorter, and a slower one."""
    base = tmp_path_factory.mktemp("walks")
    folders = {
        "one": make_run(base / "one", steps=4, settings=COARSE),
        "two": make_run(base / "two", steps=2, settings=COARSE),
        "slow": make_run(base / "slow", steps=4, settings=(*COARSE, *SLOW)),
    }
    for folder in folders.values():
        write_recording(folder)
    return folders


def entities(path: Path) -> set[str]:
    return {chunk.entity_path for chunk in RrdReader(path).stream()}


def batches(path: Path, entity: str, *, static: bool) -> list[Any]:
    """Record batches of an entity."""
    chunks = RrdReader(path).stream().filter(content=entity)
    return [chunk.to_record_batch() for chunk in chunks if chunk.is_static == static]


def last_static(path: Path, entity: str, column: str) -> Any:
    """Value of a static component in the viewer: the newest by row id."""
    rows = [
        (batch.column(0)[row].as_py(), batch.column(column)[row].as_py())
        for batch in batches(path, entity, static=True)
        if column in batch.schema.names
        for row in range(batch.num_rows)
    ]
    return max(rows)[1]


def at_phase(path: Path, entity: str) -> tuple[np.ndarray, np.ndarray]:
    """Seconds and steps of an entity's rows."""
    (batch, *_) = batches(path, entity, static=False)
    seconds, phase = (batch.column(name).to_numpy() / np.timedelta64(1, "s") for name in ("sim_time", PHASE))
    return seconds, phase


def save(*arguments: object) -> int:
    return call(["view", *(str(argument) for argument in arguments)])


def test_several_runs_are_in_one_file_with_curves_in_a_colour_of_each(walks, tmp_path):
    target = tmp_path / "both.rrd"
    assert save(walks["one"], walks["two"], "--save", target) == Status.PASS
    assert_rrd("verify", target)
    for letter, name in (("a", "one"), ("b", "two")):
        own = entities(walks[name] / "recording.rrd")
        assert {f"/{letter}{entity}".rstrip("/") for entity in own} <= entities(target)
    names = [last_static(target, f"/{which}/residual/zmp", "SeriesLines:names") for which in "ab"]
    assert names == [["one x", "one y"], ["two x", "two y"]]
    colours = [last_static(target, f"/{which}/signals/zmp_x", "SeriesLines:colors") for which in "ab"]
    assert not {*colours[0]} & {*colours[1]}
    shown = last_static(target, "/a/signals/zmp_x", "SeriesLines:visible_series")
    assert shown == [True, False, True]  # plan and measurement


def test_phases_of_different_gaits_coincide_and_data_is_not_touched(walks, tmp_path):
    target = tmp_path / "both.rrd"
    assert save(walks["one"], walks["slow"], "--save", target) == Status.PASS
    (batch,) = batches(target, "/b/signals/force_z", static=False)
    values = np.array(batch.column("Scalars:scalars").to_pylist())
    signals = load_signals(walks["slow"] / "signals.parquet")
    np.testing.assert_array_equal(values[:, 2], signals["measured_force_z"])
    for which, name in (("a", "one"), ("b", "slow")):
        plan = load_saved_run(walks[name]).plan()
        assert plan is not None
        seconds, phase = at_phase(target, f"/{which}/signals/zmp_x")
        assert (np.diff(phase) > 0).all()
        starts = np.array([p.start for p in plan.contacts.phases])
        expected = np.arange(len(starts)) // 2 + np.where(np.arange(len(starts)) % 2, SINGLE_SUPPORT, 0.0)
        # The label of a phase begins at the first sample in it, one step of the simulation late at most.
        pace = 0.005
        np.testing.assert_allclose(np.interp(starts, seconds, phase), expected, atol=pace)
        assert phase[-1] == pytest.approx(4.0, abs=2 * pace)


def test_a_walk_that_fell_keeps_the_pace_of_its_last_phase(walks, tmp_path):
    end = Outcome(OutcomeName.FELL, 0.9, "It fell.", 1)
    folder = make_run(tmp_path / "fell", steps=4, outcome=end, settings=COARSE)
    write_recording(folder)
    files = [walks["one"] / "recording.rrd", folder / "recording.rrd"]
    whole, part = (at_phase(file, "/signals/zmp_x") for file in files)
    np.testing.assert_allclose(part[1], np.interp(part[0], *whole), atol=0.02)


def test_one_target_is_saved_as_it_is_and_an_existing_file_is_kept(walks, tmp_path, capsys):
    target = tmp_path / "copy.rrd"
    target.write_bytes(b"mine")
    assert save(walks["one"], "--save", target) == Status.REFUSED
    assert target.read_bytes() == b"mine"
    assert "--force" in capsys.readouterr().err
    assert save(walks["one"], "--save", target, "--force") == Status.PASS
    assert target.read_bytes() == (walks["one"] / "recording.rrd").read_bytes()
    assert save(walks["one"], "--save", tmp_path / "copy.mp4") == Status.REFUSED


def test_the_folder_of_a_sweep_has_no_recording_of_its_own(walks):
    with pytest.raises(InputError, match="such as recordings/NAME of a sweep"):
        choose([walks["one"].parent])

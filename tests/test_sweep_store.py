"""The folder of a sweep: one row per run, every bit of it, nothing of what was written is lost."""

from __future__ import annotations

import csv
import errno
import json
import os
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from ampm.exceptions import InputError
from ampm.parameters import RunParameters
from validation.store import identity
from validation.store.identity import parameter_values, run_key
from validation.study.sweep import store
from validation.study.sweep.design import parse_sweep
from validation.study.sweep.exceptions import SweepStopped
from validation.study.sweep.schema import columns, make_row
from validation.study.sweep.table import read_sweep

ROOT = Path(__file__).resolve().parents[1]
DEFINITION = parse_sweep('[[vary]]\nmethod = "grid"\ngait.c_s = { from = 0.8, to = 1.2, count = 300 }\n')


def row(run: int, outcome: str = "completed", /, **values: object) -> dict[str, object]:
    return make_row(run, f"{run:03d}", {}, {"outcome": outcome, **values})


@contextmanager
def opened(folder: Path) -> Iterator[store.Store]:
    with store.open_store(folder) as sweep:
        sweep.begin(DEFINITION)
        yield sweep


def finished(folder: Path, *rows: dict[str, object]) -> Path:
    with opened(folder) as sweep:
        sweep.append(rows)
        sweep.finish()
    return folder


def test_rows_are_kept_one_per_run_and_the_last_counts(tmp_path):
    folder = tmp_path / "new" / "sweep"
    with opened(folder) as first:
        for run in (3, 1, 2, 0, 5, 4):
            first.append([row(run, "timed_out", timing_total=float(run))])
        first.append([])
    with opened(folder) as again:
        assert read_sweep(folder).metadata["identity"]["settings"]["sweep.seed"] == "1"
        again.append([row(1, "fell"), row(6)])
        ongoing = read_sweep(folder)  # while it is written
        assert not ongoing.complete
        assert ongoing.words("outcome") == ["timed_out", "fell", *["timed_out"] * 4, "completed"]
        again.finish()
    done = read_sweep(folder)
    assert done.complete
    assert done.table.equals(ongoing.table)
    assert done.metadata == ongoing.metadata
    assert parse_sweep(done.metadata["definition"]) == DEFINITION
    assert {path.name for path in folder.iterdir()} == {store.DEFINITION, store.LOCK, store.RESULTS}
    with opened(folder) as third:  # rows of the table are there again, and a later one counts
        third.append([row(0, "completed")])
    assert read_sweep(folder).words("outcome")[:2] == ["completed", "fell"]


def test_either_file_is_complete_whatever_is_killed(tmp_path):
    folder = finished(tmp_path / "a", row(0))
    with store.open_store(folder):  # killed before the rows of the table are in the database
        pass
    assert read_sweep(folder).complete
    with opened(folder):  # killed after the table was written, before the database went
        pass
    assert len(read_sweep(folder)) == 1
    (folder / f".{store.RESULTS}.tmp").write_bytes(b"half")
    (folder / "recordings" / "001.partial-x").mkdir(parents=True)
    with opened(folder) as sweep:
        sweep.finish()
    assert not list(folder.glob(".*"))
    assert not list((folder / "recordings").iterdir())


KILLED = """
import os, signal, sys
from pathlib import Path
from tests.test_sweep_store import opened, row

def kill(statement):
    if statement.startswith(sys.argv[2]):
        os.kill(os.getpid(), signal.SIGKILL)

with opened(Path(sys.argv[1])) as sweep:
    sweep._rows.set_trace_callback(kill)
    sweep.append([row(2)])
"""


@pytest.mark.parametrize("statement", ["INSERT", "COMMIT"])
def test_a_kill_never_leaves_a_row_without_its_recording(tmp_path, statement):
    folder = tmp_path / "a"
    kept, trace = folder / "recordings" / "002" / "report.html", folder / "crashes" / "003.txt"
    for path in (kept, trace):
        path.parent.mkdir(parents=True)
        path.touch()
    with opened(folder) as sweep:
        sweep.append([row(2, "fell", recording="recordings/002"), row(3, "crashed")])
    done = subprocess.run([sys.executable, "-c", KILLED, str(folder), statement], cwd=ROOT)
    assert done.returncode == -signal.SIGKILL
    assert (read_sweep(folder).words("recording")[0], kept.exists()) == ("recordings/002", True)
    with opened(folder) as sweep:  # the run was walked again
        sweep.append([row(2)])
        sweep.finish()
    assert (kept.parent.exists(), trace.exists()) == (False, True)


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT])
def test_a_full_disk_loses_nothing(tmp_path, monkeypatch, number):
    def full(_: int) -> None:
        raise OSError(number, os.strerror(number))

    with opened(tmp_path / "a") as sweep:
        sweep.append([row(0)])
        with monkeypatch.context() as patch:
            patch.setattr(os, "fsync", full)
            with pytest.raises(SweepStopped, match="--resume"):
                sweep.finish()
        assert not (tmp_path / "a" / store.RESULTS).exists()
        pages = sweep._rows.execute("PRAGMA page_count").fetchone()[0]
        sweep._rows.execute(f"PRAGMA max_page_count = {pages}")
        with pytest.raises(SweepStopped, match="--resume"):
            sweep.append([row(run, cause="x" * 400) for run in range(1, 100)])
        sweep._rows.execute("PRAGMA max_page_count = 100000")
        assert sweep.rows()["run"].to_pylist() == [0]
        sweep.append([row(1)])
    assert len(read_sweep(tmp_path / "a")) == 2


def test_folders_that_are_no_sweep_are_named(tmp_path):
    with pytest.raises(InputError, match="there is no"):
        read_sweep(tmp_path / "none")
    with pytest.raises(InputError, match="holds no sweep"):
        read_sweep(tmp_path)
    second = store.open_store(tmp_path / "a")
    with opened(tmp_path / "a"), pytest.raises(InputError, match="another"), second:
        pass
    with opened(tmp_path / "a"):  # the first is done
        pass
    with pytest.raises(InputError, match="no result yet"):
        read_sweep(tmp_path / "a")


def foreign_database(path: Path) -> None:
    with sqlite3.connect(path) as rows:
        rows.execute("CREATE TABLE rows (a)")


def cut_database(path: Path) -> None:
    with opened(path.parent) as sweep:
        sweep.append([row(run) for run in range(200)])
    path.write_bytes(path.read_bytes()[:10_000])


@pytest.mark.parametrize(
    ("name", "damage"),
    [
        (store.ROWS, lambda path: path.write_bytes(b"no database at all" * 1000)),
        (store.ROWS, foreign_database),
        (store.ROWS, cut_database),
        (store.RESULTS, lambda path: path.write_bytes(b"PAR1 no PAR1")),
    ],
)
def test_a_damaged_file_is_named(tmp_path, name, damage):
    folder = finished(tmp_path / "a", row(0))
    damage(folder / name)
    with pytest.raises(InputError, match=name):
        read_sweep(folder)
    with pytest.raises(InputError, match=name), opened(folder) as sweep:
        sweep.rows()


def test_undefined_is_null_and_every_bit_is_kept(tmp_path):
    values: dict[str, object] = {
        "gait.a_s": float("inf"),
        "gait.c_s": 0.1 + 0.2,
        "metric_zmp_x_rmse": float("nan"),
        "margin_knee": -0.0,
    }
    found = read_sweep(finished(tmp_path / "a", row(0, **values))).table.to_pylist()[0]
    assert found["gait.a_s"] == float("inf")
    assert found["gait.c_s"] == 0.1 + 0.2
    assert found["metric_zmp_x_rmse"] is None
    assert str(found["margin_knee"]) == "-0.0"
    with pytest.raises(KeyError):
        row(0, nonsense=1)


def test_every_parameter_and_metric_has_its_column_with_unit_and_meaning(run_of, tmp_path):
    units = {item.name: item.unit for item in columns()}
    assert len(units) == len(columns())
    assert parameter_values(RunParameters()).keys() <= units.keys()
    for item in columns():
        assert item.words, item.name
        assert bool(item.unit) == (item.kind in ("real", "whole")), item.name
    summary = json.loads((run_of("flat", steps=3) / "summary.json").read_text(encoding="utf-8"))
    for metric, entry in summary["metrics"].items():
        assert units.get(f"metric_{metric}", units.get(metric)) == entry["unit"]
    metadata = read_sweep(finished(tmp_path / "a", row(0))).metadata
    assert metadata["columns"]["gait.step_length"]["unit"] == "m"
    assert metadata["tolerances"]["zmp_x_rmse"]["unit"] == "foot length"


def test_the_key_of_a_run_is_of_what_is_not_at_its_default():
    run = RunParameters()
    keys = [
        run_key(parameter_values(changed))
        for changed in (run, run.replace({"gait.steps": 31}), run.replace({"gait.c_s": 1.0 + 2.3e-16}))
    ]
    assert len(set(keys)) == 3
    assert run_key({}) == keys[0]
    assert run_key({"gait.steps": 31}) == keys[1]


def test_the_code_of_a_row_is_all_that_a_walk_imports():
    script = (
        "import sys, validation.run.walk, validation.study.sweep.task; "
        "print(*(getattr(m, '__file__', None) or '' for m in list(sys.modules.values())), sep='\\n')"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    loaded = {Path(line).relative_to(ROOT) for line in done.stdout.split() if line.startswith(f"{ROOT}/")}
    hashed = tuple(Path(folder) for folder in identity.FOLDERS)
    others = {path for path in loaded if path.parts[0] in ("ampm", "models", "validation")}
    others -= {path for path in others for folder in hashed if path.is_relative_to(folder)}
    assert others == {Path("validation", f"{name}.py") for name in ("__init__", "progress", "study/__init__")}


def test_the_documentation_lists_every_column():
    with (ROOT / "docs" / "data" / "sweep-columns.csv").open(encoding="utf-8", newline="") as file:
        _, *listed = csv.reader(file)
    assert listed == [[item.name, item.kind, item.unit, item.words] for item in columns()]

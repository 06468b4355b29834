"""The folder of a sweep: whole parts, one row per run, nothing of what was written is lost."""

from __future__ import annotations

import errno
import json
import os
import re
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from ampm.exceptions import InputError
from ampm.parameters import RunParameters
from validation.study.sweep import columns, store
from validation.study.sweep.columns import parameter_values, run_key, schema, tidy
from validation.study.sweep.design import dump_sweep, parse_sweep
from validation.study.sweep.exceptions import SweepStopped

ROOT = Path(__file__).resolve().parents[1]
DEFINITION = parse_sweep('[[vary]]\nmethod = "grid"\ngait.c_s = { from = 0.8, to = 1.2, count = 300 }\n')
METADATA = store.table_metadata(DEFINITION)


def row(run: int, outcome: str = "completed", /, **values: object) -> dict[str, object]:
    return tidy({"run": run, "name": f"{run:03d}", "outcome": outcome, **values})


def opened(folder: Path, identity: dict[str, object] | None = None) -> store.Store:
    return store.open_store(folder, dump_sweep(DEFINITION), METADATA, identity or {"a": 1}, lambda _: None)


def test_rows_are_kept_one_per_run_and_the_last_counts(tmp_path, monkeypatch):
    monkeypatch.setattr(store, "MERGE", 4)
    folder = tmp_path / "new" / "sweep"
    with opened(folder) as first:
        for run in (3, 1, 2, 0, 5, 4):
            first.append([row(run, "timed_out", timing_total=float(run))])
        first.append([])
    assert len(list((folder / "parts").iterdir())) == 3  # four merged, two by themselves
    with opened(folder) as again:  # numbers go on
        again.append([row(1, "fell"), row(6)])
        table = again.rows()
        assert table is not None
        assert table["run"].to_pylist() == [0, 1, 2, 3, 4, 5, 6]
        assert table["outcome"].to_pylist() == ["timed_out", "fell", *["timed_out"] * 4, "completed"]
        assert not store.load_results(folder).complete
        again.finish(table)
    results = store.load_results(folder)
    assert results.complete
    assert results.table.equals(table)
    assert results.definition == DEFINITION
    assert results.metadata == json.loads(results.table.schema.metadata[columns.TABLE_METADATA])
    assert not list((folder / "parts").iterdir())
    with opened(folder) as third:  # what is walked again after the end counts as well
        third.append([row(0, "completed")])
    assert store.load_results(folder).table["outcome"][0].as_py() == "completed"


def test_what_was_merged_but_not_removed_changes_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(store, "MERGE", 2)
    with opened(tmp_path / "a") as sweep:
        sweep.append([row(0, "timed_out")])
        small = next((tmp_path / "a" / "parts").iterdir())
        kept = small.read_bytes()
        sweep.append([row(0, "fell")])
        assert not small.exists()
        small.write_bytes(kept)
    with opened(tmp_path / "a") as sweep:
        table = sweep.rows()
    assert table is not None
    assert table["outcome"].to_pylist() == ["fell"]


def test_temporaries_are_ignored_and_removed(tmp_path):
    folder = tmp_path / "a"
    with opened(folder) as sweep:
        sweep.append([row(0)])
    (folder / "parts" / ".part-00000002-0.parquet.tmp").write_bytes(b"half")
    (folder / "recordings" / "001.partial-x").mkdir(parents=True)
    (folder / "recordings" / "002").mkdir()
    table = store.read_rows(folder)
    assert table is not None
    assert table.num_rows == 1
    with opened(folder):
        pass
    assert [path.name for path in (folder / "parts").iterdir()] == ["part-00000001-0.parquet"]
    assert [path.name for path in (folder / "recordings").iterdir()] == ["002"]


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT])
def test_a_full_disk_is_told_and_loses_nothing(tmp_path, monkeypatch, number):
    folder = tmp_path / "a"
    with opened(folder) as sweep:
        sweep.append([row(0)])

        def full(_: int) -> None:
            raise OSError(number, os.strerror(number))

        with monkeypatch.context() as patch:
            patch.setattr(os, "fsync", full)
            with pytest.raises(SweepStopped, match=r"no room is left.*--resume"):
                sweep.append([row(1)])
            table = sweep.rows()
            assert table is not None
            with pytest.raises(SweepStopped):
                sweep.finish(table)
        assert [path.name for path in (folder / "parts").iterdir()] == ["part-00000001-0.parquet"]
        sweep.append([row(1)])
        table = sweep.rows()
    assert table is not None
    assert table["run"].to_pylist() == [0, 1]


def test_one_program_at_a_time(tmp_path):
    with (
        opened(tmp_path / "a"),
        pytest.raises(InputError, match="another 'ampm sweep' is writing"),
        opened(tmp_path / "a"),
    ):
        pass
    with opened(tmp_path / "a"):
        pass


def test_a_damaged_part_is_named(tmp_path):
    with opened(tmp_path / "a") as sweep:
        sweep.append([row(0)])
    (tmp_path / "a" / "parts" / "part-00000001-0.parquet").write_bytes(b"PAR1 no PAR1")
    with pytest.raises(InputError, match=r"part-00000001-0\.parquet cannot be read"):
        store.read_rows(tmp_path / "a")


def test_folders_that_are_no_sweep_are_named(tmp_path):
    with pytest.raises(InputError, match="there is no folder"):
        store.load_results(tmp_path / "none")
    with pytest.raises(InputError, match="holds no sweep"):
        store.load_results(tmp_path)
    with opened(tmp_path / "a"):
        pass
    with pytest.raises(InputError, match="no result yet"):
        store.load_results(tmp_path / "a")


def test_undefined_is_null_and_infinity_is_kept(tmp_path):
    values: dict[str, object] = {
        "gait.a_s": float("inf"),
        "metric_zmp_x_rmse": float("nan"),
        "margin_knee": -0.0,
    }
    with opened(tmp_path / "a") as sweep:
        sweep.append([row(0, **values)])
        table = sweep.rows()
    assert table is not None
    found = table.to_pylist()[0]
    assert found["gait.a_s"] == float("inf")
    assert found["metric_zmp_x_rmse"] is None
    assert str(found["margin_knee"]) == "-0.0"
    with pytest.raises(KeyError):
        tidy({"nonsense": 1})


def test_every_parameter_and_metric_has_its_column(run_of):
    names = {item.name for item in columns.columns()}
    assert len(names) == len(columns.columns())
    assert set(parameter_values(RunParameters())) <= names
    summary = json.loads((run_of("flat", steps=3) / "summary.json").read_text(encoding="utf-8"))
    units = {item.name: item.unit for item in columns.columns()}
    for metric, entry in summary["metrics"].items():
        assert units[f"metric_{metric}"] == entry["unit"]


def test_every_column_says_what_it_is(tmp_path):
    for item in columns.columns():
        assert item.words, item.name
        assert bool(item.unit) == (item.kind in ("real", "whole")), item.name
    path = tmp_path / "t.parquet"
    pq.write_table(schema(METADATA).empty_table(), path)
    told = json.loads(pq.read_schema(path).metadata[columns.TABLE_METADATA])
    assert told["columns"]["gait.step_length"] == {
        "unit": "m",
        "words": "distance of successive footprints of opposite feet along x (2 (l_s + l_d))",
    }
    assert told["tolerances"]["zmp_x_rmse"]["unit"] == "m"


def test_the_documentation_lists_every_column():
    text = (ROOT / "docs" / "sweeps.md").read_text(encoding="utf-8")
    listed = re.findall(r"^\| `([^`]+)` \| (\S+) \| ([^|]*) \|", text, flags=re.MULTILINE)
    assert [name for name, *_ in listed] == [item.name for item in columns.columns()]
    for (_, kind, unit), item in zip(listed, columns.columns(), strict=True):
        assert (kind, unit.strip()) == (item.kind, item.unit)


def test_the_key_of_a_run_is_all_that_decides_its_results():
    run = RunParameters()
    keys = {
        run_key(parameter_values(run), "default"),
        run_key(parameter_values(run), "strict"),
        run_key(parameter_values(run), "default", "force-plate"),
        run_key(parameter_values(run.replace({"gait.steps": 31})), "default"),
        run_key(parameter_values(run.replace({"gait.c_s": 1.0 + 2e-16})), "default"),
    }
    assert len(keys) == 5
    assert run_key(parameter_values(RunParameters()), "default") in keys

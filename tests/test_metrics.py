"""A metric of one entry appears in profile, verdict, report, sweep, diff and comparison by itself.

That it appears in a convergence study, too, is in test_convergence.
"""

from __future__ import annotations

import json

import pyarrow.parquet as pq
import pytest

from tests.saved_run import make_run
from validation.cli.app import call
from validation.judge.metrics import Metric, register, unregister
from validation.judge.profiles import DEFAULT
from validation.show.report import render
from validation.store.saved import load_saved_run

LABEL = "COM, mean height"


@pytest.fixture(scope="module")
def metric():
    entry = Metric(
        name="com_height",
        unit="m",
        label=LABEL,
        meaning="mean height of the COM",
        kind="walk",
        compute=lambda walk: float(walk.measured.com[walk.inside, 2].mean()),
        tolerances={"default": 2.0},
        reason="Nobody is taller.",
    )
    yield register(entry)
    unregister(entry.name)


def test_profile_report_and_summary(metric, tmp_path):
    assert DEFAULT.tolerances[-1].metric == metric.name
    folder = make_run(tmp_path / "run")
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["metrics"][metric.name]["pass"] is True
    assert LABEL in render(load_saved_run(folder))
    unregister(metric.name)  # as a new process would be
    try:
        assert LABEL in render(load_saved_run(folder))
    finally:
        register(metric)


def test_sweep_its_report_and_diff(metric, tmp_path, capsys):
    """Workers are processes of their own, which have never seen the entry's file."""
    (tmp_path / "sweep.toml").write_text(
        'sweep = { gait = "flat", steps = 2, recordings = "none" }\n'
        'vary = [{ method = "list", gait.c_s = [1.0, 1.02] }]\n'
    )
    out = tmp_path / "out"
    call(["sweep", str(tmp_path / "sweep.toml"), "--out", str(out), "--workers", "1"])
    (table,) = out.glob("*.parquet")
    rows = pq.read_table(table).to_pylist()
    assert [row["outcome"] for row in rows] == ["completed"] * 2
    assert all(0.8 < row["metric_com_height"] < 1.0 for row in rows)
    assert LABEL in (out / "report.html").read_text()
    capsys.readouterr()
    assert call(["diff", str(out), str(out), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["metrics"][metric.name]
    assert (found["unit"], found["worse"]) == ("m", 0)


def test_comparison(metric, tmp_path, capsys):
    folder = str(make_run(tmp_path / "run"))
    assert call(["compare", folder, folder, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["quantities"][metric.name]["label"] == LABEL

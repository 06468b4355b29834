"""The one table of results: its forms, and the tables of a run from one summary."""

import os
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.test_report import Page
from validation.cli.validate import print_result
from validation.judge.metrics import METRICS
from validation.show.cost_table import cost_table, reported_table
from validation.show.rerun.record import verdict_markdown
from validation.store.metric_table import metric_table
from validation.table import Table, format_number, format_share

SNAPSHOT = Path(__file__).with_name("run_tables.md")
TABLE = Table(
    "walk",
    ["metric", ">value", ""],
    [["signals", "", ""], ["zmp [mm]", "0.59", "pass"], ["a|<b>", "2", "FAIL"]],
    ["A note."],
)


def test_page_has_headings_colours_and_escapes():
    html = TABLE.__html__()
    assert Page(html).open == []
    assert '<th colspan="3" class="group">signals</th>' in html
    assert '<th scope="row">a|&lt;b&gt;</th><td class="n">2</td><td class="red">FAIL</td>' in html
    assert Table("t", ["x"], []).__html__() == ""


def test_rows_must_fit():
    with pytest.raises(ValueError, match="2 cells for 1 columns"):
        Table("t", ["x"], [["1", "2"]])


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.58649, "0.586"), (10186.2, "10186"), (1.234e-9, "1.23e-09"), (1e12, "1e+12"), (None, "–")],
)
def test_numbers_have_no_powers_of_ten_where_they_are_short(value, text):
    assert format_number(value, 3) == text


@pytest.mark.parametrize(
    ("value", "limit", "text"),
    [(0.6, 2.5, "24 %"), (3.0, 2.0, "150 %"), (1e9, 1.0, "> 10000 %"), (1.0, 0.0, ""), (None, 1.0, "")],
)
def test_share_of_a_limit(value, limit, text):
    assert format_share(value, limit) == text
    html = Table("", ["x", ">used"], [["x", text]]).__html__()
    assert ('class="bar over"' in html) == (bool(text) and value > limit)


# ------------------------------------------------------------------------------ tables of a run


def metric(name, value, tolerance, unit, passed, **more):
    known = METRICS[name]
    display = {"value": value, "tolerance": tolerance, "unit": unit, **more.pop("display", {})}
    return {
        "label": known.label,
        "kind": known.kind,
        "unit": known.unit,
        "value": value,
        "tolerance": tolerance,
        "pass": passed,
        "first_step": 0.1,
        "display": display,
        "reason": "Why.",
        **more,
    }


def summary():
    """Contents of a ``summary.json`` with a metric of every kind of verdict."""
    extreme = {"value": 0.5, "time": 1.25, "where": "left_knee_pitch"}
    margins = {item.name.partition("_")[2]: extreme for item in METRICS.values() if item.section == "margins"}
    energy = {item.name.partition("_")[2]: 2.0 for item in METRICS.values() if item.section == "energy"}
    unknown = {"value": None, "time": None, "where": ""}
    return {
        "gait": "normal",
        "profile": "default",
        "outcome": "completed",
        "verdict": "fail",
        "reason": "One is not met.",
        "steps_completed": 6,
        "metrics": {
            "zmp_x_rmse": metric("zmp_x_rmse", 0.586, 2.5, "mm", True, display={"uncertainty": 0.083}),
            "failed_qp": metric("failed_qp", 3.0, 0.0, "", False),
            "force_x_rmse": metric(
                "force_x_rmse",
                0.9,
                0.8,
                "% of body weight",
                None,
                undecided=True,
                display={"uncertainty": "inf"},
            ),
            "zmp_y_rmse": metric("zmp_y_rmse", None, 1.5, "mm", None),
            "com_x_rmse": metric("com_x_rmse", 0.03, None, "mm", None),
        },
        "margins": {**margins, "clearance": unknown, "friction_available": 0.8},
        "effort": {name: [0.001, None, 0.003] for name in ("force", "zmp", "angular_momentum")},
        "energy": energy,
        "solver": {"ticks": 100, "unsolved": 3, "time_median": 8e-6, "time_p99": 3.2e-5},
        "timing": {"simulated": 4.0, "real_time_factor": 3.9},
        "scales": {"body_weight": 600.0},
        "uncertainty": {"gait": "normal", "steps": 6},
    }


def test_tables_of_a_run_are_those_of_the_snapshot():
    """``AMPM_SNAPSHOT=1 pytest tests/test_result_table.py`` writes it anew; look at the difference."""
    said = summary()
    found = "\n".join(table(said).markdown() for table in (metric_table, cost_table, reported_table))
    if os.environ.get("AMPM_SNAPSHOT"):
        SNAPSHOT.write_text(found, encoding="utf-8")
    assert found == SNAPSHOT.read_text(encoding="utf-8")
    rows = set(re.findall(r"^\| (.*?) \|", found, re.MULTILINE))
    assert {item.label for item in METRICS.values() if item.section} <= rows
    said["margins"]["plan_polygon"] = {"value": 1e-4, "time": 2.6, "where": ""}
    assert len(cost_table(said).notes) == 2  # the ZMP passes the ball


def test_terminal_and_recording_show_the_tables(capsys):
    said = summary()
    print_result(said, Path("run"))
    out = capsys.readouterr().out
    shown = [[cell.strip() for cell in line.split("│")[1:-1]] for line in out.splitlines() if "│" in line]
    tables = metric_table(said), cost_table(said)
    assert shown == [list(row) for table in tables for row in table.rows]
    assert "normal: FAIL  One is not met." in out
    record = SimpleNamespace(outcome=SimpleNamespace(name="completed"), time_step=5e-4)
    saved: Any = SimpleNamespace(summary=said, table=lambda: tables[0], record=record, is_log=False)
    text = verdict_markdown(saved)
    assert "| unsolved QPs | 3 | 0 |  |  | FAIL |" in text
    assert "| ground force, RMS error along x | 0.9 ± inf | 0.8 | % BW | 112 % | undecided |" in text
    assert "Every time step (0.5 ms) is in `signals.parquet`." in text

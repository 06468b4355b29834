"""The one table of results: its forms, and the tables of a run from one summary."""

import json
import math
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
from validation.table import Table, with_uncertainty

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
    assert '<th scope="row">pass</th>' in Table("t", ["better"], [["pass"]]).__html__()  # a walk's name


def test_latex_breaks_the_lines_of_long_cells():
    assert r"{@{}lp{.5\linewidth}@{}}" in Table("t", ["x", "y"], [["a", 71 * "b"]]).tex()


@pytest.mark.parametrize(
    ("value", "doubt", "text"),
    [
        (1.2004, 0.00241, "1.2004 ± 0.0024"),
        (123.4, 25.0, "123 ± 25"),
        (0.6000132, 3.7e-6, "0.6000132 ± 0.0000037"),
        (-2.6e-6, 1.6e-4, "0.00000 ± 0.00016"),
        (7e-13, 1.1e-12, "(0.7 ± 1.1)e-12"),
        (0.0, 3e-9, "(0.0 ± 3.0)e-9"),
        (0.6, None, "0.6"),
        (0.6, 0.0, "0.6 ± 0"),
        (0.6, math.inf, "0.6 ± ∞"),
        (math.inf, 0.1, "inf ± 0.1"),
    ],
)
def test_a_value_is_cut_at_the_second_digit_of_its_uncertainty(value, doubt, text):
    assert with_uncertainty(value, doubt) == text


@pytest.fixture
def said():
    """Contents of a ``summary.json`` with a metric of every kind of verdict, every margin and energy."""
    found = json.loads(Path(__file__).with_name("run_summary.json").read_text(encoding="utf-8"))
    numbers = {"margins": {"value": 0.5, "time": 1.25, "where": "left_knee_pitch"}, "energy": 2.0}
    for section, value in numbers.items():
        names = (item.name.partition("_")[2] for item in METRICS.values() if item.section == section)
        found[section] = {**dict.fromkeys(names, value), **found[section]}
    return found


def test_tables_of_a_run_are_those_of_the_snapshot(said):
    """``AMPM_SNAPSHOT=1 pytest tests/test_result_table.py`` writes it anew; look at the difference."""
    found = "\n".join(table(said).markdown() for table in (metric_table, cost_table, reported_table))
    if os.environ.get("AMPM_SNAPSHOT"):
        SNAPSHOT.write_text(found, encoding="utf-8")
    assert found == SNAPSHOT.read_text(encoding="utf-8")
    rows = set(re.findall(r"^\| (.*?) \|", found, re.MULTILINE))
    assert {item.label for item in METRICS.values() if item.section} <= rows
    said["margins"]["plan_polygon"] = {"value": 1e-4, "time": 2.6, "where": ""}
    assert len(cost_table(said).notes) == 2  # the ZMP passes the ball


def test_terminal_and_recording_show_the_tables(said, capsys):
    print_result(said, Path("run"))
    out = capsys.readouterr().out
    shown = [[cell.strip() for cell in line.split("│")[1:-1]] for line in out.splitlines() if "│" in line]
    tables = metric_table(said), cost_table(said)
    assert shown == [list(row) for table in tables for row in table.rows]
    assert "normal: FAIL  One is not met. ampm explain run says why." in out
    print_result(said, Path("run"), wrote=False)  # judged by another profile
    print_result({**said, "verdict": "undecided"}, Path("run"))
    assert "ampm explain" not in capsys.readouterr().out
    record = SimpleNamespace(outcome=SimpleNamespace(name="completed"), time_step=5e-4)
    saved: Any = SimpleNamespace(title="normal", summary=said, record=record, is_log=False)
    saved.table = lambda: tables[0]
    text = verdict_markdown(saved)
    assert text.startswith("# normal: ")
    assert "| unsolved QPs | 3 | 0 |  |  | FAIL |" in text
    assert "| ground force, RMS error along x | 0.9 ± inf | 0.8 | % BW | 112 % | undecided |" in text
    assert "Every time step (0.5 ms) is in `signals.parquet`." in text

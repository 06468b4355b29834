"""The audit of the paper: its verdicts follow from checks, its page is in step, its command behaves."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest
import sympy as sp
from rich.console import Console

from ampm.planner.periodic import plan_gait
from ampm.run_file import load_run
from validation.cli.app import Status, call
from validation.paper.audit import audit
from validation.paper.audit.rows import Check, Evidence, Ledger, Row, Verdict, assemble
from validation.paper.audit.table import FILE_WIDTH, describe, errata_table, print_rows, summary, write_csv

DOCS = Path(__file__).resolve().parents[1] / "docs"
OF_WORDS = {"E21", "E26", "E30", "E33"}
"""Errata that only two places of the paper can show."""
ERRATA = [f"E{number}" for number in range(1, 35)]


@pytest.fixture(scope="module")
def rows():
    return audit()


def rows_of(rows, erratum):
    return [row for row in rows if erratum in row.errata]


# ------------------------------------------------------------------ verdicts


def test_every_row_agrees_with_itself(rows):
    assert [(row.section, row.place) for row in rows if not row.consistent] == []


def test_the_paper_is_read_from_top_to_bottom(rows):
    sections = list(dict.fromkeys(row.section for row in rows))
    assert sections == ["abstract", "1", "1.1", "1.2", "2", "2.1", "2.2", "2.3", "3", "4"]
    places = [row.place for row in rows]
    assert len(places) == len({(row.section, row.place) for row in rows})
    for number in range(1, 13):
        assert any(re.match(rf"Eq\. {number}\b", place) for place in places), number
    for figure in (1, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12):
        assert any(re.match(rf"Fig\. {figure}\b", place) for place in places), figure


@pytest.mark.parametrize("erratum", ERRATA)
def test_every_erratum_is_found(rows, erratum):
    """The printed form fails, and the corrected form passes."""
    found = [row for row in rows_of(rows, erratum) if row.verdict is not Verdict.HOLDS]
    assert found
    checks = [check for row in found for check in row.checks]
    if erratum in OF_WORDS:
        assert all(check.kind == "text" for check in checks)
        return
    printed = [check for check in checks if check.form == "printed" and check.kind != "text"]
    corrected = [check for check in checks if check.form == "corrected"]
    assert any(not check.passed for check in printed)
    assert corrected
    assert all(check.passed for check in corrected)


@pytest.mark.parametrize("erratum", ERRATA[:18])
def test_what_a_misprint_does_has_a_number(rows, erratum):
    numbers = [
        check
        for row in rows_of(rows, erratum)
        for check in row.checks
        if check.form == "printed" and check.kind == "numeric" and not check.passed
    ]
    assert numbers
    assert all(isinstance(check.value, float) and np.isfinite(check.value) for check in numbers)


def test_what_cannot_be_tested_says_why(rows):
    for row in rows:
        if row.verdict is Verdict.UNTESTED:
            assert row.why.endswith(".")


def test_every_erratum_has_a_number(rows):
    assert set(ERRATA) == {erratum for row in rows for erratum in row.errata}


# ------------------------------------------------------- numbers, by other ways


def value_of(rows, place, quantity):
    return next(
        check.value
        for row in rows
        if row.place == place
        for check in row.checks
        if check.quantity.startswith(quantity) and check.form == "printed"
    )


def test_sizes_of_misprints_on_the_normal_gait(rows):
    run = load_run("normal")
    plan = plan_gait(run.gait, run.body.mass)
    gait, constants, weight = run.gait, plan.constants, plan.weight
    lever = 2.0 * gait.step_length * (1.0 - constants.inverse_a_s)  # 2 d (1 - a)/c, the foot ahead by a step
    assert abs(value_of(rows, "moment r", "mismatch")) == pytest.approx(weight * lever)
    assert abs(value_of(rows, "momentum omega", "mismatch")) == pytest.approx(
        weight * lever * constants.single_support_duration, rel=1e-6
    )
    assert value_of(rows, "single support, r_x", "mismatch") == pytest.approx(
        2.0 * weight * gait.c_y * constants.s
    )
    assert value_of(rows, "Fig. 4, ZMP", "jump") == pytest.approx(2.0 * constants.l_s * constants.inverse_a_s)
    assert value_of(rows, "v_swing", "jump") == pytest.approx(
        constants.l_s / constants.single_support_duration
    )


def test_the_spline_jumps_as_scipy_says(rows):
    from scipy.interpolate import CubicSpline

    run = load_run("normal")
    constants = plan_gait(run.gait, 60.0).constants
    duration = constants.single_support_duration
    ends = ((1, constants.l_s / duration), (1, 0.0))
    spline = CubicSpline([0.0, duration], [0.0, 2.0 * run.gait.step_length], bc_type=ends)
    assert value_of(rows, "cubic spline", "jump") == pytest.approx(float(spline(0.0, 2)))


# ------------------------------------------------------------------ the parts


def row_with(checks=None, **others):
    return Row("2", "Eq. 1", "a = b", checks=(checks or Evidence()).checks, **others)


def jump(printed=None, corrected=None):
    return Evidence().zero("jump", "m", printed, corrected)


@pytest.mark.parametrize(
    ("checks", "verdict"),
    [
        (None, Verdict.UNTESTED),
        (jump(0.0), Verdict.HOLDS),
        (jump(0.0).zero("jump", "m", 0.1, 1e-14), Verdict.ERRATUM),
        (Evidence().against("two places"), Verdict.ERRATUM),
    ],
)
def test_verdicts_follow_from_checks(checks, verdict):
    assert row_with(checks).verdict is verdict
    assert row_with(jump(0.1), failure=Verdict.CONTRADICTED).verdict is Verdict.CONTRADICTED


def test_rows_that_do_not_agree_with_themselves():
    whole = {"corrected": "a = c", "errata": ("E1",)}
    assert row_with(jump(0.1, 0.0), **whole).consistent
    assert not row_with(jump(0.1, 0.0)).consistent  # an erratum without its correction
    assert not row_with(jump(0.1), **whole).consistent  # nobody has checked the correction
    assert not row_with(jump(0.1, 0.1), **whole).consistent
    assert not row_with().consistent  # not tested, and no word why
    assert row_with(why="A drawing.").consistent


def test_checks_show_what_matters():
    a, b = sp.symbols("a b")
    checks = Evidence().symbolic("difference", [(a + b) ** 2 - a**2 - 2 * a * b])
    checks.symbolic("difference", sp.sin(a) ** 2 + sp.cos(a) ** 2 - 1)
    checks.zero("jump", "m", 1e-14).zero("jump", "m", 0.123456).zero("jump", "m", float("nan"))
    checks.sign("positive", "rate", "1", 1.5).sign("negative", "rate", "1", 1.5)
    assert [check.shown() for check in checks.checks] == [
        "b^2", "0", "0 m", "0.1235 m", "nan m", "1.5", "1.5"
    ]  # fmt: skip
    assert [check.passed for check in checks.checks] == [False, True, True, False, False, True, False]
    assert Check("printed", "text", "words", None, "", False).shown() == ""


def test_a_statement_is_checked_once_and_must_be_listed():
    ledger = Ledger()
    ledger("2", "Eq. 1")
    with pytest.raises(ValueError, match="two sets"):
        ledger("2", "Eq. 1")
    ledger("9", "Eq. 99")
    with pytest.raises(ValueError, match="Eq"):
        assemble(ledger)


# ------------------------------------------------------- page, table, command


def test_the_page_is_in_step(rows, tmp_path):
    """Written by ``python -m validation.paper.audit``."""
    page = (DOCS / "errata.md").read_text(encoding="utf-8")
    assert errata_table(rows) in page
    assert summary(rows) in page
    write_csv(rows, tmp_path / "audit.csv")
    assert (DOCS / "data" / "audit.csv").read_bytes() == (tmp_path / "audit.csv").read_bytes()


def test_the_table_can_be_read_at_100_columns(rows, capsys):
    print_rows(rows, Console(width=FILE_WIDTH, highlight=False))
    out = capsys.readouterr().out
    assert max(len(line) for line in out.splitlines()) <= FILE_WIDTH == 100
    assert "…" not in out
    assert "l_s/c_s + l_d/c_d" in out
    assert summary(rows) in out


def test_the_counts_add_up(rows):
    described = describe(rows)
    assert sum(described["counts"].values()) == len(described["rows"]) == len(rows)
    assert described["consistent"]
    assert [row["number"] for row in described["rows"]] == list(range(1, len(rows) + 1))


@pytest.fixture
def quick(monkeypatch, rows):
    """The command without the work."""
    monkeypatch.setattr("validation.paper.audit.audit", lambda _: rows)


@pytest.mark.usefixtures("quick")
def test_json_is_alone_on_stdout(rows, capsys):
    assert call(["audit", "--json"]) == Status.PASS
    answer = json.loads(capsys.readouterr().out)
    assert len(answer["rows"]) == len(rows)
    row = next(row for row in answer["rows"] if row["place"] == "Eq. 4")
    assert row["verdict"] == "erratum"
    assert row["errata"] == ["E4"]
    assert {item["form"] for item in row["evidence"]} == {"printed", "corrected"}
    assert row["evidence"][0].keys() == {"form", "kind", "quantity", "value", "unit", "gait", "passed"}


@pytest.mark.usefixtures("quick")
def test_the_command_prints_the_table(rows, capsys):
    assert call(["audit"]) == Status.PASS
    assert summary(rows) in capsys.readouterr().out


def test_a_correction_that_fails_is_told(monkeypatch, capsys):
    broken = row_with(jump(0.1, 0.1), corrected="a = c", errata=("E1",))
    monkeypatch.setattr("validation.paper.audit.audit", lambda _: (broken,))
    assert call(["audit"]) == Status.OUT_OF_TOLERANCE
    assert "Eq. 1" in capsys.readouterr().err


def test_without_sympy_the_way_out_is_one_sentence(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "sympy", None)
    assert call(["audit"]) == Status.REFUSED
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert "pip install sympy" in captured.err

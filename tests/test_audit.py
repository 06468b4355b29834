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
from scipy.interpolate import CubicSpline

from ampm.planner.periodic import plan_gait
from ampm.run_file import load_run
from validation.cli.app import Status, call
from validation.paper.audit import audit
from validation.paper.audit.rows import Row, Verdict
from validation.paper.audit.table import FILE_WIDTH, KINDS, errata_table, print_rows, summary, write_csv

DOCS = Path(__file__).resolve().parents[1] / "docs"
OF_WORDS = {"E21", "E26", "E30", "E33"}
"""Errata that only two places of the paper can show."""
ERRATA = [f"E{number}" for number in range(1, 35) if number != 22]


@pytest.fixture(scope="module")
def rows():
    return audit()


# ------------------------------------------------------------------ verdicts


def test_rows_agree_with_themselves_and_follow_the_paper(rows):
    assert [(row.section, row.place) for row in rows if not row.consistent] == []
    sections = list(dict.fromkeys(row.section for row in rows))
    assert sections == ["abstract", "1", "1.1", "1.2", "2", "2.1", "2.2", "2.3", "3", "4"]
    places = " ".join(f"{row.place};" for row in rows)
    equations = {int(number) for number in re.findall(r"Eq\. (\d+)\b", places)}
    figures = {int(number) for number in re.findall(r"Fig\. (\d+)\b", places)}
    assert equations == set(range(1, 13))
    assert figures == set(range(1, 13))
    assert {erratum for row in rows for erratum in row.errata} == set(ERRATA)
    assert all(row.why.endswith(".") for row in rows if row.verdict is Verdict.UNTESTED)


@pytest.mark.parametrize("erratum", ERRATA)
def test_every_erratum_is_found(rows, erratum):
    """The printed form fails, by a number for a misprint, and the corrected form passes."""
    found = [row for row in rows if erratum in row.errata]
    checks = [check for row in found if row.verdict is not Verdict.HOLDS for check in row.checks]
    assert checks
    if erratum in OF_WORDS:
        assert all(check.kind == "text" for check in checks)
        return
    assert any(check.form == "printed" and check.kind != "text" and not check.passed for check in checks)
    corrected = [check for check in checks if check.form == "corrected"]
    assert corrected
    assert all(check.passed for check in corrected)
    if erratum in ERRATA[:18]:
        numbers = [
            check.value
            for row in found
            for check in row.of("printed")
            if check.kind == "numeric" and not check.passed
        ]
        assert numbers
        assert np.isfinite(numbers).all()


# ------------------------------------------------------- numbers, by other ways


def value_of(rows, place, quantity):
    return next(
        check.value
        for row in rows
        if row.place == place
        for check in row.of("printed")
        if check.quantity.startswith(quantity)
    )


def test_sizes_of_misprints_on_the_normal_gait(rows):
    run = load_run("normal")
    plan = plan_gait(run.gait, run.body.mass)
    gait, constants, weight = run.gait, plan.constants, plan.weight
    duration = constants.single_support_duration
    lever = 2.0 * gait.step_length * (1.0 - constants.inverse_a_s)  # 2 d (1 - a)/c, the foot ahead by a step
    ends = ((1, constants.l_s / duration), (1, 0.0))
    spline = CubicSpline([0.0, duration], [0.0, 2.0 * gait.step_length], bc_type=ends)
    for place, quantity, size in (
        ("moment r", "mismatch", weight * lever),
        ("momentum omega", "mismatch", weight * lever * duration),
        ("single support, r_x", "mismatch", 2.0 * weight * gait.c_y * constants.s),
        ("Fig. 4, ZMP", "jump", 2.0 * constants.l_s * constants.inverse_a_s),
        ("v_swing", "jump", constants.l_s / duration),
        ("cubic spline", "jump", float(spline(0.0, 2))),
    ):
        assert abs(value_of(rows, place, quantity)) == pytest.approx(size, rel=1e-6), place


# ------------------------------------------------------------------ the parts


def row(**others) -> Row:
    return Row("2", "Eq. 1", "a = b", **others)


def jump(printed, *corrected, **others) -> Row:
    return row(**others).zero("jump", "m", printed, *corrected)


@pytest.mark.parametrize(
    ("checked", "verdict"),
    [
        (row(), Verdict.UNTESTED),
        (jump(0.0), Verdict.HOLDS),
        (jump(0.0).zero("jump", "m", 0.1, 1e-14), Verdict.ERRATUM),
        (row().against("two places"), Verdict.ERRATUM),
        (jump(0.1, failure=Verdict.CONTRADICTED), Verdict.CONTRADICTED),
    ],
)
def test_verdicts_follow_from_checks(checked, verdict):
    assert checked.verdict is verdict


WHOLE = {"corrected": "a = c", "errata": ("E1",)}


@pytest.mark.parametrize(
    ("checked", "consistent"),
    [
        (jump(0.1, 0.0, **WHOLE), True),
        (jump(0.1, 0.0), False),  # an erratum without its correction
        (jump(0.1, **WHOLE), False),  # nobody has checked the correction
        (jump(0.1, 0.1, **WHOLE), False),
        (row(), False),  # not tested, and no word why
        (row(why="A drawing."), True),
        (row(**WHOLE).against("two places"), True),
    ],
)
def test_rows_that_do_not_agree_with_themselves(checked, consistent):
    assert checked.consistent is consistent


def test_checks_show_what_matters():
    a, b = sp.symbols("a b", positive=True)
    checked = row().symbolic("difference", [(a + b) ** 2 - a**2 - 2 * a * b])
    checked.symbolic("difference", sp.sin(a) ** 2 + sp.cos(a) ** 2 - 1)
    checked.zero("jump", "m", 1e-14).zero("jump", "m", 0.123456).zero("jump", "m", float("nan"))
    checked.sign("positive", "rate", "1", 1.5).sign("negative", "rate", "1", 1.5)
    checked.claim("printed", "rate, to be positive", (a * b).is_positive, a * b).against("words")
    assert [(check.shown, check.passed) for check in checked.checks] == [
        ("b^2", False), ("0", True), ("0 m", True), ("0.1235 m", False), ("nan m", False), ("1.5", True),
        ("1.5", False), ("a b", True), ("", False),
    ]  # fmt: skip


# ------------------------------------------------------- page, table, command


def test_the_page_is_in_step(rows, tmp_path):
    """Written by ``python -m validation.paper.audit``."""
    page = (DOCS / "errata.md").read_text(encoding="utf-8")
    assert sorted(n for numbers in KINDS.values() for n in numbers) == [int(name[1:]) for name in ERRATA]
    for kind in KINDS:
        assert errata_table(rows, kind) in page
    assert summary(rows) in page
    write_csv(rows, tmp_path / "audit.csv")
    assert (DOCS / "data" / "audit.csv").read_bytes() == (tmp_path / "audit.csv").read_bytes()


def test_the_table_can_be_read_at_100_columns(rows, capsys):
    print_rows(rows, Console(width=FILE_WIDTH, highlight=False))
    out = capsys.readouterr().out
    assert max(len(line) for line in out.splitlines()) <= FILE_WIDTH == 100
    assert "…" not in out
    assert "l_s/c_s + l_d/c_d" in out


@pytest.fixture
def quick(monkeypatch, rows):
    """The command without the work."""
    monkeypatch.setattr("validation.paper.audit.audit", lambda _: rows)


@pytest.mark.usefixtures("quick")
def test_json_is_alone_on_stdout_and_its_counts_add_up(rows, capsys):
    assert call(["audit", "--json"]) == Status.PASS
    answer = json.loads(capsys.readouterr().out)
    assert answer["consistent"]
    assert sum(answer["counts"].values()) == len(rows)
    assert [row["number"] for row in answer["rows"]] == list(range(1, len(rows) + 1))
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
    monkeypatch.setattr("validation.paper.audit.audit", lambda _: (jump(0.1, 0.1, **WHOLE),))
    assert call(["audit"]) == Status.OUT_OF_TOLERANCE
    assert "Eq. 1" in capsys.readouterr().err


def test_without_sympy_the_way_out_is_one_sentence(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "sympy", None)
    assert call(["audit"]) == Status.REFUSED
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert "pip install sympy" in captured.err

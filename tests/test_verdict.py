"""Verdicts: limits of the profiles, what passes, what fails, what was never measured, and the summary."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ampm.exceptions import InputError
from tests.walk import STILL, perfect_walk, with_state
from validation.judge.compare import compare
from validation.judge.metrics import BODY_WEIGHT
from validation.judge.profiles import DEFAULT, PROFILES, STRICT, WIDE, profile
from validation.judge.verdict import VerdictName, build_summary, judge
from validation.trial.record import Outcome, OutcomeName

DOCS = Path(__file__).parents[1] / "docs" / "tolerances.md"


def compare_walk(plan, record, measured):
    """Compare, with an instrument that weighs a still body right."""
    return compare(plan, record, measured, standing=STILL)


@pytest.fixture(scope="module")
def walk():
    return perfect_walk()


@pytest.fixture(scope="module")
def comparison(walk):
    return compare_walk(*walk)


def test_a_perfect_walk_passes_the_strict_profile(walk, comparison):
    verdict = judge(comparison, walk[1].outcome, STRICT)
    assert verdict.name == "pass"
    assert len(verdict.judged) == len(STRICT.tolerances)
    assert all(item.passed and (item.margin or 0.0) > 0.99 for item in verdict.judged)
    assert not verdict.failed
    assert f"All {len(STRICT.tolerances)} tolerances met" in verdict.reason


def test_an_error_between_the_profiles_passes_one_and_fails_the_other(walk):
    plan, record, measured = walk
    off = compare_walk(plan, record, with_state(plan, measured, com_shift=(0.0022, 0.0, 0.0)))
    assert judge(off, record.outcome, DEFAULT).name is VerdictName.PASS
    verdict = judge(off, record.outcome, STRICT)
    assert verdict.name is VerdictName.FAIL
    assert [item.name for item in verdict.failed] == ["zmp_x_rmse"]
    assert verdict.failed[0].margin == pytest.approx(-0.1)
    assert verdict.reason == (
        f"1 of {len(STRICT.tolerances)} tolerances not met; the furthest is zmp_x_rmse: 2.2 mm, limit 2."
    )
    assert verdict.tightest is verdict.failed[0]


def test_the_limit_itself_still_passes(walk, comparison):
    metric = replace(comparison.metrics["zmp_x_rmse"], value=2.0e-3)
    at_limit = replace(comparison, metrics={**comparison.metrics, "zmp_x_rmse": metric})
    assert judge(at_limit, walk[1].outcome, STRICT).name is VerdictName.PASS


def test_forces_are_judged_in_newton_as_share_of_the_weight(walk, comparison):
    verdict = judge(comparison, walk[1].outcome, DEFAULT)
    force = next(item for item in verdict.metrics if item.name == "force_z_rmse")
    assert force.unit == "N"
    assert force.tolerance == pytest.approx(0.01 * 60.0 * 9.81)
    assert (force.display_unit, force.display_tolerance) == ("% of body weight", pytest.approx(1.0))


def test_one_unsolved_qp_fails_the_run(walk):
    plan, record, measured = walk
    status = record.qp_status.copy()
    status[7] = 2
    record = replace(record, qp_status=status)
    verdict = judge(compare_walk(plan, record, measured), record.outcome, DEFAULT)
    assert [item.name for item in verdict.failed] == ["failed_qp"]
    assert verdict.failed[0].margin == -np.inf
    status[7] = 1  # solved, only in its second form
    record = replace(record, qp_status=status)
    assert judge(compare_walk(plan, record, measured), record.outcome, DEFAULT).name is VerdictName.PASS


def test_two_disagreeing_instruments_fail_the_run(walk):
    plan, record, measured = walk
    off = with_state(plan, measured, instrument=(0.0004, 0.0004))
    verdict = judge(compare_walk(plan, record, off), record.outcome, DEFAULT)
    assert [item.name for item in verdict.failed] == ["zmp_agreement_rmse"]


@pytest.mark.parametrize("name", [name for name in OutcomeName if name != "completed"])
def test_what_did_not_complete_has_no_verdict(walk, comparison, name):
    outcome = Outcome(name, 1.234, "The left knee went straight.", 2)
    verdict = judge(comparison, outcome, DEFAULT)
    assert verdict.name is VerdictName.NOT_MEASURED
    assert all(item.passed is None and item.margin is None for item in verdict.metrics)
    assert verdict.reason.endswith("at 1.234 s: The left knee went straight.")


def test_a_walk_of_one_step_has_nothing_to_judge():
    plan, record, measured = perfect_walk(steps=1)
    verdict = judge(compare_walk(plan, record, measured), record.outcome, DEFAULT)
    assert verdict.name is VerdictName.NOT_MEASURED
    assert "a run must last longer than its first step" in verdict.reason


def test_summary_is_plain_json_with_the_entries_of_the_contract(walk):
    plan, record, measured = walk
    off = with_state(plan, measured, com_shift=(0.003, 0.0, 0.0))
    comparison = compare_walk(plan, record, off)
    verdict = judge(comparison, record.outcome, DEFAULT)
    summary = build_summary(record, off, comparison, verdict, timing={"simulation": 1.5}, extra={"gait": "x"})
    again = json.loads(json.dumps(summary, allow_nan=False))
    assert again == summary
    assert (summary["outcome"], summary["verdict"], summary["steps_completed"]) == ("completed", "fail", 4)
    metric = summary["metrics"]["zmp_x_rmse"]
    assert metric["value"] == pytest.approx(0.003)
    assert (metric["unit"], metric["tolerance"], metric["pass"]) == ("m", 0.0025, False)
    assert metric["first_step"] == pytest.approx(0.003)
    assert metric["normalised"]["foot_length"] == pytest.approx(0.003 / 0.258)
    assert metric["display"] == {"value": pytest.approx(3.0), "unit": "mm", "tolerance": 2.5}
    assert summary["metrics"]["com_x_rmse"]["tolerance"] is None
    assert summary["statistics"]["force_z"]["run"]["r2"] is None
    assert "does not vary" in summary["statistics"]["force_z"]["run"]["r2_reason"]
    assert summary["margins"]["knee"]["value"] is None  # no body was described
    assert summary["zmp_error_split"]["share"]["com_position"][0] == pytest.approx(1.0)
    assert summary["timing"] == {"simulation": 1.5}
    assert summary["gait"] == "x"


def test_the_profiles_hold_the_agreed_limits():
    """Agreed on before the first run; changing one here needs a reason in the changelog."""
    names = ("zmp_x_rmse", "zmp_y_rmse", "zmp_x_maximum", "zmp_y_maximum", "force_x_rmse", "force_y_rmse",
             "force_z_rmse", "angular_momentum_x_rmse", "angular_momentum_y_rmse")  # fmt: skip
    limits = {item.name: {t.metric: t.limit for t in item.tolerances} for item in PROFILES.values()}
    assert [limits["strict"][name] for name in names] == [
        2.0e-3, 1.0e-3, 15e-3, 8e-3, 0.006, 0.004, 0.007, 0.1, 0.1
    ]  # fmt: skip
    assert [limits["default"][name] for name in names] == [
        2.5e-3, 1.5e-3, 40e-3, 20e-3, 0.008, 0.006, 0.010, 0.15, 0.15
    ]  # fmt: skip
    for name in names:
        assert limits["wide"][name] == 2 * limits["default"][name]
        assert limits["strict"][name] < limits["default"][name]
    for item in PROFILES.values():
        assert limits[item.name]["zmp_agreement_rmse"] == (1e-3 if item is WIDE else 0.5e-3)
        assert limits[item.name]["force_agreement_rmse"] == 0.002
        assert limits[item.name]["failed_qp"] == 0.0


def test_every_tolerance_has_a_metric_a_unit_and_a_reason(comparison):
    for item in PROFILES.values():
        for tolerance in item.tolerances:
            assert tolerance.reason.endswith(".")
            unit = comparison.metrics[tolerance.metric].unit
            assert unit == ("N" if tolerance.unit == BODY_WEIGHT else tolerance.unit)


def test_the_docs_state_the_limits_that_hold():
    text = DOCS.read_text(encoding="utf-8")
    for tolerance in (*DEFAULT.tolerances, *STRICT.tolerances):
        rows = [line for line in text.splitlines() if line.startswith(f"| `{tolerance.metric}` |")]
        assert len(rows) == 1, tolerance.metric
    for one, two in zip(STRICT.tolerances, DEFAULT.tolerances, strict=True):
        row = next(line for line in text.splitlines() if line.startswith(f"| `{one.metric}` |"))
        cells = [cell.strip() for cell in row.split("|")]
        factor = {"m": 1e3, BODY_WEIGHT: 100.0}.get(one.unit, 1.0)
        assert float(cells[2]) == pytest.approx(one.limit * factor)
        assert float(cells[3]) == pytest.approx(two.limit * factor)


def test_an_unknown_profile_names_those_that_exist():
    assert profile("wide") is WIDE
    with pytest.raises(InputError, match="use one of default, strict, wide"):
        profile("lenient")

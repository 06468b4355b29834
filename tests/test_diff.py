"""Two sweeps compared: what changed is found, what is noise is not, and runs find their partners."""

from __future__ import annotations

import json
import re

import numpy as np
import pyarrow as pa
import pytest

from ampm.exceptions import InputError
from tests.browser import assert_in_cards
from tests.saved_run import make_study
from tests.sweep_table import make_table, replaced, sweep_of, write_sweep
from tests.test_report import Page
from validation.cli.app import call
from validation.judge.uncertainty import Uncertainty
from validation.study.sweep.diff import ABSOLUTE_FLOOR, compare_sweeps, join
from validation.study.sweep.diff_text import describe_diff
from validation.study.sweep.table import METRIC, State

EASY = {"gait.c_s": (0.8, 1.2), "gait.c_y": (0.5, 1.1), "body.height": (1.6, 1.8)}


def metric(table, name):
    return np.array(table.column(METRIC + name).to_pylist(), dtype=float)


def with_metric(table, name, values):
    return replaced(table, METRIC + name, values)


def judged(table):
    """The same table of completed runs with the verdicts that its metrics give."""
    sweep = sweep_of(table)
    over = [sweep.numbers(METRIC + name) > sweep.limit_values(name) for name in sweep.limits]
    return replaced(table, "verdict", np.where(np.any(over, axis=0), "fail", "pass").tolist())


def changed(table, name, factor=1.0, plus=0.0):
    return judged(with_metric(table, name, metric(table, name) * factor + plus))


def ended(table, outcome, verdict):
    """The first run ended otherwise."""
    for column, first in (("outcome", outcome), ("verdict", verdict)):
        table = replaced(table, column, [first, *table.column(column).to_pylist()[1:]])
    return table


def compared(a, b, **options):
    return compare_sweeps(sweep_of(a, "A"), sweep_of(b, "B"), **options)


@pytest.fixture(scope="module")
def base():
    return judged(make_table(60, vary=EASY, failures=False))


def by_name(diff):
    return describe_diff(diff)["metrics"]


# ----------------------------------------------------------------------------------------- matching


def test_runs_are_joined_by_key_in_any_order(base):
    other = base.take(np.random.default_rng(1).permutation(60))
    other = replaced(other, "run", list(range(60)))
    other = replaced(other, "environment_revision", ["f" * 40] * 60)  # plays no part
    rows_a, rows_b, notes = join(sweep_of(base), sweep_of(other))
    keys = base.column("key").to_pylist(), other.column("key").to_pylist()
    assert len(rows_a) == 60
    assert [keys[0][i] for i in rows_a] == [keys[1][i] for i in rows_b]
    assert notes == []
    four = base.slice(0, 4)  # repeated runs are paired in order
    double = replaced(pa.concat_tables([four, four]), "run", list(range(8)))
    rows_a, rows_b, _ = join(sweep_of(double), sweep_of(double))
    assert rows_a.tolist() == rows_b.tolist() == list(range(8))


@pytest.mark.parametrize(
    ("a", "b", "said"),
    [
        (60, 25, ["35", "60", "A", "B"]),
        (25, 60, ["35", "60", "B", "A"]),
        (25, 25, ["A", "B"]),
        (60, 60, []),
    ],
)
def test_the_answer_says_what_is_missing(base, a, b, said):
    diff = compared(base.slice(0, a), base.slice(0, b))
    assert re.findall(r"\d+|\b[AB]\b", " ".join(diff.lacking)) == said
    fell = compared(base.slice(0, a), ended(base, "fell", "not_measured").slice(0, b))
    assert (diff.regressions, fell.regressions) == ([], ["1 newly failing"])
    for found in (diff, fell):
        assert f"{min(a, b)} matched" in found.sentence
        assert all(part in found.sentence for part in (*found.regressions, *found.lacking))


def test_missing_and_new(base, tmp_path):
    one, two = base.slice(0, 50), base.slice(5, 55)
    diff = compared(one, two)
    assert len(diff.rows_a) == 45
    assert diff.missing == [f"{i:04d}" for i in range(5)]
    assert diff.new == [f"{i:04d}" for i in range(50, 60)]
    assert not diff.regressions
    assert compared(one, two, require_all=True).regressions == ["5 missing"]
    folders = (str(write_sweep(tmp_path / name, table)) for name, table in (("a", one), ("b", two)))
    assert call(["diff", *folders, "--out", str(tmp_path / "diff.html")]) == 0
    assert 'class="card verdict open"' in (tmp_path / "diff.html").read_text(encoding="utf-8")  # not green


@pytest.mark.parametrize("masses", [(60.0, 61.0), (70.0, 80.0)])
def test_a_parameter_that_was_changed_for_all_runs(base, masses):
    a, b = (
        replaced(replaced(base, "key", [f"{mass}-{i}" for i in range(60)]), "body.mass", [mass] * 60)
        for mass in masses
    )
    diff = compared(a, b)
    assert diff.rows_a.tolist() == diff.rows_b.tolist() == list(range(60))
    assert any(f"body.mass is {masses[0]} in" in n and f"{masses[1]} in" in n for n in diff.notes)


def test_a_parameter_that_only_one_sweep_varies_or_nothing_in_common(base):
    grid = {"gait.c_s": [0.9, 1.0, 1.1]}
    wide = {**grid, "gait.c_y": [0.5, 1.0]}
    a, b = make_table(grid=grid, failures=False), make_table(grid=wide, failures=False)
    diff = compared(a, b)  # c_y = 1 is the default, so half of the runs are in both
    assert len(diff.rows_a) == len(diff.new) == 3
    lacking = replaced(a, "key", ["x", "y", "z"]).drop_columns(["gait.c_y"])
    elsewhere = make_table(60, vary={"gait.step_length": (0.5, 0.6)}, failures=False)
    seed = make_table(60, vary=EASY, failures=False, seed=5)
    for one, other in ((lacking, b), (base, elsewhere), (base, seed), (base, base.slice(0, 0))):
        with pytest.raises(InputError, match="no run"):
            compared(one, other)


# -------------------------------------------------------------------------------------------- noise


@pytest.mark.parametrize("size", [1e-10, -5e-7])
def test_rounding_is_no_difference(base, size):
    other, near_zero = base, "com_agreement_maximum"
    for name in sweep_of(base).metrics:
        other = with_metric(other, name, metric(base, name) * (1.0 + size))
    quiet, loud = (with_metric(table, near_zero, [v] * 60) for table, v in ((base, 1e-15), (other, 5e-15)))
    diff = compared(quiet, loud)
    assert not diff.changes
    for item in by_name(diff).values():
        assert (item["better"], item["worse"], item["verdict"]) == (0, 0, "same")
    assert by_name(diff)[near_zero]["noise"]["value"] == ABSOLUTE_FLOOR["m"]


def test_a_small_but_real_growth_is_worse_and_no_regression(base):
    diff = compared(base, changed(base, "zmp_x_rmse", 1.01))
    found = by_name(diff)["zmp_x_rmse"]
    assert (found["worse"], found["better"], found["regressed"]) == (60, 0, 0)
    assert found["verdict"] == "worse"
    assert found["p"] < 1e-6
    assert found["median"]["shift"] == pytest.approx(np.median(metric(base, "zmp_x_rmse") * 0.01))
    assert not diff.regressions
    assert by_name(diff)["zmp_y_rmse"]["verdict"] == "same"


def test_no_difference_below_the_uncertainty_is_a_result(base):
    study = Uncertainty("normal", 6, "", {"zmp_x_rmse": 0.3e-3, "zmp_y_rmse": float("inf")}, {})
    for growth, worse in ((0.29e-3, 0), (0.31e-3, 60)):
        other = changed(changed(base, "zmp_x_rmse", plus=growth), "zmp_y_rmse", 3)
        diff = compared(base, other, uncertainty=study)
        found = by_name(diff)
        assert found["zmp_x_rmse"]["worse"] == worse
        assert found["zmp_x_rmse"]["noise"]["from"] == "convergence study"
        assert found["zmp_x_rmse"]["verdict"] == ("worse" if worse else "same")
        assert found["zmp_y_rmse"]["worse"] == 0  # no bound: nothing can be said
        assert found["force_x_rmse"]["noise"]["from"] == "floating point"
        assert bool(diff.of_kind("worse_metrics")) == bool(worse)
        assert not diff.of_kind("newly_failing")


@pytest.mark.parametrize(("lacking", "worse"), [((), 60), (("time_step",), 0)])
def test_what_lacks_a_study_is_no_difference(base, lacking, worse):
    incomplete = {"zmp_x_rmse": lacking} if lacking else {}
    known = Uncertainty("normal", 6, "", {"zmp_x_rmse": 1e-9}, {}, ("ik_grid",), lacking, incomplete)
    diff = compared(base, changed(base, "zmp_x_rmse", plus=1e-3), uncertainty=known)
    assert any("(ik_grid) of normal" in note for note in diff.notes)
    assert any(note.startswith("not studied: time_step;") for note in diff.notes) == bool(lacking)
    assert by_name(diff)["zmp_x_rmse"]["worse"] == worse


def test_a_step_across_the_limit_below_the_noise_is_no_failure(base):
    limit = sweep_of(base).limit_values("zmp_x_rmse")
    close, over = (changed(base, "zmp_x_rmse", 0.0, limit * (1 + sign * 1e-8)) for sign in (-1, 1))
    diff = compared(close, over)
    assert not diff.regressions
    assert len(diff.of_kind("verdict_only")) == sum(v == "pass" for v in close.column("verdict").to_pylist())
    assert not compared(over, close).of_kind("newly_passing")


# ------------------------------------------------------------------------------------------ changes


def test_newly_failing_and_newly_passing(base):
    verdicts = base.column("verdict").to_pylist()
    rows = [row for row, verdict in enumerate(verdicts) if verdict == "pass"][:3]
    values = metric(base, "zmp_y_rmse")
    values[rows] = 2e-3
    other = judged(with_metric(base, "zmp_y_rmse", values))
    diff, back = compared(base, other), compared(other, base)
    failing = diff.of_kind("newly_failing")
    assert [change.a for change in failing] == [f"{row:04d}" for row in rows]
    assert all(change.metrics == ("zmp_y_rmse",) for change in failing)
    assert all(set(change.parameters) == set(EASY) for change in failing)
    assert diff.regressions == ["3 newly failing"]
    assert len(back.of_kind("newly_passing")) == 3
    assert not back.regressions
    verdicts[rows[0]] = "fail"  # a verdict without metrics is believed
    other = replaced(base, "verdict", verdicts)
    assert [change.kind for change in compared(base, other).changes] == ["newly_failing"]
    assert [change.kind for change in compared(other, base).changes] == ["newly_passing"]


@pytest.mark.parametrize(
    ("before", "after", "kind"),
    [
        (("completed", "pass"), ("fell", "not_measured"), "newly_failing"),
        (("completed", "pass"), ("refused", None), "newly_failing"),
        (("completed", "pass"), ("timed_out", None), "newly_failing"),
        (("refused", None), ("fell", "not_measured"), "worse_outcome"),
        (("fell", "not_measured"), ("refused", None), "better_outcome"),
        (("fell", "not_measured"), ("crashed", None), "worse_outcome"),
        (("fell", "not_measured"), ("diverged", "not_measured"), "other_outcome"),
        (("fell", "not_measured"), ("completed", "pass"), "newly_passing"),
        (("crashed", None), ("completed", "fail"), "better_outcome"),
    ],
)
def test_outcomes(base, before, after, kind):
    diff = compared(ended(base, *before), ended(base, *after))
    assert [change.kind for change in diff.changes] == [kind]
    assert bool(diff.regressions) == (kind in ("newly_failing", "worse_outcome"))
    assert not compared(ended(base, *before), ended(base, *before)).changes


def test_worse_metrics_are_measured_by_the_limit(base):
    grown = metric(base, "zmp_x_rmse")
    grown[7] += 0.15 * 2.5e-3
    other = judged(with_metric(base, "zmp_x_rmse", grown))
    for tolerances, worse in (
        ((), 1), (("0.2",), 0), (("0.1", "zmp_x_rmse=0.2"), 0), (("0.2", "zmp_x_rmse=0"), 1),
    ):  # fmt: skip
        assert len(compared(base, other, tolerances=tolerances).of_kind("worse_metrics")) == worse
    worst = by_name(compared(base, other))["zmp_x_rmse"]["worst"]
    assert worst["run"] == "0007"
    assert worst["b"] - worst["a"] == pytest.approx(0.15 * 2.5e-3)
    diff = compared(base, judged(with_metric(base, "failed_qp", [1.0, *[0.0] * 59])), tolerances=["1e9"])
    assert by_name(diff)["failed_qp"]["regressed"] == 1  # whatever the tolerance: its limit is 0
    assert diff.regressions


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_metric_that_was_lost_is_a_regression(base, value):
    values = metric(base, "com_agreement_maximum")
    values[[3, 5]] = value
    diff = compared(base, with_metric(base, "com_agreement_maximum", values))
    assert [(change.kind, change.a, change.metrics) for change in diff.changes] == [
        ("worse_metrics", name, ("com_agreement_maximum",)) for name in ("0003", "0005")
    ]
    found = by_name(diff)["com_agreement_maximum"]
    assert (found["lost"], found["worse"], found["regressed"], found["pairs"]) == (2, 2, 2, 58)
    assert diff.regressions
    everywhere = compared(base, with_metric(base, "com_agreement_maximum", [value] * 60))
    assert len(everywhere.of_kind("worse_metrics")) == 60
    assert not compared(with_metric(base, "com_agreement_maximum", values), base).regressions
    passed = replaced(with_metric(base, "zmp_x_rmse", [value] * 60), "verdict", ["pass"] * 60)
    filled = compared(passed, changed(base, "zmp_x_rmse", 0.0, 1.0))
    assert len(filled.of_kind("newly_failing")) == 60  # from no value to one over the limit
    gone = compared(base, base.drop_columns([METRIC + "com_agreement_maximum"]))
    assert any("com_agreement_maximum" in note for note in gone.notes)


def test_no_shift_is_claimed_of_few_or_of_scatter(base):
    few = base.slice(0, 6)
    diff = compared(few, changed(few, "zmp_x_rmse", 1.01))
    assert by_name(diff)["zmp_x_rmse"]["worse"] == 6
    assert by_name(diff)["zmp_x_rmse"]["verdict"] == "too few"
    assert np.isnan(by_name(diff)["zmp_x_rmse"]["p"])
    eight = base.slice(0, 8)
    diff = compared(eight, changed(eight, "zmp_x_rmse", 1.01))
    assert by_name(diff)["zmp_x_rmse"]["p"] == pytest.approx(len(by_name(diff)) * 2 / 2**8)  # all one way
    noise = np.random.default_rng(1).normal(1.0, 0.01, 60)
    diff = compared(base, changed(base, "zmp_x_rmse", noise))
    assert by_name(diff)["zmp_x_rmse"]["verdict"] == "same"


def test_another_profile_is_said(base):
    other = make_table(60, vary=EASY, failures=False, profile_name="wide")
    other = replaced(other, "key", [f"w{i}" for i in range(60)])
    diff = compared(base, other)
    assert any("default and wide" in note for note in diff.notes)


# ------------------------------------------------------------------------------------- command line


@pytest.fixture
def folders(tmp_path, base):
    values = metric(base, "zmp_y_rmse")
    values[:3] = 2e-3
    one = write_sweep(tmp_path / "a", base)
    two = write_sweep(tmp_path / "b", judged(with_metric(base, "zmp_y_rmse", values)))
    return str(one), str(two)


def test_command_line(folders, tmp_path, capsys):
    a, b = folders
    page = tmp_path / "diff.html"
    assert call(["diff", a, b, "--out", str(page)]) == 1
    html = Page(page.read_text(encoding="utf-8"))
    assert html.open == []
    assert all(link.startswith("data:,") for link in html.links)
    for arguments, status in (
        ([b, a], 0),
        ([a, a], 0),
        ([f"{a}/results.parquet", f"{b}/results.parquet"], 1),
        ([a, b, "--out", str(page)], 2),  # it exists
        ([a, b, "--out", str(page), "--force"], 1),
        ([a, "absent"], 2),
        ([a, str(tmp_path)], 2),  # no sweep
    ):
        assert call(["diff", *arguments]) == status
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.parametrize("size", [(390, 844), (768, 1024), (1366, 768)])
def test_better_and_worse_are_in_the_window(folders, tmp_path, size):
    page = tmp_path / "diff.html"
    assert call(["diff", *folders, "--out", str(page)]) == 1
    names = ("all runs", "better", "worse", "beyond")
    selector = ", ".join(f'td[data-name="{name}"]' for name in names)
    assert_in_cards(page, tmp_path, selector, 4 * 17, size)


def test_json(folders, tmp_path, capsys):
    assert call(["diff", *folders, "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert found["regression"] is True
    assert (found["matched"], found["missing"]) == (60, [])
    assert found["counts"]["newly_failing"] == len(found["newly_failing"]) >= 1
    assert found["newly_failing"][0]["after"] == State.OUT_OF_TOLERANCE.value
    assert set(found["newly_failing"][0]["parameters"]) == set(EASY)
    assert (found["metrics"]["zmp_y_rmse"]["worse"], found["metrics"]["zmp_y_rmse"]["unit"]) == (3, "m")
    file = make_study(tmp_path, {"zmp_y_rmse": 1.0})
    assert call(["diff", *folders, "--uncertainty", str(file), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["metrics"]["zmp_y_rmse"]["worse"] == 0


@pytest.mark.parametrize(
    "extra",
    [
        ["--tolerance", "much"],
        ["--tolerance", "-0.1"],
        ["--tolerance", "nan"],
        ["--tolerance", "zmp=0.1"],
        ["--uncertainty", "absent.json"],
    ],
)
def test_bad_input(folders, extra, capsys):
    assert call(["diff", *folders, *extra]) == 2
    told = capsys.readouterr()
    assert " ".join(extra) in told.err
    assert told.err.count("\n") == 1
    assert told.out == ""

"""Convergence: what is studied, studies of canned walks, their files, and a real one."""

import json
import math
from importlib.util import find_spec

import numpy as np
import pytest

from ampm.exceptions import InputError
from ampm.run_file import load_run
from tests.saved_run import make_study
from tests.walk import APART, STILL, perfect_walk, with_state
from validation.cli.app import Status, call
from validation.judge.compare import compare
from validation.judge.metrics import METRICS, evaluate
from validation.judge.plan_moved import PLAN_MOVED
from validation.judge.profiles import DEFAULT, STRICT
from validation.judge.sizes import DEFAULT_BODY
from validation.judge.uncertainty import FILE, Uncertainty, load_uncertainty, matching
from validation.judge.verdict import VerdictName, build_summary, judge
from validation.store.identity import parameter_values
from validation.store.json import json_ready
from validation.study.convergence import study as convergence
from validation.study.convergence.levels import OWN, runs_of, studies
from validation.study.convergence.order import NO_RANGE
from validation.study.row_file import ROWS
from validation.trial.plan import load_request

DRAKE = find_spec("pydrake") is not None
COARSE = ["simulation.time_step=0.002"]
"""The finest of four levels is then not too slow."""

# --------------------------------------------------------------------------------- studies


def test_what_is_studied():
    run = load_run("normal", COARSE)
    found = {study.name: study for study in studies(run)}
    assert found["time_step"].values == (0.002, 0.001, 0.0005, 0.00025)
    assert found["qp_tolerance"].values == (5e-5, 5e-6, 5e-7, 5e-8)
    stiffness = found["contact_stiffness"]
    assert stiffness.values[stiffness.own] == 0.015
    assert (0.015 / np.array(stiffness.values)) ** 2 == pytest.approx([0.5, 1.0, 2.0])
    assert [study.numerical for study in found.values()] == [True] * 3 + [False] * (4 + DRAKE)
    fine = studies(load_run("normal", ["simulation.time_step=0.001"]), ["time_step"], levels=5)
    assert fine[0].values == (0.001, 0.0005, 0.00025, 0.000125, 0.0000625)
    exact = studies(load_run("normal", [*COARSE, "solver.qp=daqp"]))  # has no tolerance
    assert [study.name for study in exact] == [name for name in found if name != "qp_tolerance"]
    short = studies(load_run("normal", [*COARSE, "contact.time_constant=0.005"]), ["contact_stiffness"])
    assert min(short[0].values) == 0.005  # MuJoCo would not walk 3.5 ms, below twice the step, as requested


@pytest.mark.skipif(not DRAKE, reason="needs the extra drake")
def test_a_walk_in_drake_varies_its_contact():
    """What only MuJoCo's contact has is left out, and the other way round."""
    run = load_run("normal", [*COARSE, "simulation.engine=drake"])
    laws = {study.name: study for study in studies(run) if not study.numerical}
    assert list(laws) == ["drake_stiffness", "drake_dissipation", "engine"]
    assert laws["drake_stiffness"].values == (7.5e4, 1.5e5, 3e5)
    assert laws["drake_dissipation"].values == (10.0, 20.0, 40.0)


def test_one_thing_changes_at_a_time_and_all_share_the_own_walk():
    run = load_run("normal")
    found = studies(run)
    runs = runs_of(run, found)
    assert len(runs) == 1 + 3 * 3 + 4 * 2 + DRAKE
    for study in found:
        assert study.tasks[study.own] == OWN
        for value, task in zip(study.values, study.tasks, strict=True):
            assert parameter_values(runs[task]) == parameter_values(run) | {study.key: value}


# ------------------------------------------------------------------- canned walks


def row(run, *, offset=0.0):
    """A walk whose metrics are formulas: known order in the time step, known dependence on the rest."""
    h, tolerance = run.simulation.time_step, run.solver.tolerance
    values = dict.fromkeys((item.metric for item in DEFAULT.tolerances), 0.0) | {
        "zmp_x_rmse": 1e-3 + offset + 0.2 * h + 10.0 * tolerance * 1e-3,
        "zmp_x_maximum": 5e-3 + h * (1.0 if h > 4e-4 else 3.0),
        "force_x_rmse": 2.0 + 0.1 * math.cos(math.pi * math.log2(h / 2e-3)),
        "zmp_agreement_rmse": 0.16 * h,
        "force_agreement_rmse": 50.0 * h,
        "failed_qp": float(tolerance < 1e-7),
        "energy_positive_work": 450.0 + 1e3 * run.contact.time_constant,
    }
    return {"outcome": "completed", "cause": "", "values": values, "scales": DEFAULT_BODY}


def study(settings=(), *, falls=lambda run: False, offset=0.0, only=()):
    request = load_request("normal", [*COARSE, *settings, "gait.steps=6"])
    found = studies(request.run, only)
    fell = {"outcome": "fell", "cause": "It stumbled.", "values": {}, "scales": DEFAULT_BODY}
    runs = runs_of(request.run, found)
    walks = {task: fell if falls(run) else row(run, offset=offset) for task, run in runs.items()}
    return convergence.combine(request, DEFAULT, found, walks)


@pytest.fixture(scope="module")
def result():
    return study()


def test_every_metric_has_order_limit_and_uncertainty_or_a_reason(result):
    zmp, force = result.metrics["zmp_x_rmse"], result.metrics["force_x_rmse"]
    estimates = result.studied["zmp_x_rmse"].estimates
    step, tolerance = estimates["time_step"], estimates["qp_tolerance"]
    assert step.order == pytest.approx(1.0)
    assert step.extrapolated == pytest.approx(1e-3 + 10.0 * 5e-8)
    levels = result.studied["zmp_x_rmse"].levels["time_step"]
    assert levels == pytest.approx((1.4005e-3, 1.2005e-3, 1.1005e-3, 1.0505e-3))
    assert step.uncertainty == pytest.approx(1.25 * 0.4e-3)
    assert estimates["ik_grid"].kind == "constant"
    assert zmp.uncertainty == pytest.approx(step.uncertainty + tolerance.uncertainty)
    assert (zmp.tolerance, force.tolerance) == (2.5e-3, pytest.approx(0.008 * 588.6))
    for name in ("zmp_x_maximum", "force_x_rmse"):
        estimate = result.studied[name].estimates["time_step"]
        assert estimate.order is None
        assert estimate.reason.startswith(NO_RANGE)
    table = result.table(["zmp_x_rmse"])
    cells = dict(zip(table.headers, table.rows[0], strict=True))
    assert cells["metric"] == "ZMP, RMS error along x"
    assert "<h3>Convergence of normal: value" in result._repr_html_()
    assert cells["value ± u_num"] == "1.4 ± 0.5"
    assert (cells["observed order"], cells["at 0.25 ms"], cells["verdict"]) == ("1.00", "1.05", "pass")


def test_self_checks_counts_and_sensitivities_have_no_numerical_uncertainty(result):
    names = ("zmp_agreement_rmse", "force_agreement_rmse", "failed_qp", "energy_positive_work")
    assert [result.metrics[name].uncertainty for name in names] == [0.0] * 4
    assert result.metrics["force_agreement_rmse"].passed  # judged at the step that it checks
    assert result.metrics["zmp_agreement_rmse"].passed is None  # reported only
    gap, _, count, work = (result.studied[name] for name in names)
    assert gap.estimates["time_step"].extrapolated == pytest.approx(0.0, abs=1e-12)
    assert gap.estimates["time_step"].uncertainty == pytest.approx(1.25 * 0.32e-3)
    assert count.levels["qp_tolerance"] == (0.0, 0.0, 0.0, 1.0)
    assert result.table(["failed_qp"]).rows[0][6] == "exact"
    assert work.spreads["contact_stiffness"] == pytest.approx(15.0 * (math.sqrt(2) - 1))
    assert work.spread == pytest.approx(work.spreads["contact_stiffness"])


@pytest.mark.parametrize(("share", "passed"), [(1.01, True), (0.99, None), (-0.99, None), (-1.01, False)])
def test_the_verdict_is_spoken_beyond_the_uncertainty(result, share, passed):
    """The value is this share of its uncertainty below the limit."""
    zmp = result.metrics["zmp_x_rmse"]
    offset = zmp.tolerance - zmp.value - share * zmp.uncertainty
    found = study(offset=offset).metrics["zmp_x_rmse"]
    assert (found.passed, found.undecided) == (passed, passed is None)


@pytest.mark.parametrize(
    ("falls", "completed", "verdict", "unbounded"),
    [
        (lambda run: run.simulation.time_step == 0.0005, False, VerdictName.UNDECIDED, "uncertainty"),
        (lambda run: run.contact.time_constant > 0.02, True, VerdictName.UNDECIDED, "spread"),
        (lambda run: True, False, VerdictName.NOT_MEASURED, None),
    ],
)
def test_a_level_that_falls_bounds_nothing(falls, completed, verdict, unbounded):
    """A contact law on which it falls leaves the verdict undecided, as it is another floor."""
    found = study(falls=falls)
    assert (found.completed, found.verdict.name) == (completed, verdict)
    assert any("It stumbled." in note for note in found.notes)
    assert bool(found.metrics) == (unbounded is not None)
    if unbounded:
        assert json_ready(found.as_dict())["metrics"]["zmp_x_rmse"][unbounded] == "inf"


@pytest.mark.parametrize(
    ("only", "lacking", "shown"),
    [
        (("contact_stiffness",), ("time_step", "ik_grid", "qp_tolerance"), "not studied"),
        (("time_step",), ("ik_grid", "qp_tolerance"), "≥ "),
        (("ik_grid", "qp_tolerance"), ("time_step",), "≥ "),
    ],
)
def test_what_was_not_studied_is_never_a_zero_nor_a_pass(only, lacking, shown, tmp_path, monkeypatch):
    monkeypatch.setattr("validation.study.convergence.picture.draw", lambda *_: None)
    found = study(only=only)
    assert found.verdict.name is VerdictName.UNDECIDED
    assert f"not studied: {', '.join(lacking)}" in found.verdict.reason
    zmp = found.metrics["zmp_x_rmse"]
    assert (zmp.undecided, zmp.passed, zmp.not_studied) == (True, None, lacking)
    assert (found.metrics["failed_qp"].uncertainty, found.metrics["failed_qp"].passed) == (0.0, True)  # exact
    assert f"± {shown}" in found.table(["zmp_x_rmse"]).markdown()
    convergence.write(found, tmp_path)
    summary = summary_with(load_uncertainty(tmp_path))  # a run decides nothing by it either
    entry = summary["metrics"]["zmp_x_rmse"]
    assert (entry["uncertainty"], entry["pass"], entry["undecided"]) == (None, None, True)
    assert entry["not_studied"] == list(lacking)
    assert summary["uncertainty"]["studies"] == [name for name in only if name != "contact_stiffness"]


@pytest.mark.parametrize(("margin", "undecided"), [(1.01, False), (0.99, True)])
def test_a_margin_below_the_spread_over_contact_laws_is_undecided(tmp_path, monkeypatch, margin, undecided):
    monkeypatch.setattr("validation.study.convergence.picture.draw", lambda *_: None)
    monkeypatch.setitem(globals(), "row", lambda run, **_: impeded(run, margin))
    found = study()
    zmp = found.metrics["zmp_x_rmse"]
    assert zmp.spread == pytest.approx(1e-3)
    assert (zmp.undecided, zmp.uncertainty) == (undecided, 0.0)
    assert (found.verdict.name is VerdictName.UNDECIDED) == undecided
    convergence.write(found, tmp_path)
    entry = summary_with(load_uncertainty(tmp_path))["metrics"]["zmp_x_rmse"]
    assert entry["spread"] == pytest.approx(1e-3)
    if undecided:
        assert "ZMP, RMS error along x: 1.51 ± 0 mm, limit 2.5, which changes by up to 1 mm" in (
            found.verdict.reason
        )
        assert dict(zip(found.table().headers, found.table().rows[0], strict=True))["spread"] == "1"


def impeded(run, margin):
    """A walk whose ZMP is 1 mm worse on a floor that is hard at first touch."""
    canned = study_row(run)
    worse = 1e-3 * (run.contact.impedance_min > 0.8)
    values = dict.fromkeys(canned["values"], 0.0) | {"zmp_x_rmse": 2.5e-3 - margin * 1e-3 + worse}
    return canned | {"values": values}


study_row = row


def test_a_self_check_needs_no_time_step_and_an_exact_solver_no_tolerance():
    gap = study(only=("ik_grid", "qp_tolerance")).metrics["force_agreement_rmse"]
    assert (gap.not_studied, gap.passed) == ((), True)
    exact = study(["solver.qp=daqp"], only=("time_step", "ik_grid"))
    assert (exact.uncertainty.not_studied, exact.verdict.name) == ((), VerdictName.PASS)


# --------------------------------------------------------------------------- files and reading them back


@pytest.fixture(scope="module")
def folder(tmp_path_factory, result):
    out = tmp_path_factory.mktemp("study")
    convergence.write(result, out)
    return out


def test_the_files_are_whole_and_read_back(folder, result):
    files = {FILE, convergence.MARKDOWN, convergence.PICTURE}
    assert {path.name for path in folder.iterdir()} == files
    assert "<svg" in (folder / convergence.PICTURE).read_text()
    assert "| unsolved QPs |" in (folder / convergence.MARKDOWN).read_text()
    known = load_uncertainty(folder / FILE)
    assert load_uncertainty(folder) == known
    assert known.values == result.uncertainty.values
    assert (known.gait, known.steps) == ("normal", 6)
    assert known.studies == ("time_step", "ik_grid", "qp_tolerance")
    table = json.loads((folder / FILE).read_text())
    assert table["levels"]["time_step"]["values"] == [0.002, 0.001, 0.0005, 0.00025]


def test_a_study_serves_any_number_of_steps_of_its_gait_and_no_other_gait(folder):
    known = load_uncertainty(folder)
    assert matching([known], load_request("normal", [*COARSE, "gait.steps=30"])) is known
    with pytest.raises(InputError, match=r"momentum.*gait\.c_s.*1\.2"):
        matching([known], load_request("momentum", COARSE))
    with pytest.raises(InputError, match=r"simulation\.time_step.*0\.001"):
        matching([known], load_request("normal", ["simulation.time_step=0.001"]))


@pytest.mark.parametrize(
    ("metrics", "why"),
    [
        ({}, "holds no metrics"),
        ({"zmp_x_rmse": -1}, r"metrics.zmp_x_rmse.uncertainty_at_least"),
        ({"zmp_x_rmse": "much"}, r"metrics.zmp_x_rmse.uncertainty_at_least"),
    ],
)
def test_a_file_that_is_no_study_is_refused(tmp_path, metrics, why):
    with pytest.raises(InputError, match=why):
        load_uncertainty(make_study(tmp_path, metrics))
    for text in ("{", json.dumps(summary_with(Uncertainty("x", 6, "abc", {}, {})))):  # it has metrics, too
        (tmp_path / FILE).write_text(text)
        with pytest.raises(InputError, match=FILE):
            load_uncertainty(tmp_path)
    known = load_uncertainty(make_study(tmp_path, {"a": "inf", "b": None}))
    assert dict(known.values) == {"a": math.inf, "b": math.inf}


# --------------------------------------------------------------------------- a run that quotes a study


def summary_with(known):
    """Summary of a walk that is 1.8 mm off."""
    planned, record, measured = perfect_walk()
    off = with_state(planned, measured, com_shift=(0.0018, 0.0, 0.0))
    comparison = compare(planned, record, off, standing=STILL, shapes=APART)
    verdict = judge(evaluate(comparison), STRICT, comparison.scales, known)
    timing = {"simulated": 2.0, "real_time_factor": 5.0}
    return build_summary(comparison, verdict, timing=timing, gait="x", uncertainty=known.as_dict())


# --------------------------------------------------------------------------- command line, and a real study


def test_bad_requests_are_refused_before_anything_walks(folder, tmp_path, ampm):
    for arguments, why in (
        (["convergence", "normal", "--out", folder], "not empty"),
        (["convergence", "normal", "--out", folder, "--resume"], "holds no study"),
        (["convergence", "normal", "--study", "wind"], "use one of time_step"),
        (["convergence", "normal", "--levels", "2"], "--levels 2"),
        (["convergence", "normal", "--steps", "1"], "--steps 1"),
        (
            ["validate", "momentum", "--uncertainty", folder, "--out", tmp_path / "run"],
            "no study is of momentum",
        ),
        (["validate", "normal", "--uncertainty", tmp_path / "no.json"], "cannot be read"),
    ):
        answer = ampm(*arguments)
        assert answer.status == Status.REFUSED
        assert why in answer.err


@pytest.mark.parametrize(
    ("options", "status", "word"),
    [
        ({}, Status.PASS, "PASS"),
        ({"falls": lambda run: run.simulation.time_step < 4e-4}, Status.NOT_COMPLETED, "fell"),
        ({"offset": 1e-3}, Status.OUT_OF_TOLERANCE, "UNDECIDED"),
    ],
)
def test_the_exit_status_follows_the_verdict(options, status, word, monkeypatch, capsys):
    monkeypatch.setattr(convergence, "convergence", lambda *args, **keywords: study(**options))
    assert call(["convergence", "normal"]) == status
    assert word in capsys.readouterr().out


def test_a_real_study_and_its_resumption(tmp_path, monkeypatch):
    """Two steps of the easy gait; all levels have one motion."""
    monkeypatch.setattr("validation.study.convergence.picture.draw", lambda *_: None)
    settings = [*COARSE, "solver.ik_time_step=0.004"]
    options = {"steps": 2, "levels": 3, "only": ["qp_tolerance"], "workers": 0, "out": tmp_path}
    found = convergence.convergence("flat", settings, **options)
    assert found.completed
    assert found.verdict.name is VerdictName.UNDECIDED
    # The joints of the human have no speed limits, the plan stays, and two steps show no drift.
    absent = {"speed_excess", "drift_per_step", *(metric.name for metric in PLAN_MOVED)}
    assert METRICS.keys() - absent == found.metrics.keys()
    assert found.metrics["com_agreement_maximum"].value < 1e-12
    known = matching([load_uncertainty(tmp_path)], load_request("flat", [*settings, "gait.steps=2"]))
    assert known.values["zmp_x_rmse"] == found.metrics["zmp_x_rmse"].uncertainty
    assert known.not_studied == ("time_step", "ik_grid")
    rows = (tmp_path / ROWS).read_text()
    monkeypatch.setattr("validation.study.pool._columns", lambda work, options: pytest.fail("walked again"))
    again = convergence.convergence("flat", settings, **options, resume=True)
    assert again.as_dict()["metrics"] == found.as_dict()["metrics"]
    assert (tmp_path / ROWS).read_text() == rows

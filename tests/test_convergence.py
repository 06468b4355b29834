"""Convergence: what is studied, studies of canned walks, their files, and a real one."""

import json
import math
from importlib.util import find_spec

import pytest

from ampm.exceptions import InputError
from ampm.run_file import load_run
from tests.saved_run import make_study
from validation.cli.app import Status, call
from validation.judge.metrics import METRICS
from validation.judge.profiles import DEFAULT
from validation.judge.sizes import DEFAULT_BODY
from validation.judge.uncertainty import FILE, load_uncertainty, matching
from validation.judge.verdict import VerdictName
from validation.store.identity import parameter_values
from validation.store.json import json_ready
from validation.study.convergence import levels
from validation.study.convergence import study as convergence
from validation.study.convergence.levels import OWN, runs_of, studies
from validation.study.row_file import ROWS
from validation.trial.plan import load_request

DRAKE = find_spec("pydrake") is not None
COARSE = ["simulation.time_step=0.002"]
"""The finest of four levels is then not too slow."""


def test_one_thing_changes_at_a_time_and_all_share_the_own_walk():
    run = load_run("normal")
    found = studies(run)
    runs = runs_of(run, found)
    assert len(runs) == 1 + 3 * 3 + 4 * 2 + DRAKE
    for study in found:
        assert study.tasks[0] == OWN
        for value, task in zip(study.values, study.tasks, strict=True):
            assert parameter_values(runs[task]) == parameter_values(run) | {study.key: value}


# ------------------------------------------------------------------- canned walks


def row(run, *, offset=0.0, impeded=0.0):
    """A walk whose metrics are formulas: known order in the time step, known dependence on the rest."""
    h, tolerance = run.simulation.time_step, run.solver.tolerance
    hard = impeded if run.contact.impedance_min > 0.8 else 0.0
    values = dict.fromkeys((item.metric for item in DEFAULT.tolerances), 0.0) | {
        "zmp_x_rmse": 1e-3 + offset + 0.2 * h + 1e-2 * tolerance + hard,
        "zmp_x_maximum": 5e-3 + h * (1.0 if h > 4e-4 else 3.0),
        "force_x_rmse": 2.0 + 0.1 * math.cos(math.pi * math.log2(h / 2e-3)),
        "zmp_agreement_rmse": 0.16 * h,
        "force_agreement_rmse": 50.0 * h,
        "failed_qp": float(tolerance < 1e-7),
        "energy_positive_work": 450.0 + 1e3 * run.contact.time_constant,
    }
    return {"outcome": "completed", "cause": "", "values": values, "scales": DEFAULT_BODY}


def study(*settings, falls=lambda run: False, **change):
    request = load_request("normal", [*COARSE, *settings, "gait.steps=6"])
    found = studies(request.run)
    fell = {"outcome": "fell", "cause": "It stumbled.", "values": {}, "scales": DEFAULT_BODY}
    runs = runs_of(request.run, found)
    walks = {task: fell if falls(run) else row(run, **change) for task, run in runs.items()}
    return convergence.combine(request, DEFAULT, found, walks)


@pytest.fixture(scope="module")
def result():
    return study()


def test_every_metric_has_order_limit_and_uncertainty_or_a_reason(result):
    zmp = result.metrics["zmp_x_rmse"]
    estimates = result.studied["zmp_x_rmse"].estimates
    step, tolerance = estimates["time_step"], estimates["qp_tolerance"]
    assert step.order == pytest.approx(1.0)
    assert step.extrapolated == pytest.approx(1e-3 + 10.0 * 5e-8)
    assert step.uncertainty == pytest.approx(1.25 * 0.4e-3)
    assert estimates["ik_grid"].kind == "constant"
    assert zmp.uncertainty == pytest.approx(step.uncertainty + tolerance.uncertainty)
    for name in ("zmp_x_maximum", "force_x_rmse"):
        estimate = result.studied[name].estimates["time_step"]
        assert (estimate.kind, estimate.order) == ("no asymptotic range", None)
    (table,) = result.tables()
    rows = {row[0]: row for row in table.rows}
    unit = ("mm", "pass", "1.05", "1.00", "1", "0")
    assert rows["ZMP, RMS error along x"] == ("ZMP, RMS error along x", "1.4 ± 0.5", "2.5", *unit)
    assert rows["unsolved QPs"][6] == "exact"


def test_self_checks_and_counts_have_no_numerical_uncertainty(result):
    names = ("zmp_agreement_rmse", "force_agreement_rmse", "failed_qp", "energy_positive_work")
    assert [result.metrics[name].uncertainty for name in names] == [0.0] * 4
    assert result.metrics["force_agreement_rmse"].passed  # judged at the step that it checks
    assert result.studied["zmp_agreement_rmse"].estimates["time_step"].uncertainty == pytest.approx(0.4e-3)
    assert result.studied["energy_positive_work"].spread == pytest.approx(15.0 * (math.sqrt(2) - 1))


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


@pytest.mark.parametrize(("margin", "undecided"), [(1.01, False), (0.99, True)])
def test_a_margin_below_the_spread_over_contact_laws_is_undecided(margin, undecided):
    """The ZMP is 1 mm worse on a floor that is hard at first touch."""
    zmp = study(offset=1.1e-3 - margin * 1e-3, impeded=1e-3).metrics["zmp_x_rmse"]
    assert zmp.spread == pytest.approx(1e-3)
    assert zmp.value == pytest.approx(2.5e-3 - margin * 1e-3, abs=1e-6)
    assert (zmp.undecided, zmp.passed) == (undecided, None if undecided else True)


# ------------------------------------------------------------------- files and command line


@pytest.fixture(scope="module")
def folder(tmp_path_factory, result):
    out = tmp_path_factory.mktemp("study")
    convergence.write(result, out)
    return out


def test_the_files_are_whole_and_read_back(folder, result):
    assert {path.name for path in folder.iterdir()} == {FILE, convergence.MARKDOWN, convergence.PICTURE}
    assert "<svg" in (folder / convergence.PICTURE).read_text()
    assert "| unsolved QPs |" in (folder / convergence.MARKDOWN).read_text()
    known = load_uncertainty(folder / FILE)
    assert load_uncertainty(folder) == known
    assert (known.values, known.spreads) == (result.uncertainty.values, result.uncertainty.spreads)
    table = json.loads((folder / FILE).read_text())
    assert table["levels"]["time_step"]["values"] == [0.002, 0.001, 0.0005, 0.00025]
    assert table["metrics"]["zmp_x_rmse"]["estimates"]["time_step"]["order"] == pytest.approx(1.0)


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
        ({"zmp_x_rmse": -1}, r"uncertainty.values.zmp_x_rmse"),
        ({"zmp_x_rmse": "much"}, r"uncertainty.values.zmp_x_rmse"),
    ],
)
def test_a_file_that_is_no_study_is_refused(tmp_path, metrics, why):
    with pytest.raises(InputError, match=why):
        load_uncertainty(make_study(tmp_path, metrics))
    for text in ("{", '{"metrics": {}}', '{"uncertainty": {"gait": "normal", "steps": 6}}'):
        (tmp_path / FILE).write_text(text)
        with pytest.raises(InputError, match=FILE):
            load_uncertainty(tmp_path)
    assert load_uncertainty(make_study(tmp_path, {"a": "inf"})).values == {"a": math.inf}


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
    """Two steps of the easy gait at three time steps."""
    monkeypatch.setattr(levels, "NUMERICAL", {"time_step": levels.NUMERICAL["time_step"]})
    monkeypatch.setattr(levels, "LAWS", {})
    monkeypatch.setattr(levels, "ENGINES", ())
    settings = [*COARSE, "solver.ik_time_step=0.004"]
    options = {"steps": 2, "levels": 3, "workers": 0, "out": tmp_path}
    found = convergence.convergence("flat", settings, **options)
    assert found.completed
    # Joints have no speed limits, nothing pushes, the plan stays, and two steps show no drift.
    absent = {"speed_excess", "drift_per_step", "recovery_time"}
    absent |= {name for name in METRICS if name.startswith(("plan_moved", "plan_change"))}
    assert METRICS.keys() - absent == found.metrics.keys()
    assert 0.0 < found.uncertainty.values["zmp_x_rmse"] < 2e-3
    known = matching([load_uncertainty(tmp_path)], load_request("flat", [*settings, "gait.steps=2"]))
    assert known.values["zmp_x_rmse"] == found.metrics["zmp_x_rmse"].uncertainty
    rows = (tmp_path / ROWS).read_text()
    monkeypatch.setattr("validation.study.pool._columns", lambda work, options: pytest.fail("walked again"))
    again = convergence.convergence("flat", settings, **options, resume=True)
    assert again.as_dict()["metrics"] == found.as_dict()["metrics"]
    assert (tmp_path / ROWS).read_text() == rows

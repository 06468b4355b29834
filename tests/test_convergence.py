"""Convergence: what is studied, studies of canned walks, their files, and a real one."""

import json
import math
from importlib.util import find_spec

import numpy as np
import pytest

from ampm.planner import routes
from ampm.run_file import load_run
from tests.saved_run import make_study
from validation.cli.app import Status, call
from validation.judge.metrics import DEFAULT_BODY
from validation.judge.profiles import DEFAULT
from validation.judge.uncertainty import CONVERGENCE_FILE, load_uncertainty, matching
from validation.judge.verdict import VerdictName
from validation.store.environment import parameter_values
from validation.store.json import json_ready, write_json
from validation.study.convergence import study as convergence
from validation.study.convergence.result import CONFIRMED, OWN, estimate
from validation.study.convergence.study import runs_of, studies
from validation.study.row_file import ROWS
from validation.trial.plan import load_request

DRAKE = find_spec("pydrake") is not None
COARSE = ["simulation.time_step=0.002"]  # the finest of four levels is then not too slow
FEET = {"footsteps": routes.straight(5, 0.5, 0.2)}


def test_one_thing_changes_at_a_time_and_all_share_the_own_walk():
    run = load_run("normal")
    found = studies(run)
    runs = runs_of(run, found)
    assert len(runs) == 1 + 3 * 3 + 4 * 2 + DRAKE
    for study in found:
        assert study.tasks[0] == OWN
        for value, task in zip(study.values, study.tasks, strict=True):
            assert parameter_values(runs[task]) == parameter_values(run) | {study.key: value}


def row(run, *, offset=0.0, impeded=0.0):
    """A walk whose metrics are formulas: known order in the time step, known dependence on the rest."""
    h, tolerance = run.simulation.time_step, run.solver.tolerance
    hard = impeded if run.contact.impedance_min > 0.8 else 0.0
    values = dict.fromkeys(DEFAULT.tolerances, 0.0) | {
        "zmp_x_rmse": 1e-3 + offset + 0.2 * h + 1e-2 * tolerance + hard,
        "zmp_x_maximum": 5e-3 + h,  # an extreme is never extrapolated, however well it converges
        "force_x_rmse": 2.0 + 0.1 * math.cos(math.pi * math.log2(h / 2e-3)),
        "zmp_agreement_rmse": 1e-4 * h,
        "force_agreement_rmse": 1.0 * h,
        "failed_qp": float(tolerance < 1e-7),
        "energy_positive_work": 450.0 + 1e3 * run.contact.time_constant,
    }
    return {"outcome": "completed", "cause": "", "values": values, "scales": DEFAULT_BODY}


def study(*settings, falls=lambda run: False, **change):
    request = load_request("normal", [*COARSE, *settings, "gait.steps=6"], sections=FEET)
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
    assert result.uncertainty.values["force_agreement_rmse"] == 0.0  # its exact value is zero
    rows = {name: cells for name, *cells in result.tables()[0].rows}
    assert rows["ZMP, RMS error along x"] == ["1.40 ± 0.50", "2.5", "mm", "pass", "1.05", "1.00", "1", "0"]
    assert rows["unsolved QPs"][5] == "exact"


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
    assert study(impeded=-1e-3).metrics["zmp_x_rmse"].spread == pytest.approx(1e-3)
    assert zmp.value == pytest.approx(2.5e-3 - margin * 1e-3, abs=1e-6)
    assert (zmp.undecided, zmp.passed) == (undecided, None if undecided else True)


def test_the_files_are_whole_and_serve_any_number_of_steps_of_their_gait(tmp_path, result):
    write_json(tmp_path / CONVERGENCE_FILE, result.as_dict())
    assert [path.name for path in tmp_path.iterdir()] == [CONVERGENCE_FILE]
    assert "| unsolved QPs |" in result.tables()[0].markdown()
    known = load_uncertainty(tmp_path / CONVERGENCE_FILE)
    assert load_uncertainty(str(tmp_path)) == known
    assert (known.values, known.spreads) == (result.uncertainty.values, result.uncertainty.spreads)
    table = json.loads((tmp_path / CONVERGENCE_FILE).read_text())
    assert table["levels"]["time_step"]["values"] == [0.002, 0.001, 0.0005, 0.00025]
    assert table["metrics"]["zmp_x_rmse"]["estimates"]["time_step"]["order"] == pytest.approx(1.0)
    assert matching([known], load_request("normal", [*COARSE, "gait.steps=30"], sections=FEET)) is known
    assert load_uncertainty(make_study(tmp_path, {"failed_qp": "inf"})).values == {"failed_qp": math.inf}


def test_the_exit_status_follows_the_verdict(monkeypatch, capsys):
    monkeypatch.setattr(convergence, "walk_many", lambda s, **_: [row(load_run()) | vars(t) for t in s])
    assert convergence.convergence(load_request("normal", COARSE, sections=FEET)).uncertainty.steps == 5
    monkeypatch.setattr(convergence, "convergence", lambda *args, **keywords: study(offset=1e-3))
    assert call(["convergence", "normal"]) == Status.OUT_OF_TOLERANCE
    assert "UNDECIDED" in capsys.readouterr().out


def test_a_real_study_and_its_resumption(tmp_path, monkeypatch):
    monkeypatch.setattr(convergence, "STUDIES", convergence.STUDIES[:1])
    request = load_request("flat", [*COARSE, "solver.ik_time_step=0.004", "gait.steps=2"])
    monkeypatch.setattr(convergence, "LEVELS", 3)
    options = {"steps": 2, "workers": 0, "out": tmp_path}
    found = convergence.convergence(request, **options)
    assert found.completed
    assert 0.0 < found.uncertainty.values["zmp_x_rmse"] < 2e-3
    assert matching([load_uncertainty(tmp_path)], request).values == found.uncertainty.values
    rows = (tmp_path / ROWS).read_text()
    monkeypatch.setattr("validation.study.pool.attempt", lambda work, options: pytest.fail("walked again"))
    again = convergence.convergence(request, **options, resume=True)
    assert again.as_dict()["metrics"] == found.as_dict()["metrics"]
    assert (tmp_path / ROWS).read_text() == rows


STEPS = 2e-3 / 2.0 ** np.arange(4)


@pytest.mark.parametrize(("order", "ratio"), [(0.7, 2.0), (1.0, 2.0), (1.5, 2.0), (2.0, 2.0), (1.0, 10.0)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_exact_power_has_its_order_and_its_limit(order, ratio, sign):
    found = estimate(3.0 + sign * 40.0 * (2e-3 / ratio ** np.arange(4)) ** order, ratio)
    assert found.kind == "asymptotic"
    assert (found.order, *found.orders) == pytest.approx((order,) * 3)
    assert found.extrapolated == pytest.approx(3.0)
    error = 40.0 * STEPS[0] ** order
    assert error * CONFIRMED * 0.999 <= found.uncertainty <= error * CONFIRMED * 1.1


def test_the_grid_convergence_index_of_first_order_is_the_textbook_s():
    found = estimate([1.8, 1.4, 1.2, 1.1], 2.0)  # 1 + 0.8 h
    assert found.finest == pytest.approx(1.25 * 0.1)  # Fs |f2 - f1| / (r^p - 1)
    assert found.uncertainty == pytest.approx(1.25 * 0.8)
    second = estimate(1.0 + STEPS**2, 2.0)  # claims no less than first order would, not a third of it
    assert second.finest == pytest.approx(CONFIRMED * (STEPS[2] ** 2 - STEPS[3] ** 2))


@pytest.mark.parametrize(
    "values",
    [
        [1.0, 2.0, 1.4, 1.7],  # oscillating
        [1.0, 1.1, 1.3, 1.7],  # diverging
        [1.0, 2.0, 2.4, 2.6],  # two triplets, two orders: 1.32 and 1
        [1.0, 2.0, 2.01, 2.0101],  # an order of 6.6
        [1.0, 2.0, 2.5, 2.5],  # nothing left at the end: no triplet
        1.0 + STEPS[:3],  # three levels cannot confirm an order
    ],
)
def test_what_has_no_asymptotic_range_is_called_so_and_bounded_by_its_spread(values):
    found = estimate(values, 2.0)
    assert (found.kind, found.order, found.extrapolated) == ("no asymptotic range", None, None)
    assert 1.0 <= found.uncertainty / np.ptp(values) <= 4.0


@pytest.mark.parametrize(
    ("values", "kind", "uncertainty"),
    [
        ([7.0, 7.0 + 1e-14, 7.0, 7.0], "constant", 1e-14),
        ([1.0, 2.0, math.nan, 2.0], "unknown", math.inf),
        ([math.nan] * 4, "unknown", math.nan),
    ],
)
def test_constant_and_unknown_sequences(values, kind, uncertainty):
    found = estimate(values, 2.0)
    assert found.kind is kind
    assert found.uncertainty == pytest.approx(uncertainty, abs=1e-14, nan_ok=True)


def test_the_uncertainty_covers_the_limit_of_disturbed_sequences():
    """First order with noise of a tenth of the first change: asymptotic or not, the limit is within."""
    rng = np.random.default_rng(3)
    covered = []
    for _ in range(500):
        values = 10.0 + 100.0 * STEPS + rng.normal(scale=0.01, size=4)
        covered.append(abs(values[0] - 10.0) <= estimate(values, 2.0).uncertainty)
    assert np.mean(covered) > 0.95

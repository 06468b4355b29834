"""Convergence: sequences of known order, studies of stand-in walks, verdicts with uncertainty, a real one."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from ampm.exceptions import BodilyRefusal, InputError
from ampm.parameters import load_run
from tests.saved_run import make_run, make_study
from tests.walk import STILL, perfect_walk, with_state
from validation.cli import summary_text
from validation.cli.app import Status, call
from validation.judge.compare import compare
from validation.judge.metrics import evaluate
from validation.judge.profiles import DEFAULT, STRICT
from validation.judge.uncertainty import FILE, Uncertainty, load_uncertainty, matching
from validation.judge.verdict import VerdictName, build_summary, judge
from validation.show.report import render
from validation.store.saved import load_saved_run
from validation.study.convergence import command
from validation.study.convergence.execute import OWN, runs_of, walk_levels
from validation.study.convergence.order import (
    CONFIRMED,
    NO_RANGE,
    UNCONFIRMED,
    Kind,
    estimate,
    input_uncertainty,
    observed_orders,
)
from validation.study.convergence.result import combine
from validation.study.convergence.studies import Figures, studies, walk_level
from validation.study.convergence.table import markdown, print_convergence
from validation.trial.plan import load_request

STEPS = 2e-3 / 2.0 ** np.arange(4)

# ------------------------------------------------------------------- sequences of known order


@pytest.mark.parametrize("order", [0.7, 1.0, 1.5, 2.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_exact_power_has_its_order_and_its_limit(order, sign):
    found = estimate(3.0 + sign * 40.0 * STEPS**order, 2.0)
    assert found.kind is Kind.ASYMPTOTIC
    assert found.orders == pytest.approx((order, order))
    assert found.order == pytest.approx(order)
    assert found.extrapolated == pytest.approx(3.0)
    assert found.safety == CONFIRMED
    error = 40.0 * STEPS[0] ** order
    assert error * CONFIRMED * 0.999 <= found.uncertainty <= error * CONFIRMED * 1.1


def test_the_grid_convergence_index_of_first_order_is_the_textbook_s():
    values = [1.8, 1.4, 1.2, 1.1]  # 1 + 0.8 h
    found = estimate(values, 2.0)
    assert found.finest == pytest.approx(1.25 * 0.1)  # Fs |f2 - f1| / (r^p - 1)
    assert found.uncertainty == pytest.approx(1.25 * 0.8)


def test_a_ratio_of_ten_is_as_good_as_two():
    found = estimate(5.0 + 0.3 * 10.0 ** -np.arange(4.0), 10.0)
    assert found.order == pytest.approx(1.0)
    assert found.extrapolated == pytest.approx(5.0)


def test_a_higher_order_term_that_dies_away_leaves_the_leading_one():
    found = estimate(2.0 + 10.0 * STEPS + 300.0 * STEPS**2, 2.0)
    assert found.asymptotic
    assert found.order == pytest.approx(1.0, abs=0.05)
    assert found.extrapolated == pytest.approx(2.0, abs=1e-3)
    assert abs((found.extrapolated or 0.0) - 2.0) < found.finest


def test_an_order_above_the_formal_one_claims_no_less_than_first_order_would():
    second = estimate(1.0 + STEPS**2, 2.0)
    last = STEPS[2] ** 2 - STEPS[3] ** 2
    assert second.finest == pytest.approx(CONFIRMED * last)  # and not a third of it


@pytest.mark.parametrize(
    ("values", "why"),
    [
        ([1.0, 2.0, 1.4, 1.7], "from one side"),  # oscillating, converging
        ([1.0, 1.2, 0.8, 1.6], "from one side"),  # oscillating, diverging
        ([1.0, 1.1, 1.3, 1.7], "grow"),  # diverging
        ([1.0, 2.0, 2.1, 2.19], "do not agree|not those"),  # two triplets, two orders
        ([1.0, 2.0, 2.01, 2.0101], "not those"),  # an order of 6.6
        ([1.0, 2.0, 2.5, 2.5], "from one side"),  # nothing left at the end: no triplet
    ],
)
def test_what_has_no_asymptotic_range_is_called_so_and_bounded_by_its_spread(values, why):
    found = estimate(values, 2.0)
    assert found.kind is Kind.NO_RANGE
    assert found.order is None
    assert found.extrapolated is None
    assert found.reason.startswith(NO_RANGE)
    assert re.search(why, found.reason), found.reason
    spread = max(values) - min(values)
    last, before = abs(values[-1] - values[-2]), abs(values[-2] - values[-3])
    assert found.uncertainty == pytest.approx(spread + UNCONFIRMED * max(last, before / 2.0))
    assert spread <= found.uncertainty <= 4.0 * spread


def test_noise_is_hardly_ever_taken_for_an_order():
    draws = np.random.default_rng(1).normal(size=(2000, 4))
    kinds = [estimate(draw, 2.0).kind for draw in draws]
    assert kinds.count(Kind.ASYMPTOTIC) < 0.03 * len(kinds)


def test_an_extreme_is_never_extrapolated_however_well_it_converges():
    values = 1.0 + 40.0 * STEPS
    found = estimate(values, 2.0, forbidden="an extreme")
    assert found.kind is Kind.NO_RANGE
    assert found.extrapolated is None
    assert found.orders == pytest.approx((1.0, 1.0))  # reported all the same
    assert found.uncertainty > np.ptp(values)


def test_three_levels_cannot_confirm_an_order():
    found = estimate(1.0 + STEPS[:3], 2.0)
    assert not found.asymptotic
    assert "3 levels cannot confirm" in found.reason


def test_equal_values_are_constant():
    assert estimate([0.0] * 4, 2.0).kind is Kind.CONSTANT
    assert estimate([0.0] * 4, 2.0).uncertainty == 0.0
    assert estimate([7.0, 7.0 + 1e-14, 7.0, 7.0], 2.0).kind is Kind.CONSTANT


def test_a_level_without_a_value_leaves_no_bound():
    assert math.isinf(estimate([1.0, 2.0, math.nan, 2.0], 2.0).uncertainty)
    assert math.isnan(estimate([math.nan] * 4, 2.0).uncertainty)
    assert estimate([1.0, math.nan, 1.0, 1.0], 2.0).kind is Kind.UNKNOWN


def test_orders_of_triplets():
    assert observed_orders([1 + 1, 1 + 0.5, 1 + 0.25], 2.0) == pytest.approx((1.0,))
    assert np.isnan(observed_orders([1.0, 2.0, 1.0], 2.0)).all()
    assert observed_orders([0.0, 1.0, 3.0], 2.0) == pytest.approx((-1.0,))  # growing


def test_too_few_levels_or_no_ratio_is_an_error():
    with pytest.raises(ValueError, match="two levels"):
        estimate([1.0], 2.0)
    with pytest.raises(ValueError, match="ratio"):
        estimate([1.0, 2.0], 1.0)


def test_the_uncertainty_covers_the_limit_of_disturbed_sequences():
    """First order with noise of a tenth of the first change: asymptotic or not, the limit is within."""
    rng = np.random.default_rng(3)
    covered = []
    for _ in range(500):
        values = 10.0 + 100.0 * STEPS + rng.normal(scale=0.01, size=4)
        covered.append(abs(values[0] - 10.0) <= estimate(values, 2.0).uncertainty)
    assert np.mean(covered) > 0.95


def test_an_input_uncertainty_is_the_largest_deviation():
    assert input_uncertainty([1.3, 1.0, 0.9], 1) == pytest.approx(0.3)
    assert math.isinf(input_uncertainty([math.nan, 1.0, 0.9], 1))
    assert math.isnan(input_uncertainty([1.0, math.nan, 0.9], 1))


# --------------------------------------------------------------------------------- studies


def test_the_time_step_is_halved_from_the_gait_s_own():
    run = load_run("normal")
    found = {study.topic.name: study for study in studies(run)}
    assert found["time_step"].values == (0.002, 0.001, 0.0005, 0.00025)
    assert found["qp_tolerance"].values == (5e-5, 5e-6, 5e-7, 5e-8)
    assert found["contact_stiffness"].values[found["contact_stiffness"].own] == 0.015
    stiffness = [1.0 / value**2 for value in found["contact_stiffness"].values]
    assert np.array(stiffness) * 0.015**2 == pytest.approx([0.5, 1.0, 2.0])
    assert [study.topic.kind for study in studies(run)] == ["numerical"] * 3 + ["input"] * 2
    fine = studies(load_run("normal", ["simulation.time_step=0.001"]), ["time_step"], levels=5)
    assert fine[0].values == (0.001, 0.0005, 0.00025, 0.000125, 0.0000625)


def test_control_stays_at_its_frequency_and_one_thing_changes_at_a_time():
    run = load_run("normal")
    for (key, value), changed in runs_of(run, studies(run)).items():
        different = {
            f"{section}.{name}"
            for section, entries in changed.model_dump().items()
            for name, entry in entries.items()
            if entry != run.model_dump()[section][name]
        }
        assert different == ({key} if key else set())
        assert not key or value in changed.model_dump()[key.partition(".")[0]].values()
        assert changed.controller.frequency == 500.0


def test_all_studies_share_the_walk_at_the_own_parameters_and_the_longest_comes_first():
    run = load_run("normal")
    found = studies(run)
    runs = runs_of(run, found)
    assert len(runs) == 1 + sum(len(study.values) - 1 for study in found)
    assert next(iter(runs))[1] == 0.00025


def test_an_exact_qp_solver_has_no_tolerance_to_study():
    names = [study.topic.name for study in studies(load_run("normal", ["solver.qp=daqp"]))]
    assert "qp_tolerance" not in names


def test_contacts_that_mujoco_would_not_walk_as_asked_are_left_out_or_said():
    short = load_run("normal", ["contact.time_constant=0.005"])
    stiffness = next(study for study in studies(short) if study.topic.name == "contact_stiffness")
    assert min(stiffness.values) == 0.005  # 3.5 ms is below twice the step of 2 ms
    shorter = load_run("normal", ["contact.time_constant=0.003"])
    assert "raises it to 4 ms" in studies(shorter, ["time_step"])[0].caution
    assert studies(load_run("normal"), ["time_step"])[0].caution == ""


@pytest.mark.parametrize(("names", "levels"), [(["step"], 4), ([], 2), ([], 7)])
def test_a_bad_study_is_refused(names, levels):
    with pytest.raises(InputError, match=r"use one of|choose 3"):
        studies(load_run("normal"), names, levels=levels)


# ------------------------------------------------------------------- stand-in walks


def walker(run, name, profile, *, falls=lambda run: False):
    """A walk whose figures are formulas: known order in the time step, known dependence on the rest."""
    if falls(run):
        return Figures("fell", "It stumbled.", {}, {}, {}, 588.6, 0.1, 100.0)
    h, tolerance = run.simulation.time_step, run.solver.tolerance
    values = {
        "zmp_x_rmse": 1e-3 + 0.2 * h + 10.0 * tolerance * 1e-3,
        "zmp_x_maximum": 5e-3 + h * (1.0 if h > 4e-4 else 3.0),
        "force_x_rmse": 2.0 + 0.1 * math.cos(math.pi * math.log2(h / 2e-3)),
        "zmp_agreement_rmse": 0.16 * h,
        "failed_qp": float(tolerance < 1e-7),
        "energy_positive_work": 450.0 + 1e3 * run.contact.time_constant,
    }
    units = {"force_x_rmse": "N", "failed_qp": "1", "energy_positive_work": "J"}
    limits = {"zmp_x_rmse": 2e-3, "zmp_x_maximum": 40e-3, "force_x_rmse": 4.7, "zmp_agreement_rmse": 5e-4,
              "failed_qp": 0.0}  # fmt: skip
    return Figures(
        "completed", "", values, {name: units.get(name, "m") for name in values}, limits, 588.6, 0.1, 100.0
    )


def study(runner=walker, settings=(), **options):
    return command.run("normal", settings, command.Options(workers=1, **options), runner=runner)


@pytest.fixture(scope="module")
def result():
    return study()


def test_every_metric_has_order_extrapolated_value_and_uncertainty_or_says_why_not(result):
    entries = result.as_dict()["metrics"]
    zmp = entries["zmp_x_rmse"]
    assert zmp["asymptotic"] is True
    assert zmp["order"] == pytest.approx(1.0)
    assert zmp["extrapolated"] == pytest.approx(1e-3 + 10.0 * 5e-8)
    step, tolerance = zmp["by_study"]["time_step"], zmp["by_study"]["qp_tolerance"]
    assert step["values"] == pytest.approx([1.4005e-3, 1.2005e-3, 1.1005e-3, 1.0505e-3])
    assert step["uncertainty"] == pytest.approx(1.25 * 0.4e-3)
    assert zmp["by_study"]["ik_grid"]["kind"] == "constant"
    assert zmp["uncertainty"] == pytest.approx(step["uncertainty"] + tolerance["uncertainty"])
    peak = entries["zmp_x_maximum"]
    assert (peak["asymptotic"], peak["order"], peak["extrapolated"]) == (False, None, None)
    assert peak["reason"].startswith(NO_RANGE)
    assert entries["force_x_rmse"]["reason"].startswith(NO_RANGE)
    assert all({"value", "unit", "order", "extrapolated", "uncertainty", "reason"} <= entry.keys()
               for entry in entries.values())  # fmt: skip


def test_a_self_check_is_judged_at_the_step_that_it_checks(result):
    gap = result.metrics["zmp_agreement_rmse"]
    assert gap.estimates["time_step"].extrapolated == pytest.approx(0.0, abs=1e-12)
    assert gap.estimates["time_step"].uncertainty == pytest.approx(1.25 * 0.32e-3)
    assert gap.uncertainty == 0.0
    assert gap.passed is True


def test_a_count_is_exact(result):
    assert result.metrics["failed_qp"].levels["qp_tolerance"] == (0.0, 0.0, 0.0, 1.0)
    assert result.metrics["failed_qp"].uncertainty == 0.0
    assert any("1 of the controller's QPs unsolved" in note for note in result.notes)


def test_contact_stiffness_is_a_sensitivity_and_no_part_of_the_numerical_uncertainty(result):
    work = result.metrics["energy_positive_work"]
    assert work.uncertainty == 0.0
    assert work.inputs["contact_stiffness"] == pytest.approx(15.0 * (math.sqrt(2) - 1))
    assert work.input_uncertainty == pytest.approx(work.inputs["contact_stiffness"])
    assert "order" not in work.as_dict()["by_study"]["contact_stiffness"]


def test_the_verdict_is_spoken_beyond_the_uncertainty():
    assert study().verdict is VerdictName.PASS

    def limited(limit):
        def runner(run, name, profile):
            walk = walker(run, name, profile)
            return replace(walk, limits={"zmp_x_rmse": limit})

        return study(runner).metrics["zmp_x_rmse"]

    value, u = study().metrics["zmp_x_rmse"].value, study().metrics["zmp_x_rmse"].uncertainty
    assert limited(value + 1.01 * u).passed is True
    assert limited(value + 0.99 * u).undecided
    assert limited(value - 0.99 * u).undecided
    assert limited(value - 1.01 * u).passed is False


def test_a_level_that_falls_leaves_the_uncertainty_without_a_bound():
    found = study(partial(walker, falls=lambda run: run.simulation.time_step == 0.0005))
    assert not found.completed
    assert math.isinf(found.metrics["zmp_x_rmse"].uncertainty)
    assert found.verdict is VerdictName.UNDECIDED
    assert any("0.5 ms: fell, It stumbled." in note for note in found.notes)
    text = json.dumps(command.json_ready(found.as_dict()), allow_nan=False)
    assert json.loads(text)["metrics"]["zmp_x_rmse"]["uncertainty"] == "inf"


def test_a_soft_floor_that_nobody_walks_on_is_a_sensitivity_without_bound_and_no_failure():
    found = study(partial(walker, falls=lambda run: run.contact.time_constant > 0.02))
    assert found.completed
    assert found.verdict is VerdictName.PASS
    assert math.isinf(found.metrics["zmp_x_rmse"].input_uncertainty)


def test_a_gait_that_falls_at_its_own_parameters_has_no_verdict():
    found = study(partial(walker, falls=lambda run: True))
    assert found.verdict is VerdictName.NOT_MEASURED
    assert not found.completed
    assert found.metrics == {}


def test_one_study_alone_speaks_for_itself():
    found = study(only=("qp_tolerance",))
    assert list(found.as_dict()["levels"]) == ["qp_tolerance"]
    assert found.metrics["zmp_x_rmse"].headline is found.metrics["zmp_x_rmse"].estimates["qp_tolerance"]


def test_the_tables_say_it_in_words(result, capsys):
    print_convergence(result)
    out = capsys.readouterr().out
    for text in ("no asymptotic range", "zmp_x_rmse", "1.00", "u_input", "normal: PASS", "1.4 ± 0.5"):
        assert text in out, text
    page = markdown(result)
    for text in (
        "## time_step: time step of the physics",
        "| 2 ms | 1 ms | 0.5 ms | 0.25 ms |",
        "**1.00, 1.00**",
    ):
        assert text in page, text


def test_a_refusal_inside_a_level_is_an_outcome(monkeypatch):
    def refuse(*args, **keywords):
        raise BodilyRefusal("too long", reason="leg", value=1.0, limit=0.5, unit="m", way_out="shorten")

    monkeypatch.setattr("validation.trial.plan.plan_walk", refuse)
    walk = walk_level(load_run("normal"), "normal", DEFAULT)
    assert (walk.outcome, walk.completed) == ("refused", False)
    assert walk.cause == "too long; shorten."


# --------------------------------------------------------------------------- files and reading them back


@pytest.fixture(scope="module")
def folder(tmp_path_factory, result):
    out = tmp_path_factory.mktemp("study")
    command.write(result, out)
    return out


def test_the_files_are_whole_and_read_back(folder, result):
    assert {path.name for path in folder.iterdir()} == set(command.FILES)
    assert (folder / "convergence.png").read_bytes().startswith(b"\x89PNG")
    assert "<svg" in (folder / "convergence.svg").read_text()
    known = load_uncertainty(folder / FILE)
    assert load_uncertainty(folder) == known
    assert known.values["zmp_x_rmse"] == result.metrics["zmp_x_rmse"].uncertainty
    assert (known.gait, known.steps) == ("normal", 6)
    table = json.loads((folder / FILE).read_text())
    assert {"gait", "run", "levels", "metrics"} <= table.keys()
    assert table["levels"]["time_step"]["values"] == [0.002, 0.001, 0.0005, 0.00025]


def test_a_study_serves_any_number_of_steps_of_its_gait_and_no_other_gait(folder):
    known = load_uncertainty(folder)
    assert matching([known], load_request("normal", ["gait.steps=30"])) is known
    with pytest.raises(InputError, match=r"no study is of momentum.*gait\.c_s = 1\.0, and here 1\.2"):
        matching([known], load_request("momentum", []))
    with pytest.raises(InputError, match=r"simulation\.time_step = 0\.002, and here 0\.001"):
        matching([known], load_request("normal", ["simulation.time_step=0.001"]))


@pytest.mark.parametrize(
    ("metrics", "why"),
    [
        ({}, "holds no metrics"),
        ({"zmp_x_rmse": -1}, "no number of at least 0"),
        ({"zmp_x_rmse": "much"}, "no number of at least 0"),
    ],
)
def test_a_study_that_was_spoilt_is_refused(tmp_path, metrics, why):
    with pytest.raises(InputError, match=why):
        load_uncertainty(make_study(tmp_path, metrics))


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("{", "no JSON"),
        ("[]", "is no convergence study"),
        ('{"metrics": {}}', "is no convergence study"),
        ('{"metrics": {"a": {"uncertainty": 1}}, "steps": "six"}', "is no convergence study"),
    ],
)
def test_a_file_that_is_no_study_is_refused(tmp_path, text, why):
    path = tmp_path / FILE
    path.write_text(text)
    with pytest.raises(InputError, match=why):
        load_uncertainty(path)


def test_infinite_and_unknown_uncertainties_bound_nothing(tmp_path):
    known = load_uncertainty(make_study(tmp_path, {"a": "inf", "b": None}))
    assert dict(known.values) == {"a": math.inf, "b": math.inf}


# --------------------------------------------------------------------------- verdicts of a run


@pytest.fixture(scope="module")
def walk():
    return perfect_walk()


def off_by(walk, shift):
    planned, record, measured = walk
    off = with_state(planned, measured, com_shift=(shift, 0.0, 0.0))
    return compare(planned, record, off, standing=STILL)


@pytest.fixture(scope="module")
def summary(walk):
    comparison = off_by(walk, 0.0018)
    known = Uncertainty("x", 6, "", {"zmp_x_rmse": 0.0003, "zmp_y_rmse": 1e-5, "zmp_x_maximum": math.inf}, {})
    verdict = judge(comparison, evaluate(comparison), STRICT, known)
    extra = {"gait": "x", "uncertainty": {"gait": "x", "steps": 6, "run": "abc"}}
    timing = {"simulated": 2.0, "real_time_factor": 5.0}
    return build_summary(comparison, verdict, timing=timing, extra=extra)


def test_the_terminal_quotes_it(summary, tmp_path, capsys):
    summary_text.print_result(summary, tmp_path)
    out = capsys.readouterr().out
    assert "1.8 ± 0.3" in out
    assert "± inf" in out
    assert "undecided" in out
    assert "x: UNDECIDED" in out


def test_the_report_quotes_it(tmp_path):
    run = make_run(tmp_path / "run")
    path = run / "summary.json"
    found = json.loads(path.read_text())
    metric = found["metrics"]["zmp_x_rmse"]
    metric |= {"uncertainty": 0.002, "undecided": True, "pass": None, "margin": None}
    metric["display"]["uncertainty"] = 2.0
    found["metrics"]["zmp_y_rmse"]["display"]["uncertainty"] = "inf"
    lacking = found["metrics"]["force_x_rmse"]
    lacking |= {"not_studied": ["qp_tolerance"], "undecided": True, "pass": None, "margin": None}
    lacking["display"] |= {"uncertainty": None, "uncertainty_at_least": None}
    known = {"gait": "normal", "steps": 6, "run": "abc"}
    known |= {"studies": ["time_step", "ik_grid"], "not_studied": ["qp_tolerance"]}
    found |= {"verdict": "undecided", "uncertainty": known}
    path.write_text(json.dumps(found))
    page = render(load_saved_run(run))
    assert "±\u00a0∞\u00a0mm" in page
    assert "±\u00a02.0\u00a0mm, <b>undecided</b>" in page
    assert "of normal, 6 steps a level (time_step + ik_grid), which lacks qp_tolerance" in page
    assert "±\u00a0not studied" in page


# --------------------------------------------------------------------------- command line, and a real study


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["nothing"], "neither a preset nor a file"),
        (["normal", "--set", "gait.speed=1"], "unknown key"),
        (["normal", "--set", "gait.switching_velocity=0.2"], "too slow"),
        (["normal", "--steps", "1"], "walk 2 at least"),
        (["normal", "--levels", "2"], "choose 3"),
        (["normal", "--study", "steps"], "use one of time_step"),
        (["normal", "--workers", "0"], "at least one process"),
        (["normal", "--profile", "lenient"], "use one of default"),
        (["normal", "--set", "simulation.time_step=0.0015"], "must be a whole number"),
    ],
)
def test_bad_input_is_one_sentence_and_status_2(arguments, why, capsys):
    assert call(["convergence", *arguments]) == Status.REFUSED
    error = capsys.readouterr().err
    assert why in error
    assert "Traceback" not in error


def test_an_existing_folder_is_refused_before_anything_walks(folder, capsys):
    assert call(["convergence", "normal", "--out", str(folder)]) == Status.REFUSED
    assert "--force" in capsys.readouterr().err


def test_the_exit_status_follows_the_verdict(monkeypatch, capsys):
    def with_walker(runner):
        def stand_in(gait, settings, options, *, stages=None):
            return run(gait, settings, replace(options, workers=1), stages=stages, runner=runner)

        monkeypatch.setattr(command, "run", stand_in)
        return call(["convergence", "normal"])

    run = command.run
    assert with_walker(walker) == Status.PASS
    assert (
        with_walker(partial(walker, falls=lambda run: run.simulation.time_step < 4e-4))
        == Status.NOT_COMPLETED
    )

    def tight(run, name, profile):
        return replace(walker(run, name, profile), limits={"zmp_x_rmse": 1.5e-3})

    assert with_walker(tight) == Status.OUT_OF_TOLERANCE
    assert "UNDECIDED" in capsys.readouterr().out


def test_validate_refuses_a_study_of_another_gait_before_it_walks(folder, tmp_path, capsys):
    arguments = ["validate", "momentum", "--uncertainty", str(folder), "--out", str(tmp_path / "run")]
    assert call(arguments) == Status.REFUSED
    assert "no study is of momentum" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()
    assert call(["validate", "normal", "--uncertainty", str(tmp_path / "no.json")]) == Status.REFUSED


@pytest.fixture(scope="module")
def real(tmp_path_factory):
    """Two steps of the easy gait at 2, 1, 0.5 ms, in two processes."""
    out = tmp_path_factory.mktemp("real") / "study"
    options = command.Options(steps=2, levels=3, only=("time_step",), workers=2, out=out)
    return command.run("flat", ["solver.ik_time_step=0.004"], options), out


def test_a_real_study_walks_every_level_and_keeps_it(real):
    found, out = real
    assert found.completed
    assert {walk.outcome for walk in found.walks.values()} == {"completed"}
    gap = found.metrics["zmp_agreement_rmse"]
    assert gap.estimates["time_step"].orders == pytest.approx((1.0,), abs=0.1)  # the integrator's
    assert found.metrics["com_agreement_maximum"].value < 1e-12
    table = json.loads((out / FILE).read_text())
    assert table["levels"]["time_step"]["outcomes"] == ["completed"] * 3
    assert all(entry["reason"] for entry in table["metrics"].values())


def test_a_walk_quotes_the_real_study(real):
    found, out = real
    asked = load_request("flat", ["solver.ik_time_step=0.004", "gait.steps=2"])
    known = matching([load_uncertainty(out)], asked)
    again = walk_levels({OWN: asked.run}, "flat", DEFAULT, workers=1)[OWN]
    name = "zmp_x_rmse"
    assert again.values[name] == found.metrics[name].value  # to the bit, in another process
    assert known.values[name] == found.metrics[name].at_least > 0.0
    assert known.not_studied == ("ik_grid", "qp_tolerance")
    assert found.metrics["switch_zmp_x_near"].value > 0.0
    assert found.metrics["switch_zmp_x_near"].unit == "m"
    assert found.verdict is VerdictName.UNDECIDED
    assert math.isnan(combine(asked, DEFAULT, [], {OWN: again}).metrics[name].uncertainty)


def test_a_study_of_nothing_numerical_is_told(capsys):
    found = study(only=("contact_stiffness",))
    print_convergence(found)
    assert "u_input" in capsys.readouterr().out
    assert found.metrics["zmp_x_rmse"].reason == "no numerical study"


# --------------------------------------------------------------------------- what was not studied


@pytest.mark.parametrize(
    ("only", "lacking"),
    [
        (("contact_stiffness",), ["time_step", "ik_grid", "qp_tolerance"]),
        (("time_step",), ["ik_grid", "qp_tolerance"]),
        (("ik_grid", "qp_tolerance"), ["time_step"]),
    ],
)
def test_what_was_not_studied_is_never_a_zero_nor_a_pass(only, lacking, capsys):
    found = study(only=only)
    assert found.verdict is VerdictName.UNDECIDED
    assert f"Not studied: {', '.join(lacking)}" in found.verdict_reason
    assert "met by more than the" not in found.verdict_reason
    zmp = found.metrics["zmp_x_rmse"]
    assert math.isnan(zmp.uncertainty)
    assert (zmp.undecided, zmp.passed, list(zmp.not_studied)) == (True, None, lacking)
    assert found.metrics["failed_qp"].uncertainty == 0.0  # a count is exact without any study
    assert found.metrics["failed_qp"].passed is True
    entries = command.json_ready(found.as_dict())
    assert entries["metrics"]["zmp_x_rmse"]["uncertainty"] is None
    assert entries["not_studied"] == lacking
    print_convergence(found)
    out = capsys.readouterr().out
    assert "normal: UNDECIDED" in out
    assert f"not studied: {', '.join(lacking)}" in out
    assert ("± not studied" if only == ("contact_stiffness",) else "± ≥ ") in out
    assert "zmp_x_rmse" in out


def test_a_self_check_needs_no_time_step_and_an_exact_solver_no_tolerance():
    gap = study(only=("ik_grid", "qp_tolerance")).metrics["zmp_agreement_rmse"]
    assert (gap.not_studied, gap.passed) == ((), True)
    exact = study(settings=["solver.qp=daqp"], only=("time_step", "ik_grid"))
    assert exact.not_studied == ()
    assert exact.verdict is VerdictName.PASS


def test_the_verdict_names_the_studies_inside(result):
    assert "(time_step + ik_grid + qp_tolerance)" in result.verdict_reason
    assert result.as_dict()["uncertainty_of"] == ["time_step", "ik_grid", "qp_tolerance"]


def test_a_study_without_the_time_step_decides_no_run(walk, tmp_path, capsys):
    command.write(study(only=("contact_stiffness",)), tmp_path / "none")
    command.write(study(only=("time_step",)), tmp_path / "step")
    comparison = off_by(walk, 0.0018)
    for folder, shown in (("none", "not studied"), ("step", "≥ ")):  # and neither has ± 0 of a metric
        known = load_uncertainty(tmp_path / folder)
        verdict = judge(comparison, evaluate(comparison), STRICT, known)
        assert verdict.name is VerdictName.UNDECIDED
        assert "not studied: " in verdict.reason
        extra = {"gait": "x", "uncertainty": known.as_dict()}
        timing = {"simulated": 2.0, "real_time_factor": 5.0}
        told = build_summary(comparison, verdict, timing=timing, extra=extra)
        entry = told["metrics"]["zmp_x_rmse"]
        assert (entry["uncertainty"], entry["pass"], entry["undecided"]) == (None, None, True)
        assert "qp_tolerance" in entry["not_studied"]
        assert told["uncertainty"]["studies"] == ([] if folder == "none" else ["time_step"])
        summary_text.print_result(told, tmp_path)
        out = capsys.readouterr().out
        assert f"± {shown}" in out
        assert "not studied, so nothing is decided" in out


def test_studies_inside_are_named_on_the_terminal_and_in_the_summary(folder, summary, tmp_path, capsys):
    known = load_uncertainty(folder).as_dict()
    assert known["studies"] == ["time_step", "ik_grid", "qp_tolerance"]
    summary_text.print_result({**summary, "uncertainty": known}, tmp_path)
    assert "(time_step + ik_grid + qp_tolerance)" in capsys.readouterr().out


def test_a_run_s_summary_is_no_convergence_study(summary, tmp_path, capsys):
    path = tmp_path / "summary.json"
    path.write_text(json.dumps(summary))
    with pytest.raises(InputError, match="is no convergence study; give the convergence"):
        load_uncertainty(path)
    assert call(["validate", "normal", "--uncertainty", str(path), "--out", str(tmp_path / "run")]) == 2
    told = capsys.readouterr()
    assert "is no convergence study" in told.err
    assert told.err.count("\n") == 1
    assert not (tmp_path / "run").exists()

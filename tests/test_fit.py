"""Constants of the AMPM, fitted to walks whose constants are known, and refusals of what cannot be fitted."""

import math
import tomllib
from typing import Any

import numpy as np
import pytest

import validation as val
from ampm import GaitParameters, load_run
from ampm.planner.periodic import plan_gait
from validation.judge.fit import MODELS

MASS = 60.0
GAITS: list[dict[str, Any]] = [
    {},
    {"c_s": 1.2, "c_y": 0.4},
    {"step_length": 0.4, "switching_velocity": 0.8},
    {"step_length": 0.7, "switching_velocity": 1.3},
    {"c_s": 0.8, "switching_velocity": 1.2},
    {"c_y": 0.7, "step_width": 0.12},
    {"c_y": 1.3, "step_width": 0.25},
    {"a_s": 4.0, "c_s": 1.3, "single_support_ratio": 0.7},
    {"a_s": math.inf, "single_support_ratio": 0.7, "switching_velocity": 1.2},
    {"com_height": 0.5, "step_length": 0.25, "switching_velocity": 0.6},
]


def table_of(gait, rate=500.0, noise=0.0, seed=0):
    """What sensors would have told of a plan, with noise of 3 N, 2 mm of the ZMP and 1 mm of the COM."""
    plan = plan_gait(gait, MASS)
    random, table = np.random.default_rng(seed), {"time": np.arange(0.0, plan.duration, 1.0 / rate)}
    sample = plan.sample(table["time"])
    for name, size in (("force", 3.0), ("zmp", 2e-3), ("com", 1e-3)):
        for axis, values in zip("xyz", getattr(sample, name).T, strict=False):
            table[f"{name}_{axis}"] = values + random.normal(0.0, noise * size, len(values))
    return table


def truth(gait):
    """Constants of a plan by the names of the fit."""
    of = plan_gait(gait, MASS).constants
    across = of.s / of.beta
    own = ("com_height", "step_length", "step_width", "switching_velocity", "single_support_ratio")
    return {name: getattr(gait, name) for name in own} | {
        "single_support": of.single_support_duration,
        "double_support": of.double_support_duration,
        "inverse_a_single_x": of.inverse_a_s,
        "c_single_x": gait.c_s,
        "inverse_a_double_x": 1.0 / of.a_d,
        "c_double_x": of.c_d,
        "inverse_a_single_y": 0.0,
        "c_single_y": gait.c_y,
        "inverse_a_double_y": 1.0 + across,
        "c_double_y": 1.0 + (1.0 - gait.c_y) * across,
        **{f"b_{support}_{axis}": 0.0 for support in ("single", "double") for axis in "xy"},
    }


def distances(fit, gait):
    """Distances from the true constants over the intervals, with 5e-5 for rounding and interpolation."""
    wanted = truth(gait)
    assert wanted.keys() == fit.constants.keys()
    return {
        name: abs(item.value - wanted[name]) / (item.interval + 5e-5 * max(1.0, abs(wanted[name])))
        for name, item in fit.constants.items()
    }


@pytest.mark.parametrize(
    ("rate", "noise", "measured", "gaits"),
    [(500.0, 0.0, "com", GAITS[1::3]), (500.0, 1.0, "height", GAITS), (100.0, 1.0, "com", GAITS)],
)
def test_gaits_return_their_constants_within_their_intervals(rate, noise, measured, gaits):
    found = []
    for seed, changes in enumerate(gaits):
        gait = GaitParameters(**changes)
        table, height = table_of(gait, rate, noise, seed), None
        if measured == "height":
            height = gait.com_height
            table = {name: values for name, values in table.items() if not name.startswith("com")}
        found += distances(val.fit_log(table, mass=MASS, com_height=height), gait).values()
    assert len(found) == 19 * len(gaits)
    assert np.mean(np.array(found) <= 1.0) >= 0.95
    assert max(found) < 1.5


def test_offsets_and_drift_of_the_plates_are_in_the_intervals():
    gait = GaitParameters(c_s=1.2, c_y=0.4)
    table = table_of(gait, noise=1.0)
    table["force_x"] += 3.0
    table["force_y"] -= 2.0
    table["force_z"] += np.linspace(0.0, 10.0, len(table["time"]))
    clean = val.fit_log(table_of(gait, noise=1.0), mass=MASS)
    for mass in (MASS, None):
        fit = val.fit_log(table, mass=mass)
        assert max(distances(fit, gait).values()) < 1.5
        assert fit.constants["c_single_x"].interval > 2.0 * clean.constants["c_single_x"].interval
    assert any("The body has 60.5" in note for note in fit.notes)


def test_without_angular_momentum_a_rolling_zmp_explains_as_much():
    """Negative control: with c = 1 the AMPM adds nothing; with a ZMP that rests a resting ZMP is enough."""
    fit = val.fit_log(table_of(GaitParameters(**GAITS[8]), noise=1.0), mass=MASS)
    scores = fit.scores
    for signal in ("zmp_x", "zmp_y", "force_x", "force_y"):
        rolling, ampm = (scores[signal][model]["stride"]["share"] for model in MODELS[1:])
        assert rolling > 0.99, signal
        assert ampm == pytest.approx(rolling, abs=2e-3), signal
    assert scores["force_x"]["pendulum"]["single"]["share"] > 0.99
    assert math.isnan(scores["angular_momentum_y"]["ampm"]["stride"]["share"])
    assert "L_y rests" in fit.sentence


def test_a_simulated_walk_returns_its_plan_and_a_gait_to_walk(run_of, tmp_path, ampm):
    folder = run_of("normal", steps=10)
    answer = ampm("fit", folder, "--out", tmp_path / "fit", "--json")
    assert answer.status == 0, answer.err
    fit, gait = val.fit_log(folder), load_run("normal").gait
    assert max(distances(fit, gait).values()) < 1.5
    assert answer.json["constants"]["c_single_x"]["value"] == fit.constants["c_single_x"].value
    walked = load_run(tmp_path / "fit" / "gait.toml")
    assert walked.gait.step_length == pytest.approx(0.6, abs=1e-3)
    assert walked.body.mass == pytest.approx(60.0, rel=1e-3)
    assert ampm("plan", tmp_path / "fit" / "gait.toml").status == 0
    assert fit.sentence in (tmp_path / "fit" / "report.html").read_text(encoding="utf-8")
    assert ampm("fit", folder, "--out", tmp_path / "fit").status == 2
    assert ampm("fit", folder, "--out", tmp_path / "fit", "--force").status == 0


def test_the_gait_of_a_person_can_be_planned(tmp_path, ampm):
    """Constants as of a person at 1.12 m/s: with the preset's feet the heel would rise too early."""
    gait = GaitParameters(
        com_height=0.995,
        step_length=0.685,
        switching_velocity=1.175,
        single_support_ratio=0.694,
        a_s=3.47,
        c_s=0.84,
        c_y=1.5,
        step_width=0.207,
    )
    val.fit_log(table_of(gait)).save(tmp_path / "fit")
    assert set(tomllib.loads((tmp_path / "fit" / "gait.toml").read_text())) == {"gait", "body"}
    answer = ampm("plan", tmp_path / "fit" / "gait.toml")
    assert answer.status == 0, answer.err


def refit(statement, **options):
    """A fit of a table that a statement changed."""
    table = table_of(GaitParameters())
    exec(statement, {"np": np}, {"table": table})
    val.fit_log(table, **options)


def test_strides_that_differ_are_left_out_and_counted():
    """A gap of half a second, one of the COM alone, and a pause of two seconds in double support."""
    table = table_of(GaitParameters())
    fit = val.fit_log({name: np.delete(values, slice(3000, 3250)) for name, values in table.items()})
    assert len(fit.strides) == 11  # each is fitted with a margin, so that the gap touches two
    unseen = {**table, "com_y": np.where(np.abs(table["time"] - 8.0) < 0.2, np.nan, table["com_y"])}
    assert len(val.fit_log(unseen).strides) == 11
    at = int(np.argmin(np.abs(table["zmp_y"][2000:3000]))) + 2000
    held = {name: np.insert(values, at, np.full(500, values[at])) for name, values in table.items()}
    held["time"] = np.arange(len(held["time"])) / 500.0
    fit = val.fit_log(held)
    assert "others left out" in fit.notes[0]
    assert len(fit.strides) < 13


def test_single_rows_without_force_are_bridged_and_20_hz_is_enough():
    gait = GaitParameters(c_s=1.2, c_y=0.4)
    table = table_of(gait, rate=100.0)
    table["force_z"][::7] = np.nan
    fit = val.fit_log(table, mass=MASS)
    assert len(fit.strides) == 13
    assert max(distances(fit, gait).values()) < 1.0
    assert len(val.fit_log(table_of(gait, rate=20.0)).strides) == 13


def test_a_fall_is_flagged_and_the_strides_before_it_are_fitted():
    """From 8 s on the floor carries nothing, and the COM drops."""
    table = table_of(GaitParameters())
    falls = np.clip(4.0 * (table["time"] - 8.0), 0.0, 1.0)
    for axis in "xyz":
        table[f"force_{axis}"] *= 1.0 - falls
    table["com_z"] *= 1.0 - 0.7 * falls
    fit = val.fit_log(table, mass=MASS)
    assert len(fit.strides) == 5
    assert max(distances(fit, GaitParameters()).values()) < 1.5
    (flag,) = (note for note in fit.notes if "the body falls" in note)
    assert 7.5 < float(flag.split()[1]) < 8.0
    assert not any("the body falls" in note for note in val.fit_log(table_of(GaitParameters())).notes)


def test_without_a_periodic_gait_there_is_no_file(tmp_path):
    """A pendulum with rounding of its constants may stop over the foot; the folder says why."""
    gait = GaitParameters(switching_velocity=0.8)
    fit = val.fit_log(table_of(gait))
    assert fit.gait is not None
    fit.save(tmp_path / "fit")
    plates = {name: values for name, values in table_of(gait).items() if not name.startswith("com")}
    slow = val.fit_log({**plates, "time": 2.0 * plates["time"]}, com_height=gait.com_height)
    slow.save(tmp_path / "fit", force=True)
    assert slow.gait is None
    assert not (tmp_path / "fit" / "gait.toml").exists()
    assert "There is no periodic gait with these constants" in slow.notes[-1]

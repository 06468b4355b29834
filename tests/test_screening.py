"""Screening and dry run: the planner's answer to every case, reason for reason, without planning it."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ampm.planner.periodic
from ampm.exceptions import InputError, MathematicalRefusal
from ampm.parameters import keys, load_run
from ampm.planner.periodic import plan_gait
from validation.store.json import json_ready
from validation.study.sweep import closed_form, dry_run_text
from validation.study.sweep.blocks import Block
from validation.study.sweep.closed_form import ACCEPTED, BAD_PARAMETER, REASONS
from validation.study.sweep.definition import SweepDefinition, parse_sweep
from validation.study.sweep.dry_run import plan_dry_run
from validation.study.sweep.dry_run_text import print_dry_run
from validation.study.sweep.keys import key_info
from validation.study.sweep.sampling import cases
from validation.study.sweep.screening import screen
from validation.trial import simulate
from validation.trial.plan import load_request, make_body, plan_walk

LONG = {"a_s": math.inf, "c_s": 0.005, "switching_velocity": 0.0577}
"""A single support of many time constants of the lateral pendulum, if c_y is large."""


def rows(columns, steps=3, **fixed):
    """A sweep of given rows, which the reader would have refused where they are equal."""
    block = Block("list", {key: tuple(values) for key, values in columns.items()})
    return SweepDefinition(steps=steps, set=fixed, vary=(block,), base=load_run("normal"))


def planners_answer(drawn, case):
    """Reason and step duration, from the planner itself."""
    try:
        run = drawn.run(case)
        constants = plan_gait(run.gait, run.body.mass).constants
    except InputError:
        return BAD_PARAMETER, math.nan
    except MathematicalRefusal as refusal:
        return refusal.reason, math.nan
    return None, constants.step_duration


def check(definition):
    """Hold the screening against the planner, case by case."""
    drawn, screening = cases(definition), screen(definition)
    for case in range(len(drawn)):
        reason, duration = planners_answer(drawn, case)
        assert screening.reason(case) == reason, drawn.row(case)
        assert screening.step_duration[case] == pytest.approx(duration, rel=1e-12, nan_ok=True)
    return screening


# --- the same as the planner ---


def test_one_case_of_every_reason():
    usual = load_run("normal").gait
    changes: dict[str | None, dict[str, Any]] = {
        None: {},
        "bad_parameter": {"c_s": 101.0},
        "not_the_plain_pendulum": {"model": "ipm"},
        "single_support_not_driven": {"c_s": 0.2},
        "c_y_not_positive": {"c_y": 0.0},
        "switching_velocity_too_low": {"switching_velocity": 0.3},
        "mid_stance_too_slow": {"switching_velocity": 0.635},
        "single_support_too_long": {**LONG, "c_y": 100.0},
        "ill_conditioned": {"com_height": 1e-9, "step_length": 1e-3, "switching_velocity": 99.0},
    }
    names = sorted({name for change in changes.values() for name in change})
    columns = {
        f"gait.{name}": [change.get(name, getattr(usual, name)) for change in changes.values()]
        for name in names
    }
    screening = check(rows(columns, steps=6))
    assert [screening.reason(case) for case in range(len(screening))] == list(changes)
    assert set(changes) == {None, *REASONS} - {ACCEPTED}


@pytest.mark.parametrize("gait", ["normal", "momentum", "flat", "ipm"])
def test_presets_are_accepted(gait):
    definition = parse_sweep(f'[sweep]\ngait = "{gait}"\n[[vary]]\nmethod = "grid"\nbody.mass = [50, 60.0]')
    screening = check(definition)
    assert screening.counts() == {ACCEPTED: 2}
    assert screening.planned == 0


def around(low, high):
    """Numbers of any size between two positive ones, and their ends."""
    exponent = st.floats(min_value=math.log(low), max_value=math.log(high))
    return st.one_of(exponent.map(lambda e: min(max(math.exp(e), low), high)), st.sampled_from([low, high]))


GAITS = {
    "gait.model": st.sampled_from(["ampm", "ampm", "ampm", "ipm"]),
    "gait.com_height": around(0.3, 1.3),
    "gait.step_length": around(0.02, 1.5),
    "gait.switching_velocity": around(0.05, 3.0),
    "gait.single_support_ratio": st.floats(min_value=0.02, max_value=0.98),
    "gait.a_s": st.one_of(st.just(math.inf), around(0.3, 300.0)),
    "gait.c_s": st.one_of(st.just(1.0), st.floats(min_value=-0.5, max_value=3.0)),
    "gait.c_y": st.one_of(st.just(1.0), st.floats(min_value=-0.2, max_value=3.0)),
    "gait.step_width": around(0.01, 0.6),
    "body.mass": around(1.0, 1000.0),
}
EXTREME = {
    **GAITS,
    "gait.com_height": around(1e-200, 200.0),
    "gait.step_length": around(1e-200, 200.0),
    "gait.switching_velocity": around(5e-324, 200.0),
    "gait.single_support_ratio": st.one_of(around(1e-300, 2.0), around(1e-17, 0.5).map(lambda x: 1.0 - x)),
    "gait.a_s": st.one_of(st.just(math.inf), around(5e-324, 1e308)),
    "gait.c_s": st.one_of(st.just(1.0), around(5e-324, 200.0), st.floats(-1e308, 0.0)),
    "gait.c_y": st.one_of(st.just(1.0), around(5e-324, 200.0), st.floats(-1e308, 0.0)),
    "gait.step_width": around(1e-200, 200.0),
    "body.mass": around(5e-324, 2000.0),
}


def tables(values):
    """Several gaits as columns."""
    gait = st.tuples(*values.values())
    return st.lists(gait, min_size=1, max_size=12).map(
        lambda found: dict(zip(values, zip(*found, strict=True), strict=True))
    )


@given(columns=tables(GAITS), steps=st.integers(min_value=1, max_value=6))
@settings(max_examples=150, deadline=None)
def test_any_gait(columns, steps):
    check(rows(columns, steps))


@given(columns=tables(EXTREME), steps=st.integers(min_value=1, max_value=3))
@settings(max_examples=150, deadline=None)
def test_any_numbers_that_there_are(columns, steps):
    check(rows(columns, steps))


@pytest.mark.parametrize("seed", range(4))
def test_many_gaits_at_random(seed):
    generator = np.random.default_rng(seed)
    n = 400
    columns = {
        "gait.com_height": generator.uniform(0.4, 1.2, n),
        "gait.step_length": generator.uniform(0.05, 1.2, n),
        "gait.switching_velocity": generator.uniform(0.05, 2.0, n),
        "gait.single_support_ratio": generator.uniform(0.05, 0.99, n),
        "gait.a_s": np.exp(generator.uniform(math.log(0.5), math.log(100.0), n)),
        "gait.c_s": generator.uniform(-0.2, 2.5, n),
        "gait.c_y": generator.uniform(-0.1, 2.0, n),
        "gait.step_width": generator.uniform(0.01, 0.5, n),
    }
    screening = check(rows({key: values.tolist() for key, values in columns.items()}))
    assert screening.planned == 0  # nothing of an ordinary sweep is left to the planner
    assert len(screening.counts()) >= 4


def test_the_thresholds_to_the_last_bit():
    least = 0.5 * 0.6 * 0.79 / math.sqrt(0.865 / ((1.0 - 1.0 / 2.63) * 9.81))
    enough = least / math.sqrt(1.0 - 0.2**2)
    speeds = [s + k * math.ulp(s) for s in (least, enough) for k in range(-3, 4)]
    slopes = [1.0 / 2.63 + k * math.ulp(1.0 / 2.63) for k in range(-2, 3)]
    check(rows({"gait.switching_velocity": speeds}))
    check(rows({"gait.c_s": slopes}))
    check(rows({"gait.c_y": [-5e-324, -0.0, 0.0, 5e-324]}))


def test_what_rounding_could_decide_is_left_to_the_planner():
    heights = [10.0**-k for k in range(3, 12)]
    n = len(heights)
    columns = {
        "gait.com_height": heights,
        "gait.step_length": [1e-3] * n,
        "gait.switching_velocity": [99.0] * n,
    }
    screening = check(rows(columns, steps=6))
    assert 0 < screening.planned < n
    assert len(screening.counts()) >= 2


def test_the_largest_angle_to_the_last_bits():
    single = plan_gait(load_run("normal", [f"gait.{k}={v}" for k, v in LONG.items()]).gait, 60.0)
    duration = single.constants.single_support_duration
    edge = (2.0 * closed_form.LARGEST_ANGLE / duration) ** 2 * single.com_height / 9.81
    slopes = [edge * (1.0 + share) for share in (-1e-3, -1e-12, 0.0, 1e-12, 1e-3)]
    slopes += [edge + k * math.ulp(edge) for k in (-8, -4, -2, -1, 1, 2, 4, 8)]
    columns = {f"gait.{name}": [value] * len(slopes) for name, value in LONG.items()}
    screening = check(rows({**columns, "gait.c_y": slopes}))
    assert screening.counts().keys() == {ACCEPTED, "single_support_too_long"}
    assert screening.planned == len(slopes) - 2
    too_long = ~screening.accepted
    np.testing.assert_allclose(screening.needed[too_long], edge, rtol=1e-9)


@pytest.mark.parametrize("key", [k for k in keys() if key_info(k).kind != "text" and k != "gait.steps"])
def test_bounds_of_every_key(key):
    info = key_info(key)
    if info.kind == "int":
        low, high = (int(end) for end in info.ends)
        values: list[float] = [low - 1, low, high, high + 1]
    else:
        values = [1.7e308, -1.7e308, 0.0, -0.0, 5e-324]
        if not info.finite or not math.isinf(info.ends[1]):
            values.append(math.inf)
        values.append(-math.inf)
        for end in info.ends:
            if math.isfinite(end):
                values += [end, math.nextafter(end, -math.inf), math.nextafter(end, math.inf)]
    drawn = cases(rows({key: values}))
    screening = screen(drawn.definition)
    for case in range(len(drawn)):
        told = None
        try:
            drawn.run(case)
        except InputError as error:
            told = error.details["key"]
        assert (screening.reason(case) == BAD_PARAMETER) == (told is not None), values[case]
        assert told in (None, keys()[screening.key[case]])


def test_the_first_of_several_bad_parameters_is_told():
    definition = rows({"solver.tolerance": [1.0, 1.0], "gait.c_s": [1.0, 200.0]})
    screening = check(definition)
    assert [keys()[k] for k in screening.key] == ["solver.tolerance", "gait.c_s"]


def test_constants_are_the_planners():
    assert closed_form.LARGEST_ANGLE == ampm.planner.periodic._LARGEST_ANGLE
    names = set(REASONS) - {ACCEPTED, BAD_PARAMETER}
    source = Path(ampm.planner.periodic.__file__).read_text(encoding="utf-8")
    told = {part.split('"')[0] for part in source.split('reason="')[1:]}
    assert names == told


# --- what would pass ---


def test_the_value_that_is_needed_passes():
    generator = np.random.default_rng(3)
    n = 300
    definition = rows(
        {
            "gait.switching_velocity": generator.uniform(0.1, 1.0, n).tolist(),
            "gait.step_length": generator.uniform(0.3, 1.0, n).tolist(),
            "gait.c_s": generator.uniform(0.0, 1.5, n).tolist(),
            "gait.c_y": generator.uniform(-0.5, 1.5, n).tolist(),
        }
    )
    drawn, screening = cases(definition), screen(definition)
    seen = set()
    for case in np.flatnonzero(~screening.accepted).tolist():
        reason, key = screening.reason(case), keys()[screening.key[case]]
        run = drawn.run(case)
        needed = float(screening.needed[case])
        assert getattr(run.gait, key.partition(".")[2]) == screening.asked[case]
        mended = run.replace({key: needed + 1e-9 * max(1.0, abs(needed))})
        other = None
        try:
            plan_gait(mended.gait, 60.0)
        except MathematicalRefusal as refusal:
            other = refusal.reason
        assert other != reason
        seen.add(reason)
    assert len(seen) >= 3


def test_refusals_in_words():
    definition = rows(
        {
            "gait.switching_velocity": [0.3, 0.4, 1.0, 1.0, 1.0],
            "contact.friction": [0.8, 0.8, 0.0, 11.0, 12.0],
        }
    )
    screening = screen(definition)
    told = {(r.reason, r.rule): r for r in screening.refusals()}
    slow = told["switching_velocity_too_low", "at least"]
    assert (slow.count, slow.key, slow.unit, slow.asked) == (2, "gait.switching_velocity", "m/s", (0.3, 0.4))
    assert slow.way_out() == "gait.switching_velocity at least 0.6413 m/s"
    low, high = told[BAD_PARAMETER, "greater than"], told[BAD_PARAMETER, "at most"]
    assert (low.count, low.way_out()) == (1, "contact.friction greater than 0")
    assert (high.count, high.asked, high.way_out()) == (2, (11.0, 12.0), "contact.friction at most 10")
    assert screening.counts() == {BAD_PARAMETER: 3, "switching_velocity_too_low": 2}


def test_a_million_gaits():
    definition = parse_sweep(
        '[[vary]]\nmethod = "grid"\n'
        "gait.c_s = { from = -0.5, to = 2, count = 100 }\n"
        "gait.c_y = { from = -0.1, to = 1.4, count = 100 }\n"
        "gait.switching_velocity = { from = 0.2, to = 1.4, count = 100 }"
    )
    drawn, screening = cases(definition), screen(definition)
    assert len(screening) == 1_000_000
    assert sum(screening.counts().values()) == 1_000_000
    for case in np.random.default_rng(1).integers(0, 1_000_000, 100):
        assert screening.reason(int(case)) == planners_answer(drawn, int(case))[0]


# --- dry run ---


def test_dry_run_counts_and_says_so(capsys):
    definition = parse_sweep(
        '[sweep]\nname = "a [b] c"\nsteps = 4\n[[vary]]\nmethod = "grid"\n'
        "gait.switching_velocity = [0.5, 1.0]\ncontact.friction = [-1, 0.6, 0.8]\n"
        "simulation.time_step = [0.002, 0.0015]"
    )
    dry = plan_dry_run(definition, 2)
    assert (dry.runs, dry.refused, dry.accepted, dry.walking) == (12, 10, 2, 2)
    assert [r.count for r in dry.refusals] == [4, 4, 2]
    told = json.loads(json.dumps(json_ready(dry.as_dict()), allow_nan=False))
    assert told["runs"] == 12
    assert told["refused_by_reason"] == {"bad_parameter": 6, "switching_velocity_too_low": 4}
    assert told["refusals"][0]["way_out"] == "contact.friction greater than 0"
    assert told["time"]["workers"] == 2
    assert told["body"]["complete"] is True
    assert told["body"]["motions"] == 1
    print_dry_run(dry)
    printed = capsys.readouterr().out
    for words in ("a [b] c", "switching_velocity_too_low", "at least 0.6413 m/s", "time", "not seen"):
        assert words in printed


def test_dry_run_of_nothing_that_walks(capsys):
    dry = plan_dry_run(parse_sweep('[[vary]]\nmethod = "grid"\ngait.c_y = [-1.0, -2.0]'), 1)
    assert (dry.accepted, dry.walking, dry.processor) == (0, 0, 0.0)
    print_dry_run(dry)
    assert "c_y_not_positive" in capsys.readouterr().out


def test_dry_run_needs_a_worker():
    with pytest.raises(InputError, match="workers"):
        plan_dry_run(parse_sweep('[[vary]]\nmethod = "grid"\ngait.c_y = [1.0]'), 0)


def test_the_body_is_asked_as_planning_asks_it():
    definition = parse_sweep(
        '[sweep]\nsteps = 3\n[[vary]]\nmethod = "list"\n'
        "gait.step_width = [0.18, 0.05, 0.18, 0.18]\ngait.a_s = [2.63, 2.63, 1.5, 2.63]\n"
        "foot.heel_rise_lead = [0, 0, 0, 0.9]\n"
    )
    drawn, dry = cases(definition), plan_dry_run(definition, 1)
    expected: dict[str, int] = {}
    for case in range(1, 4):
        with pytest.raises((InputError, ampm.exceptions.RefusedGait)) as caught:
            plan_walk(load_request("normal", drawn.settings(case)))
        reason = getattr(caught.value, "reason", BAD_PARAMETER)
        expected[reason] = expected.get(reason, 0) + 1
    assert dry.probe.refused == expected
    assert dry.walking == 1
    assert {"soles_overlap", "zmp_leaves_sole", BAD_PARAMETER} == set(expected)


def test_only_some_motions_are_looked_at():
    definition = parse_sweep(
        '[sweep]\ngait = "flat"\n[[vary]]\nmethod = "grid"\n'
        "gait.c_y = { from = 0.5, to = 1, count = 20 }\ncontact.friction = [0.7, 0.8]"
    )
    dry = plan_dry_run(definition, 1, probed=5)
    assert (dry.probe.motions, dry.probe.probed, dry.probe.runs, dry.probe.complete) == (20, 5, 10, False)
    assert dry.walking == 40
    again = plan_dry_run(definition, 1, probed=5)
    assert again.as_dict() == dry.as_dict()


@pytest.mark.parametrize(
    ("frequency", "time_step"),
    [
        (500, 0.002),
        (500, 0.001),
        (500, 0.0015),
        (1000, 0.002),
        (250, 0.002),
        (300, 0.002),
        (1e4, 1e-4),
        (3, 0.05),
    ],
)
def test_the_clock_is_the_simulations(frequency, time_step):
    run = load_run("flat", [f"controller.frequency={frequency}", f"simulation.time_step={time_step}"])
    try:
        simulate.Physics(make_body(run).model, run)
        fits = True
    except InputError:
        fits = False
    dry = plan_dry_run(
        parse_sweep(
            '[sweep]\ngait = "flat"\nsteps = 2\n[[vary]]\nmethod = "list"\n'
            f"controller.frequency = [{frequency}]\nsimulation.time_step = [{time_step}]"
        ),
        1,
    )
    assert (dry.refused == 0) == fits


def test_time_grows_with_work_and_shrinks_with_workers():
    def estimate(text, workers=1):
        return plan_dry_run(
            parse_sweep(
                f'[sweep]\ngait = "flat"\n{text}\n[[vary]]\nmethod = "grid"\nbody.mass = [50, 60, 70, 80]'
            ),
            workers,
        )

    base = estimate("steps = 10")
    assert estimate("steps = 20").simulated == pytest.approx(2.0 * base.simulated)
    assert estimate("steps = 20").processor > base.processor
    assert estimate("steps = 10\n[set]\nsimulation.time_step = 0.0005").processor > base.processor
    assert estimate("steps = 10", 2).wall_clock < base.wall_clock
    assert estimate("steps = 10", 400).wall_clock == estimate("steps = 10", 4).wall_clock
    assert base.simulated == pytest.approx(
        4 * plan_gait(load_run("flat", ["gait.steps=10"]).gait, 60.0).duration
    )


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.0, "0 s"),
        (89, "89 s"),
        (90, "2 min"),
        (3599, "60 min"),
        (5400, "1 h 30 min"),
        (7200, "2 h"),
        (1e6, "11.6 days"),
        (math.inf, "for ever"),
    ],
)
def test_durations_in_words(seconds, text):
    assert dry_run_text.duration_text(seconds) == text

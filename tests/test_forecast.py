"""Forecast: the planner's answer to every run, on arrays; soles and legs of a sample; one timed walk."""

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ampm.exceptions import BodilyRefusal, InputError, MathematicalRefusal
from ampm.parameters import keys
from ampm.planner.periodic import plan_gait
from ampm.run_file import key_info, load_run
from validation.cli.app import call
from validation.store.json import json_ready
from validation.study.sweep import forecast as forecasting
from validation.study.sweep.design import Block, SweepDefinition, parse_sweep
from validation.study.sweep.forecast import ACCEPTED, BAD, REASONS, forecast, screen
from validation.study.sweep.task import Task

GRID = '[[vary]]\nmethod = "grid"\n'


def rows(columns, steps=3):
    """A sweep of given rows."""
    block = Block(method="list", keys={key: tuple(v) for key, v in columns.items()})
    return SweepDefinition(steps=steps, vary=(block,), base=load_run("normal"))


def planners_answer(drawn, case):
    """Reason, from the planner itself."""
    try:
        run = drawn.parameters(case)
        plan_gait(run.gait, run.body.mass)
    except InputError:
        return REASONS[BAD]
    except MathematicalRefusal as refusal:
        return refusal.reason
    return REASONS[ACCEPTED]


def check(definition):
    """Hold the screening against the planner, case by case; the reasons."""
    found = [REASONS[code] for code in screen(definition)]
    for case, reason in enumerate(found):
        assert reason == planners_answer(definition, case), definition.varied(case)
    return found


# --- the same as the planner ---


@pytest.mark.parametrize("gait", ["normal", "momentum", "flat", "ipm"])
def test_presets_are_accepted(gait):
    assert set(check(parse_sweep(f'[sweep]\ngait = "{gait}"\n{GRID}body.mass = [50, 60.0]'))) == {"accepted"}


def around(low, high):
    """Numbers of any size between two positive ones, and their ends."""
    exponent = st.floats(min_value=math.log(low), max_value=math.log(high))
    return st.one_of(exponent.map(lambda e: min(max(math.exp(e), low), high)), st.sampled_from([low, high]))


GAITS = {
    "gait.model": st.sampled_from(["ampm", "ampm", "ampm", "ipm"]),
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


@given(
    gaits=st.lists(st.tuples(*GAITS.values()), min_size=1, max_size=12, unique=True), steps=st.integers(1, 6)
)
@settings(max_examples=200, deadline=None)
def test_any_numbers_that_there_are(gaits, steps):
    check(rows(dict(zip(GAITS, zip(*gaits, strict=True), strict=True)), steps))


@pytest.mark.parametrize("key", [k for k in keys() if key_info(k).kind != "text" and k != "gait.steps"])
def test_bounds_of_every_key(key):
    info = key_info(key)
    numbers: list[float] = [b + k for b in info.bounds.values() for k in (-1, 0, 1)]
    if info.kind != "int":
        numbers += [1.7e308, -1.7e308, 0.0, -0.0, 5e-324, math.inf, -math.inf]
        numbers += [math.nextafter(b, k) for b in info.bounds.values() for k in (-math.inf, math.inf)]
    drawn = rows({key: dict.fromkeys(numbers)})
    for case, code in enumerate(screen(drawn)):
        found = None
        try:
            drawn.parameters(case)
        except InputError as error:
            found = error.details["key"]
        assert (found is not None) == (code == BAD), drawn.varied(case)


@pytest.mark.parametrize(
    "count", [30, pytest.param(100, marks=pytest.mark.slow)], ids=["27 thousand", "a million"]
)
def test_many_gaits_are_screened_without_planning_any(count, monkeypatch):
    definition = parse_sweep(
        f"{GRID}gait.c_s = {{ from = -0.5, to = 2, count = {count} }}\n"
        f"gait.c_y = {{ from = -0.1, to = 1.4, count = {count} }}\n"
        f"gait.switching_velocity = {{ from = 0.2, to = 1.4, count = {count} }}"
    )
    with monkeypatch.context() as patch:
        patch.delattr(SweepDefinition, "parameters")
        code = screen(definition)
    assert len(code) == count**3
    for case in np.random.default_rng(1).integers(0, len(code), 100).tolist():
        assert REASONS[code[case]] == planners_answer(definition, case)


# --- forecast ---


@pytest.fixture
def walks(monkeypatch):
    """Walks that are not walked: every walk is recorded, and those with low slopes are refused."""
    walked = []

    def plan(task):
        walked.append(task.parameters)
        if task.parameters.gait.c_y < 0.6:
            raise BodilyRefusal("hip", reason="knee", value=0.0, limit=0.1, unit="rad", way_out="bend [less]")

    monkeypatch.setattr(Task, "plan", plan)
    monkeypatch.setattr(Task, "walk", lambda *_: None)
    monkeypatch.setattr(forecasting, "keep_run", lambda *_: "")
    return walked


def test_a_forecast_counts_and_says_so(walks, tmp_path, capsys):
    text = (
        '[sweep]\nname = "a [b] c"\nsteps = 40\n' + GRID + "gait.switching_velocity = [0.5, 1.0]\n"
        "contact.friction = [-1, 0.6, 0.8]\nsimulation.time_step = [0.002, 0.0015]"
    )
    found = forecast(parse_sweep(text), 2)
    assert [(item.reason, item.runs) for item in found.refused] == [
        ("switching_velocity_too_low", 4),
        ("bad_parameter", 4),
    ]
    assert [(item.reason, item.runs) for item in found.body_refused] == [("bad_parameter", 2)]  # the clock
    assert "contact.friction" in found.refused[1].example
    assert "gait.switching_velocity" in found.refused[0].example
    assert "controller.frequency" in found.body_refused[0].example
    assert (found.runs, found.gaits, found.checked, found.walking, found.exact) == (12, 2, 2, 2, True)
    assert [run.gait.steps for run in walks] == [forecasting.TIMED_STEPS]
    assert found.wall_clock == found.seconds
    assert found.kept == 2  # of 10 that might, as no more walk
    told = json.loads(json.dumps(json_ready(found.as_dict()), allow_nan=False))
    assert (told["runs"], told["walking"]) == (12, 2)
    path = tmp_path / "sweep.toml"
    path.write_text(text, encoding="utf-8")
    assert call(["sweep", str(path), "--dry-run"]) == 0
    assert "a [b] c" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("text", "status"),
    [
        ("gait.switching_velocity = [0.1, 0.2]", 2),  # the formula refuses all
        ("gait.com_height = [1.2]", 2),  # the legs do
        ("gait.c_y = [0.5, 0.7]", 0),
        ("gait.c_y = [0.5, 0.55]", 0),  # only the motion refuses, which a dry run does not solve for all
    ],
)
def test_a_dry_run_ends_as_the_sweep_would(walks, tmp_path, capsys, text, status):
    path = tmp_path / "sweep.toml"
    path.write_text(f'[sweep]\ngait = "flat"\n{GRID}{text}\n', encoding="utf-8")
    assert call(["sweep", str(path), "--dry-run"]) == status
    assert ("every run" in capsys.readouterr().out) == (status == 2)
    assert call(["sweep", str(path), "--dry-run", "--workers", "0"]) == 2


def test_the_body_is_asked_as_planning_asks_it(walks):
    definition = parse_sweep(
        '[sweep]\nsteps = 3\n[[vary]]\nmethod = "list"\n'
        "gait.step_width = [0.18, 0.05, 0.18, 0.18]\ngait.a_s = [2.63, 2.63, 1.5, 2.63]\n"
        "foot.heel_rise_lead = [0, 0, 0, 0.9]\n"
    )
    expected = {"soles_overlap", "zmp_leaves_sole", "bad_parameter"}
    found = forecast(definition, 1)
    assert {item.reason for item in found.body_refused} == expected
    assert found.walking == 1


def test_of_many_gaits_a_sample_is_checked(walks, monkeypatch):
    monkeypatch.setattr(forecasting, "CHECKED", 5)
    text = '[sweep]\ngait = "flat"\n' + GRID + "gait.c_y = { from = 0.7, to = 1, count = 20 }\n"
    found = forecast(parse_sweep(text + "contact.friction = [0.7, 0.8]"), 4)
    assert (found.gaits, found.checked, found.exact, found.walking) == (20, 5, False, 40)
    refused = forecast(parse_sweep('[sweep]\ngait = "flat"\n' + GRID + "gait.c_y = [0.5, 0.55]"), 1)
    assert refused.seconds is None
    assert [text.count("bend [less]") for text in refused.motion_refused] == [1, 1]
    assert found.seconds is not None
    assert found.wall_clock == pytest.approx(10 * found.seconds)


def test_a_sweep_that_tunes_is_not_judged_by_its_defaults(walks):
    text = "gait.switching_velocity = [0.3, 1.0]\ngait.c_s = [1.0, 200.0]"
    found = forecast(parse_sweep(f"[sweep]\ntune = true\n{GRID}{text}"), 1)
    assert [(item.reason, item.runs) for item in found.refused] == [("bad_parameter", 2)]
    assert (found.walking, len(walks)) == (2, 1)


def test_one_walk_is_timed():
    found = forecast(parse_sweep(f'[sweep]\ngait = "flat"\nsteps = 2\n{GRID}contact.friction = [0.8]'), 1)
    assert found.seconds is not None
    assert 0.0 < found.seconds < 60.0
    assert found.recording is not None
    assert found.recording > 0.1
    assert found.keeping == pytest.approx(found.seconds + found.recording)  # its only run, once more

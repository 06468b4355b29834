"""Parameters: bounds, messages, presets, and a file that gives back the same bits."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ampm.exceptions import InputError
from ampm.parameters import ContactParameters, GaitParameters, RunParameters, keys
from ampm.run_file import dump_run, load_run, preset_names


def read_back(run, path):
    path.write_text(dump_run(run), encoding="utf-8")
    return load_run(path)


@pytest.mark.parametrize("name", preset_names())
def test_every_preset_loads_and_round_trips(name, tmp_path):
    run = load_run(name)
    assert read_back(run, tmp_path / "run.toml") == run


def test_presets_are_what_they_are_called():
    assert preset_names()[:3] == ("normal", "momentum", "flat")
    normal, momentum, flat = (load_run(name) for name in preset_names()[:3])
    assert (normal.gait.step_length, normal.gait.switching_velocity) == (0.6, 1.0)
    assert (normal.gait.c_s, normal.gait.c_y) == (1.0, 1.0)
    assert momentum.gait == normal.replace({"gait.c_s": 1.2, "gait.c_y": 0.4}).gait
    assert flat.foot.schedule == "flat"


def test_the_demos_of_one_figure_differ_in_one_parameter():
    normal = load_run("normal")
    for c_y in (0.1, 0.4, 0.7, 1.0):
        assert load_run(f"roll-{c_y}") == normal.replace({"gait.c_y": c_y})
    pitch, low = load_run("pitch").gait, load_run("pitch-low").gait
    assert pitch.c_s >= 1.5
    assert low.c_s <= 0.5
    assert min(pitch.step_length, low.step_length) > normal.gait.step_length
    assert pitch.c_y == low.c_y == 1.0
    ipm = load_run("ipm")
    assert ipm.gait == normal.replace({"gait.model": "ipm", "gait.a_s": math.inf}).gait
    for section in ("body", "foot", "contact", "simulation", "solver"):
        assert getattr(ipm, section) == getattr(normal, section)
    changed = {k for k, v in ipm.controller if v != getattr(normal.controller, k)}
    assert all(key.startswith(("contact_", "landing_", "touchdown_", "roll_down_")) for key in changed)


positive = st.floats(min_value=1e-6, max_value=100.0, exclude_min=True)


@given(
    com_height=positive,
    c_s=st.floats(min_value=-100, max_value=100),
    a_s=st.one_of(st.just(math.inf), st.floats(min_value=0, exclude_min=True, allow_infinity=False)),
    friction=st.floats(min_value=0.1, max_value=10),
    steps=st.integers(min_value=1, max_value=1000),
)
@settings(max_examples=50)
def test_a_file_gives_back_the_same_bits(tmp_path_factory, com_height, c_s, a_s, friction, steps):
    run = RunParameters(
        gait=GaitParameters(com_height=com_height, c_s=c_s, a_s=a_s, steps=steps),
        contact=ContactParameters(friction=friction),
    )
    again = read_back(run, tmp_path_factory.mktemp("run") / "run.toml")
    assert again == run
    assert again.gait.c_s.hex() == run.gait.c_s.hex()


def test_an_infinite_a_s_round_trips(tmp_path):
    run = load_run("normal", ["gait.a_s=inf"])
    assert read_back(run, tmp_path / "run.toml").gait.a_s == math.inf


def test_overrides_come_last_and_take_toml_or_plain_values():
    run = load_run(
        "momentum", ["gait.c_s=1.4", "foot.schedule=flat", "gait.steps=7", 'solver.qp="daqp"', "gait.c_y=.5"]
    )
    assert (run.gait.c_s, run.gait.steps, run.gait.c_y) == (1.4, 7, 0.5)
    assert (run.foot.schedule, run.solver.qp) == ("flat", "daqp")


def test_a_partial_file_leaves_the_rest_at_its_default(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text("[gait]\nstep_length = 0.5\n", encoding="utf-8")
    assert load_run(path) == RunParameters(gait=GaitParameters(step_length=0.5))
    assert load_run(str(path), ["body.mass=70"]).body.mass == 70.0


def test_every_key_has_a_meaning_and_a_unit():
    for key in keys():
        section, name = key.split(".")
        field = getattr(RunParameters(), section).__class__.model_fields[name]
        assert field.description, key
        assert field.json_schema_extra["unit"], key


def test_parameters_are_frozen():
    run = RunParameters()
    with pytest.raises(Exception, match="frozen"):
        run.gait.step_length = 1.0  # type: ignore[misc]


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("gait.stp_length=1", ["gait.stp_length", "did you mean 'gait.step_length'"]),
        ("step_length=1", ["'step_length'", "did you mean 'gait.step_length'"]),
        ("gate.c_s=1", ["'gate.c_s'", "did you mean 'gait.c_s'"]),
        ("gait.step_length=-1", ["gait.step_length = -1 m", "greater than 0 m", "default is 0.6 m"]),
        ("gait.step_length=0", ["gait.step_length = 0 m", "greater than 0 m"]),
        ("gait.step_length=nan", ["gait.step_length = nan", "must be"]),
        ("gait.switching_velocity=inf", ["gait.switching_velocity = inf", "must be"]),
        ("gait.c_y=nan", ["gait.c_y = nan", "finite number"]),
        ("gait.c_y=inf", ["gait.c_y = inf", "must be"]),
        ("gait.a_s=nan", ["gait.a_s = nan", "must be"]),
        ("gait.a_s=-3", ["gait.a_s = -3", "greater than 0"]),
        ("gait.single_support_ratio=1", ["gait.single_support_ratio = 1", "less than 1"]),
        ("gait.steps=0", ["gait.steps = 0", "at least 1"]),
        ("gait.steps=2.5", ["gait.steps = 2.5", "whole number"]),
        ("gait.com_height=tall", ["gait.com_height = 'tall'", "must be a number"]),
        ("gait.com_height=true", ["gait.com_height = True", "must be a number"]),
        ("foot.schedule=rol", ["foot.schedule = 'rol'", "'flat' or 'roll'"]),
        ("body.mass=-60", ["body.mass = -60 kg", "at least 1 kg"]),
        ("gait", ["'gait'", "key=value"]),
        ("gait=3", ["unknown key 'gait'"]),
        ("=3", ["without a key before ="]),
        ("gait.C_S=1", ["did you mean 'gait.c_s'"]),
        ("GAIT.STEPS=1", ["did you mean 'gait.steps'"]),
    ],
)
def test_a_bad_override_names_key_value_limit_and_way_out(override, words):
    with pytest.raises(InputError) as caught:
        load_run("normal", [override])
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[gait]\nc_s = \n", ["no valid TOML", "line 2"]),
        ("[gait]\ncs = 1\n", ["'gait.cs'", "did you mean 'gait.c_s'"]),
        ("[gaits]\nc_s = 1\n", ["'gaits'", "did you mean"]),
        ("[gate]\nc_s = 1\n", ["section 'gate'", "did you mean 'gait'"]),
        ("gait = 3\n", ["gait = 3", "[gait]"]),
    ],
)
def test_a_bad_file_says_where(text, words, tmp_path):
    path = tmp_path / "bad.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_run(path)
    for word in words:
        assert word in str(caught.value)


def test_an_error_tells_a_program_what_it_knows():
    with pytest.raises(InputError) as caught:
        load_run("normal", ["gait.step_length=-1"])
    assert caught.value.details["key"] == "gait.step_length"
    assert caught.value.details["value"] == -1
    assert caught.value.details["limit"] == "must be greater than 0 m"
    assert "0.6 m" in caught.value.details["way_out"]
    with pytest.raises(InputError) as caught:
        load_run("normal", ["gait.C_S=1"])
    assert caught.value.details["nearest"] == "gait.c_s"


def test_an_override_of_a_section_that_is_no_table(tmp_path):
    path = tmp_path / "bad.toml"
    path.write_text("gait = 3\n", encoding="utf-8")
    with pytest.raises(InputError, match="no section"):
        load_run(path, ["gait.c_s=1"])


def test_an_unknown_preset_names_the_nearest():
    with pytest.raises(InputError, match=r"did you mean 'normal'\?.*normal, momentum, flat, roll"):
        load_run("norml")


def test_a_file_that_cannot_be_read(tmp_path):
    with pytest.raises(InputError, match="neither a preset nor a file"):
        load_run(tmp_path / "none.toml")
    with pytest.raises(InputError, match="cannot be read"):
        load_run(tmp_path)


def test_constructing_a_section_raises_the_same_error():
    with pytest.raises(InputError, match=r"gait\.step_length = -1 m"):
        GaitParameters(step_length=-1.0)
    with pytest.raises(InputError, match=r"did you mean 'gait\.steps'"):
        GaitParameters(stepps=3)  # type: ignore[call-arg]
    with pytest.raises(InputError, match=r"did you mean 'gait\.c_y'"):
        RunParameters().replace({"gait.cy": 1.0})

"""Parameters: bounds, messages, presets, and a file that gives back the same bits."""

import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ampm.exceptions import InputError
from ampm.parameters import GaitParameters, RunParameters, keys
from ampm.physics_parameters import ContactParameters
from ampm.presets import preset_names
from ampm.run_file import describe_keys, dump_run, load_run


def read_back(run, path):
    path.write_text(dump_run(run), encoding="utf-8")
    return load_run(path)


def test_presets_are_what_they_are_called():
    assert preset_names()[:3] == ("normal", "momentum", "flat")
    normal, momentum, flat = (load_run(name) for name in preset_names()[:3])
    assert (normal.gait.step_length, normal.gait.switching_velocity) == (0.6, 1.0)
    assert (normal.gait.c_s, normal.gait.c_y) == (1.0, 1.0)
    assert momentum.gait == normal.replace({"gait.c_s": 1.2, "gait.c_y": 0.4}).gait
    assert flat.foot.schedule == "flat"


@given(
    com_height=st.floats(1e-6, 100.0, exclude_min=True),
    c_s=st.floats(-100, 100),
    a_s=st.one_of(st.just(math.inf), st.floats(0, exclude_min=True, allow_infinity=False)),
    friction=st.floats(0.1, 10),
    steps=st.integers(1, 1000),
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


def test_files_that_a_file_names_are_beside_it(tmp_path):
    (tmp_path / "mine.toml").write_text('body.source = "robot.toml"\ngait.planner = "plan.csv"', "utf-8")
    assert load_run(tmp_path / "mine.toml").body.source == "robot.toml"
    for name in ("robot.toml", "plan.csv"):
        (tmp_path / name).touch()
    run = load_run(tmp_path / "mine.toml")
    assert Path(run.body.source) == tmp_path / "robot.toml"
    assert Path(run.gait.planner) == tmp_path / "plan.csv"


def test_every_key_is_described():
    found = {info.key: info for info in describe_keys()}
    assert tuple(found) == keys()
    assert all(info.meaning and info.unit for info in found.values())
    step, schedule = found["gait.step_length"], found["foot.schedule"]
    assert (step.unit, step.default, step.kind, step.range) == ("m", 0.6, "float", "> 0, <= 100")
    assert (schedule.kind, schedule.range, found["gait.steps"].kind) == ("text", "flat | roll", "int")


def test_parameters_are_frozen():
    run = RunParameters()
    with pytest.raises(Exception, match="frozen"):
        run.gait.step_length = 1.0  # type: ignore[misc]


STEP = "gait.step_length"


@pytest.mark.parametrize(
    ("setting", "key", "details"),
    [
        ("gait.stp_length=1", "gait.stp_length", {"nearest": STEP}),
        ("step_length=1", "step_length", {"nearest": STEP}),
        ("gate.c_s=1", "gate.c_s", {"nearest": "gait.c_s"}),
        ("gait.C_S=1", "gait.C_S", {"nearest": "gait.c_s"}),
        ("GAIT.STEPS=1", "GAIT.STEPS", {"nearest": "gait.steps"}),
        ("gait.time_step=1", "gait.time_step", {"nearest": "simulation.time_step"}),
        ("gait.xyzzy=1", "gait.xyzzy", {"way_out": "'ampm keys' lists all."}),
        ("gait=3", "gait", {}),
        (f"{STEP}=-1", STEP, {"limit": "must be greater than 0 m", "way_out": "the default is 0.6 m"}),
        ("gait.step_length=0", STEP, {"value": 0, "limit": "must be greater than 0 m"}),
        ("gait.step_length=nan", STEP, {"limit": "must be a finite number"}),
        ("gait.switching_velocity=inf", "gait.switching_velocity", {"limit": "must be a finite number"}),
        ("gait.a_s=nan", "gait.a_s", {}),
        ("gait.a_s=-3", "gait.a_s", {"limit": "must be greater than 0"}),
        ("gait.single_support_ratio=1", "gait.single_support_ratio", {"limit": "must be less than 1"}),
        ("gait.steps=0", "gait.steps", {"limit": "must be at least 1"}),
        ("gait.steps=2.5", "gait.steps", {"value": 2.5, "limit": "must be a whole number"}),
        ("gait.steps=1" + 400 * "0", "gait.steps", {"limit": "must be at most 10000"}),
        ("gait.com_height=tall", "gait.com_height", {"value": "tall", "limit": "must be a number"}),
        ("gait.com_height=true", "gait.com_height", {"limit": "must be a number"}),
        ("gait.com_height=1" + 400 * "0", "gait.com_height", {"limit": "must be a number"}),
        ("foot.schedule=rol", "foot.schedule", {"limit": "must be 'flat' or 'roll'"}),
        ("body.mass=1e-12", "body.mass", {"limit": "must be at least 1 kg"}),
        ("contact.time_constant=0.0009", "contact.time_constant", {"value": 0.0009}),
        ("simulation.time_step=0.008", "contact.time_constant", {}),
        ("contact.impedance_min=0.96", "contact.impedance_min", {"way_out": "exchange them"}),
        ("gait", None, {"value": "gait", "way_out": "write for example gait.c_s=1.2"}),
        ("=3", None, {"value": "=3", "way_out": "write for example gait.c_s=1.2"}),
    ],
)
def test_a_bad_setting_is_known_to_programs(setting, key, details):
    with pytest.raises(InputError) as caught:
        load_run("normal", [setting])
    found = caught.value.details
    assert found.get("key") == key
    assert {name: found[name] for name in details} == details
    assert (key or found["value"]) in str(caught.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[gait]\nc_s = \n", "line 2"),
        ("[gait]\ncs = 1\n", "did you mean 'gait.c_s'"),
        ("[gate]\nc_s = 1\n", "unknown section 'gate'; did you mean 'gait'"),
        ("gait = 3\n", r"write \[gait\]"),
        ("a = " + 100_000 * "[", "nested too deeply"),
        ("[gait]\nsteps = " + 5000 * "9", "no valid TOML"),
        ("[gait]\nc_s = " + 300 * "[" + 300 * "]", "must be a number"),
    ],
)
def test_a_bad_file_says_where(text, words, tmp_path):
    path = tmp_path / "bad.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=words):
        load_run(path, ["gait.c_y=1"])


def test_a_file_that_is_none(tmp_path):
    for source, words in (
        ("norml", r"did you mean 'normal'\?"),
        (tmp_path / "none.toml", "unknown preset or file .*known are normal, momentum"),
        (tmp_path, "cannot be read"),
        ("zero\0byte", "cannot be read"),
    ):
        with pytest.raises(InputError, match=words):
            load_run(source)


def test_a_description_of_a_body_is_no_gait():
    biped = Path(__file__).parents[1] / "docs/examples/biped.toml"
    with pytest.raises(
        InputError, match=r"describes a body and is no gait; walk it with --body .*biped\.toml"
    ):
        load_run(biped)
    assert load_run(body={"source": str(biped)}).body.source == str(biped)  # the way out


def test_settings_are_texts_or_keywords():
    texts = load_run("momentum", ["gait.c_y=0.6", "foot.schedule=flat", "gait.steps=10"])
    assert texts == load_run("momentum", gait={"c_y": 0.6, "steps": 10.0}, foot={"schedule": "flat"})
    assert load_run("momentum", ["gait.c_y=1"], gait={"c_y": 0.6}).gait.c_y == 0.6
    bad: list[dict[str, Any]] = [{"gait": {"cy": 1.0}}, {"gate": {}}, {"gait": 3}]
    for wrong in bad:
        with pytest.raises(InputError):
            load_run("momentum", **wrong)
    with pytest.raises(InputError):
        GaitParameters(**bad[0]["gait"])
    with pytest.raises(InputError):
        texts.replace({"gait.cy": 1.0})


def test_a_whole_number_may_have_a_point_and_a_file_a_byte_order_mark(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_bytes(b"\xef\xbb\xbf[gait]\nsteps = 4.0\n")
    steps = load_run(path).gait.steps
    assert (steps, type(steps)) == (4, int)

"""Parameters: bounds, messages, presets, and a file that gives back the same bits."""

import math
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st

from ampm.parameters import KEYS, GaitParameters, RunParameters
from ampm.physics_parameters import ContactParameters
from ampm.run_file import dump_run, key_info, load_run


@given(
    com_height=st.floats(1e-6, 10.0, exclude_min=True),
    c_s=st.floats(-100, 100).filter(lambda value: value == 0.0 or abs(value) > 1e-60),
    a_s=st.one_of(st.just(math.inf), st.floats(1e-60, allow_infinity=False)),
    friction=st.floats(0.1, 10),
    steps=st.integers(1, 1000),
)
@settings(max_examples=50)
def test_a_file_gives_back_the_same_bits(tmp_path_factory, com_height, c_s, a_s, friction, steps):
    run = RunParameters(
        gait=GaitParameters(com_height=com_height, c_s=c_s, a_s=a_s, steps=steps),
        contact=ContactParameters(friction=friction),
    )
    path = tmp_path_factory.mktemp("run") / "run.toml"
    path.write_text(dump_run(run), encoding="utf-8")
    again = load_run(path)
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
    found = {key: key_info(key) for key in KEYS}
    assert all(info.meaning and info.unit for info in found.values())
    step, schedule = found["gait.step_length"], found["foot.schedule"]
    assert (step.unit, step.default, step.kind, step.range) == ("m", 0.6, "float", "> 0, <= 100")
    assert (schedule.kind, schedule.range, found["gait.steps"].kind) == ("text", "flat | roll", "int")


def test_settings_are_texts_or_keywords():
    texts = load_run("momentum", ["gait.c_y=0.6", "foot.schedule=flat", "gait.steps=10"])
    assert texts == load_run("momentum", gait={"c_y": 0.6, "steps": 10.0}, foot={"schedule": "flat"})
    assert load_run("momentum", ["gait.c_y=1"], gait={"c_y": 0.6}).gait.c_y == 0.6


def test_a_whole_number_may_have_a_point_and_a_file_a_byte_order_mark(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_bytes(b"\xef\xbb\xbf[gait]\nsteps = 4.0\n")
    steps = load_run(path).gait.steps
    assert (steps, type(steps)) == (4, int)

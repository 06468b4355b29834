"""Parameters, their files, and options of users' controllers and planners."""

import importlib
import math
import sys
from pathlib import Path

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

import validation as val
from ampm import PeriodicPlanner, dump_run, load_run
from ampm.parameters import KEYS, GaitParameters, RunParameters
from ampm.physics_parameters import ContactParameters
from ampm.run_file import key_info
from ampm.section import parse_setting
from docs.examples.joint_pd import JointPD
from tests.solved import QUICK
from tests.sweep_table import parse_sweep
from validation.cli.options import with_short
from validation.store.environment import parameter_values
from validation.study.many import Task, study_folder
from validation.study.sweep.design import dump_sweep
from validation.study.sweep.run import task_of
from validation.study.sweep.table import build_table
from validation.trial.plan import load_request, plan_walk
from validation.trial.users import CONTROLLER, PLANNER, is_users

SOFT = f"{__name__}:Soft"
SLOW = f"{__name__}:Slow"


class Soft(JointPD):
    def __init__(self, robot, run, gain=1.0, *, mode="plain"):
        super().__init__(robot, run)
        self.gain, self.mode = gain, mode

    def update(self, state, touch, reference):
        output = super().update(state, touch, reference)
        return output._replace(torque=self.gain * output.torque)


class Slow(PeriodicPlanner):
    def __init__(self, slope):
        super().__init__()
        self.slope = slope

    def plan(self, run, robot):
        return super().plan(run.replace({"gait.c_y": self.slope}), robot)


def test_files_settings_and_python_give_the_same_options(tmp_path):
    file = tmp_path / "own.toml"
    file.write_text(f'[controller]\nname = "{SOFT}"\n[controller.options]\ngain = 0.5\nmode = "plain"\n')
    run = load_run(file, ["controller.options.gain=2"], planner={"options": {"far": True}})
    assert run.controller.options == {"gain": 2, "mode": "plain"}
    assert type(run.controller.options["gain"]) is int
    assert run.value("planner.options.far") is True
    options = {"controller.options.gain": 2, "controller.options.mode": "plain", "planner.options.far": True}
    same = load_run(controller={"name": SOFT}).replace(options)
    assert same == run
    assert hash(same) == hash(run)
    saved = tmp_path / "saved.toml"
    saved.write_text(dump_run(run.as_is()))
    assert load_run(saved) == run
    assert parameter_values(run)["controller.options.gain"] == 2
    assert "options" not in dump_run(load_run("normal"))
    assert "[planner]" not in dump_run(load_run("normal"))


def test_the_later_value_of_an_option_counts_wherever_it_stands(tmp_path):
    (file := tmp_path / "own.toml").write_text(f'[controller]\nname = "{SOFT},gain=0.5"\n')
    assert load_run(file).controller.options == {"gain": 0.5}
    assert load_run(file, ["controller.options.gain=2"]).controller.options == {"gain": 2}
    run = load_run(file, [f"controller.name={SOFT},gain=3"])
    assert run.controller.options == {"gain": 3}
    assert run.replace({"controller.name": f"{SOFT},gain=4"}).controller.options == {"gain": 4}
    assert run.replace({"controller.options": {"mode": "x"}}).controller.options == {"mode": "x"}
    asked = (("normal", f"controller.name={SOFT},gain=3"), (None, "body.source=suite-humanoid"))
    titles = [f"normal, controller.name {SOFT}, controller.options.gain 3", "suite-humanoid"]
    assert [load_request(gait, [setting]).title for gait, setting in asked] == titles


def test_options_reach_a_class_given_in_python_and_the_saved_run_keeps_them(tmp_path):
    run = load_run("normal", controller={"options": {"gain": 0.2}}, **QUICK)
    trial = val.walk(run, controller=Soft)
    plain = val.walk(load_run("normal", **QUICK), controller=Soft)
    np.testing.assert_allclose(trial.record.torque[0], 0.2 * plain.record.torque[0])
    folder = trial.save(tmp_path / "run", recording=False)
    assert val.load(folder).parameters.controller.options == {"gain": 0.2}
    assert val.replay(folder).identical
    np.testing.assert_array_equal(val.walk(str(folder / "run.toml")).record.q, trial.record.q)


def test_a_planner_is_made_once(monkeypatch):
    made: list[float] = []
    make = Slow.__init__

    def counted(self, slope):
        made.append(slope)
        make(self, slope)

    monkeypatch.setattr(Slow, "__init__", counted)
    request = load_request("normal", [f"gait.planner='{SLOW}'", "planner.options.slope=0.9"])
    assert made == []
    assert plan_walk(request).planner == "Slow"  # whose name is that of the planner that it extends
    assert made == [0.9]


SWEEP = f"""
[sweep]
gait = "normal"
steps = 1
recordings = "none"

[set]
controller.name = "{SOFT}"
controller.options.mode = "plain"
solver.ik_time_step = 0.01
simulation.time_step = 0.002

[[vary]]
method = "grid"
controller.options.gain = [1, 0.5]
"""


def test_a_sweep_varies_an_option():
    definition = parse_sweep(SWEEP)
    assert parse_sweep(dump_sweep(definition)) == definition
    assert [definition.parameters(run).controller.options["gain"] for run in (0, 1)] == [1, 0.5]
    tasks = [task_of(definition, run) for run in (0, 1)]
    other = parse_sweep(SWEEP.replace('"plain"', '"other"'))
    assert len({task.digest for task in (*tasks, task_of(other, 0))}) == 3
    found = build_table(definition, [{"key": task.key, **task.work(**task.options)} for task in tasks])
    assert set(found["outcome"].to_pylist()) <= {"completed", "fell"}
    assert found["controller.options.gain"].to_pylist() == [1.0, 0.5]
    assert found["controller.options.mode"].to_pylist() == ["plain"] * 2
    assert len(set(found["key"].to_pylist())) == 2


def test_sources_that_a_class_imports_decide_on_the_digest(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "own_gains/more").mkdir(parents=True)
    (tmp_path / "own_gains/__init__.py").write_text("GAIN = 1.0\n")
    (tmp_path / "own_more.py").write_text("import own_gains.more")
    (tmp_path / "own_class.py").write_text("from own_more import own_gains\nclass Own: gain = own_gains.GAIN")
    own = importlib.import_module("own_class").Own
    before = Task("a", own).digest
    (tmp_path / "own_gains/__init__.py").write_text("GAIN = 2.00\n")
    assert Task("a", own).digest == before  # the workers of this study have imported it
    study_folder({})
    assert Task("a", own).digest != before
    assert [is_users(path) for path in (f"{sys.prefix}/own.py", np.__file__)] == [True, False]


def test_an_object_has_the_name_of_its_class_if_that_makes_an_equal_one():
    assert PLANNER.name_of(Slow(0.1)) == f"{__name__}:<object of Slow>"
    assert PLANNER.name_of(PeriodicPlanner("dcm")).endswith("<object of PeriodicPlanner>")
    assert PLANNER.name_of(PeriodicPlanner()) == "ampm.planners:PeriodicPlanner"
    named = type("preview", (PeriodicPlanner,), {"__module__": __name__})
    run = plan_walk(load_request("normal", ["gait.steps=1"]), planner=named()).run
    assert run.gait.planner == f"{__name__}:<object of preview>"
    assert (PLANNER.name_of(Slow), CONTROLLER.name_of(Soft)) == (SLOW, SOFT)


def test_any_path_is_the_value_of_an_option():
    for path in ("it's.csv", 'a "b".csv', "größe 😀.csv", "a\\b.csv"):
        assert parse_setting(*with_short(None, planner=path)) == ("gait.planner", path)


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

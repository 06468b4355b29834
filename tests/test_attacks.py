"""What once passed silently, ran foreign code, hung or crashed is refused in one sentence."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

import ampm
import validation as val
from ampm.exceptions import InputError
from ampm.files import read_text
from ampm.planner.routes import read_footsteps
from ampm.planner.table import table_motion
from models.source import compiled_source, source_path
from tests.test_fuzz import LOG, PLAN
from tests.test_verdict import compared
from tests.walk import perfect_walk
from validation.judge.metrics import METRICS, Metric, evaluate, unregister
from validation.judge.profiles import DEFAULT
from validation.measure.log import read_log
from validation.store.summary import Baseline, Summary, read_json
from validation.trial import plan as planning
from validation.trial.users import UsersCode, UsersError, read_columns

URDF = Path(__file__).parents[1] / "docs" / "examples" / "biped.urdf"
QUICK = {"gait": {"steps": 3}, "simulation": {"time_step": 2e-3}, "solver": {"ik_time_step": 0.01}}


@pytest.fixture
def own_metric():
    def register(compute=lambda walk: 0.0, tolerances=None):
        entry = Metric(
            "own", unit="m", meaning="own", kind="walk", compute=compute, tolerances=tolerances or {}
        )
        return val.register(entry)

    yield register
    if "own" in METRICS:
        unregister("own")


@pytest.mark.parametrize("value", [None, "1", 1j, [1.0], np.zeros(3)])
def test_a_metric_returns_a_number(own_metric, value):
    own_metric(lambda walk: value)
    with pytest.raises(
        InputError, match=r"metric 'own' cannot be computed .TypeError: it returned .* not a number"
    ):
        evaluate(compared(perfect_walk()))


def test_a_metric_has_limits_for_profiles_that_there_are():
    entry = Metric(
        "own", unit="m", meaning="own", kind="walk", compute=lambda walk: 0.0, tolerances={"defualt": 1.0}
    )
    with pytest.raises(
        InputError, match=r"unknown profile for a limit of 'own': 'defualt'; did you mean 'default'"
    ):
        DEFAULT.tolerance(entry)
    with pytest.raises(InputError, match="metric name 5 is no identifier"):
        Metric(cast(Any, 5), unit="m", meaning="own", kind="walk", compute=lambda walk: 0.0)


def test_a_planner_plans_as_many_steps_as_asked():
    class Short:
        def plan(self, run, robot):
            return ampm.PeriodicPlanner().plan(run.replace({"gait.steps": 2}), robot)

    with pytest.raises(InputError, match=r"it plans 2 steps, and gait.steps asks for 3"):
        planning.plan_walk(planning.load_request(ampm.load_run("normal", **QUICK)), planner=Short())


def test_an_error_without_words_is_told():
    class Silent(Exception):
        def __str__(self):
            raise RuntimeError

    with (
        pytest.raises(UsersError, match=r"the controller .*Silent failed .Silent: ."),
        UsersCode("controller", Silent),
    ):
        raise Silent


# ------------------------------------------------------------------------------------------------- tables


def columns_of(text):
    names, *rows = [line.split(",") for line in text.splitlines()]
    cells = dict(zip(names, map(np.array, zip(*rows, strict=True)), strict=True))
    return {name: column if name == "stance" else column.astype(float) for name, column in cells.items()}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"com_x": lambda x: 1e3 * x + 200.0}, "com and zmp are .* times the COM's height apart"),
        ({"com_y": lambda y: 0.0 * y}, "com_y is the same in all rows; leave the columns of com out"),
        ({"com_z": lambda z: 0.0 * z}, "com_z is 0 m above the floor"),
        ({"com_x": lambda x: x * np.nan}, "com_x holds no number; leave its column out"),
    ],
)
def test_a_com_that_cannot_be(changes, message):
    log = columns_of(LOG)
    with pytest.raises(InputError, match=message):
        read_log(log | {name: change(log[name] + 1e-3) for name, change in changes.items()}, 588.6)


def test_forces_that_contradict_each_other():
    log = columns_of(LOG)
    log |= {f"{foot}_force_{axis}": log[f"force_{axis}"] for foot in ("left", "right") for axis in "xyz"}
    with pytest.raises(InputError, match="force differs from that of both feet by 589 N"):
        read_log(log, 588.6)


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("left_placement_x", lambda x: x + 1e300, "must be at most 10000 in magnitude"),
        ("zmp_y", lambda y: y + 0.01 * (-1.0) ** np.arange(len(y)), "zmp_y of the table goes to and fro"),
    ],
)
def test_plans_that_cannot_be(name, change, message):
    plan = columns_of(PLAN)
    table_motion(plan)
    with pytest.raises(InputError, match=message):
        table_motion(plan | {name: change(plan[name])})


def test_a_column_stands_once(tmp_path):
    (tmp_path / "a.csv").write_text("time,x,x\n0,1,2\n")
    for read in (read_columns, read_footsteps):
        with pytest.raises(InputError, match="has the column 'x' twice"):
            read(tmp_path / "a.csv")


def test_only_regular_files_are_read(tmp_path):
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "latin.csv").write_bytes(b"foot,x\n\xe9,1\n")
    for read in (read_text, read_columns, read_footsteps, ampm.load_run, val.load_uncertainty):
        with pytest.raises(InputError, match="is no regular file"):
            read(tmp_path / "pipe.csv")
    with pytest.raises(InputError, match="is no regular file"):
        read_text(Path("/dev/zero"))
    for read in (read_columns, read_footsteps):
        with pytest.raises(InputError, match="byte 0xe9 in line 2 is no UTF-8"):
            read(tmp_path / "latin.csv")


# ------------------------------------------------------------------------------------------------- bodies


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('effort="', 'effort="-', "effort = '-.*' of joint 'waist_yaw' must be 0 or more"),
        ('lower="', 'lower="nan" old="', "lower = 'nan' of joint 'waist_yaw' must be finite"),
        ('<mass value="', '<mass value="inf" old="', "value = 'inf' of link 'pelvis' must be finite"),
        ('<mass value="', '<mass value="1e300" old="', "mass of the body 'pelvis' is"),
        ('<axis xyz="', '<axis xyz="nan 0 0" old="', "xyz = 'nan 0 0' of joint 'waist_yaw' must be finite"),
        ("</robot>", '<link name="loose"/></robot>', "links that hang on no joint: pelvis, loose; keep one"),
    ],
)
def test_models_that_cannot_be(old, new, message, tmp_path):
    text = URDF.read_text(encoding="utf-8")
    (tmp_path / "body.urdf").write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(InputError, match=message):
        compiled_source(tmp_path / "body.urdf")


def test_a_foreign_description_does_not_say_what_to_install(tmp_path):
    with pytest.raises(InputError, match="'evil-package', which is not installed; install what you trust"):
        source_path("evil-package:x.urdf", tmp_path)


# -------------------------------------------------------------------------------------------------- files


@pytest.mark.parametrize(
    "text", ["{", "[]", "{}", '{"outcome": "completed", "steps_completed": "x", "metrics": 5}']
)
@pytest.mark.parametrize("kind", [Summary, Baseline])
def test_damaged_files_of_json(text, kind, tmp_path):
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(InputError, match=r"(is damaged|is no JSON).*; walk again\."):
        read_json(tmp_path / "a.json", kind, "walk again")


@pytest.mark.parametrize(
    "command", [["report", "."], ["compare", ".", "."], ["view", ".", "--save", "a.rrd"]]
)
def test_the_results_of_a_sweep_are_read_without_its_code(command, ampm, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("sweep.toml").write_text(
        'set.gait.planner = "own_code:Planner"\n[[vary]]\nmethod = "list"\ngait.c_y = [0.8, 1.0]\n'
    )
    Path("own_code.py").write_text("open('imported', 'w').close()\n")
    assert ampm(*command).status == 2
    assert not Path("imported").exists()


def test_changed_runs_are_not_viewed(ampm, run_of, tmp_path):
    shutil.copytree(run_of(), tmp_path / "run")
    (tmp_path / "run" / "recording.rrd").write_bytes(b"RRF2")
    with (tmp_path / "run" / "run.toml").open("a") as file:
        file.write("\n")
    answer = ampm("view", tmp_path / "run", "--save", tmp_path / "a.rrd")
    assert answer.status == 2
    assert "run.toml has changed since the run was judged" in answer.err


# ------------------------------------------------------------------------------------------------- output

ENTRY = [sys.executable, "-c", "from validation.cli.entry import main; main()"]


def entry(*arguments, **options):
    return subprocess.run([*ENTRY, *arguments], text=True, check=False, timeout=120, **options)


def test_a_full_disk_behind_standard_output():
    with open("/dev/full", "w") as full:
        answer = entry("keys", "gait.steps", "--json", stdout=full, stderr=subprocess.PIPE)
        assert answer.returncode == 5
        assert answer.stderr.count("\n") == 1
        assert "the disk is full" in answer.stderr
        assert entry("plan", "nope", stdout=subprocess.PIPE, stderr=full).returncode == 2


def test_users_print_to_standard_error(tmp_path):
    (tmp_path / "loud.py").write_text("import os\nprint('python')\nos.write(1, b'descriptor\\n')\n")
    answer = entry(
        "plan", "normal", "--set", "gait.planner=loud:None", "--json", cwd=tmp_path, capture_output=True
    )
    assert json.loads(answer.stdout)["error"]["kind"] == "input"
    assert "python" in answer.stderr
    assert "descriptor" in answer.stderr


def test_a_name_of_a_renderer_that_there_is_not_is_no_crash():
    answer = entry("body", "check", "human", env={**os.environ, "MUJOCO_GL": "nonsense"}, capture_output=True)
    assert answer.returncode == 2
    assert "MUJOCO_GL" in answer.stderr

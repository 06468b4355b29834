"""What once passed silently, ran foreign code, hung or crashed is refused in one sentence."""

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

import ampm
import validation as val
from ampm.exceptions import InputError
from ampm.files import read_text
from ampm.planner.routes import read_footsteps
from ampm.planner.table import table_motion
from tests.test_cli import PROGRAM
from tests.test_fuzz import LOG, PLAN
from validation.measure.log import read_log
from validation.trial.plan import Request, plan_walk
from validation.trial.users import UsersCode, UsersError, read_columns


def test_an_error_without_words_is_told():
    class Silent(Exception):
        def __str__(self):
            raise RuntimeError

    with pytest.raises(UsersError, match=r"the controller .*Silent failed"), UsersCode("controller", Silent):
        raise Silent


def test_a_planner_of_a_user_does_not_get_the_name_of_ours():
    named = type("ampm", (ampm.PeriodicPlanner,), {"__module__": "mine"})
    run = ampm.load_run("normal", gait={"steps": 2})
    assert plan_walk(Request("normal", run), planner=named("dcm")).planner == "mine:<object of ampm>"


def columns_of(text, statement):
    """Columns of a table, changed by a statement on them."""
    names, *rows = [line.split(",") for line in text.splitlines()]
    cells = dict(zip(names, map(np.array, zip(*rows, strict=True)), strict=True))
    columns = {name: cell if name == "stance" else cell.astype(float) for name, cell in cells.items()}
    exec(statement, {"np": np}, columns)
    return columns


def log(statement):
    return read_log(columns_of(LOG, statement), 588.6)


def plan(statement):
    return table_motion(columns_of(PLAN, statement))


def test_the_tables_that_are_changed_are_read():
    log("com_y = com_y + 1e-3")
    flight = log("force_z[5:11] = 0.0; zmp_x[5:11] = np.nan")
    assert (flight.time.size, flight.gaps, "zmp" in flight.signals) == (40, (), True)  # nothing carries there
    plan("")


def test_only_regular_files_are_read(tmp_path):
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "latin.csv").write_bytes(b"foot,x\n\xe9,1\n")
    for read in (read_text, read_columns, read_footsteps, ampm.load_run, val.load_uncertainty):
        with pytest.raises(InputError, match="is not a regular file"):
            read(tmp_path / "pipe.csv")
    for read in (read_columns, read_footsteps):
        with pytest.raises(InputError, match="byte 0xe9 in line 2; save"):
            read(tmp_path / "latin.csv")


@pytest.mark.parametrize("command", ["report .", "compare . .", "view . --save a.rrd"])
def test_the_results_of_a_sweep_are_read_without_its_code(command, ampm, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("sweep.toml").write_text(
        'set.gait.planner = "own_code:Planner"\n[[vary]]\nmethod = "list"\ngait.c_y = [0.8, 1.0]\n'
    )
    Path("own_code.py").write_text("open('imported', 'w').close()\n")
    assert ampm(*command.split()).status == 2
    assert not Path("imported").exists()


def entry(arguments, **options):
    return subprocess.run([PROGRAM, *arguments.split()], text=True, check=False, timeout=120, **options)


def test_a_full_disk_behind_standard_output():
    with open("/dev/full", "w") as full:
        answer = entry("keys gait.steps --json", stdout=full, stderr=subprocess.PIPE)
        assert answer.returncode == 5
        assert answer.stderr.count("\n") == 1
        assert "the disk is full" in answer.stderr
        assert entry("plan nope", stdout=subprocess.PIPE, stderr=full).returncode == 2


def test_users_print_to_standard_error(tmp_path):
    (tmp_path / "loud.py").write_text("import os\nprint('python')\nos.write(1, b'descriptor\\n')\n")
    command = "plan normal --set gait.planner=loud:None --json"
    answer = entry(command, cwd=tmp_path, capture_output=True)
    assert json.loads(answer.stdout)["error"]["kind"] == "input"
    assert "python" in answer.stderr
    assert "descriptor" in answer.stderr


def test_a_name_of_a_renderer_that_there_is_not_is_no_crash():
    answer = entry("body check human", env={**os.environ, "MUJOCO_GL": "nonsense"}, capture_output=True)
    assert answer.returncode == 2
    assert "MUJOCO_GL" in answer.stderr

"""Bad input, a row of bad_input.csv each: one sentence, with the key, the value, the limit or the way out.

``how`` is a use below, or a module in whose names the input is evaluated. Rows of ``log`` and ``output`` are
used in test_log and test_controllers. ``words`` are parts of the sentence, ``key`` the key or the reason.

What is tried at random is refused like that, too: no other error, and no NaN accepted.
"""

import copy
import csv
import json
import math
import re
import sys
from contextlib import suppress
from functools import cache
from importlib import import_module
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ampm
import validation as val
from ampm import AmpmError, InputError, RefusedGait, load_run
from ampm.parameters import KEYS
from ampm.planner import routes
from ampm.planner.routes import read_footsteps
from ampm.planner.table import table_motion
from tests import test_make_plan
from tests.solved import simulated
from tests.sweep_table import parse_sweep
from tests.test_body_files import TOML, URDF
from tests.test_body_files import read as read_body
from tests.test_table import planned, read, table_of
from validation.cli.app import Status
from validation.measure.log import read_log
from validation.store.json import read_json
from validation.store.saved import SUMMARY
from validation.study.row_file import RowFile
from validation.study.sweep.design import check_classes
from validation.trial.disturbances import Push
from validation.trial.plan import check_formula, load_request
from validation.trial.users import read_columns

ROOT = Path(__file__).parents[1]
with (ROOT / "tests/bad_input.csv").open(encoding="utf-8", newline="") as file:
    ROWS = list(csv.DictReader(file))
assert all(None not in row for row in ROWS), "words with a comma need quotes"


def rows_of(*uses):
    return [pytest.param(row, id=row["input"][:80]) for row in ROWS if row["how"] in uses]


def of_file(use, name):
    """Use a text as the contents of a file."""

    def call(text, folder):
        (folder / name).write_text(text, encoding="utf-8")
        use(folder / name)

    return call


def body(change, _):
    """The example with a key replaced (``key = value``) or a text (``old -> new``)."""
    old, arrow, new = change.partition(" -> ")
    if not arrow:
        key = change.partition(" =")[0]
        kept = [line for line in TOML.splitlines() if not line.startswith(f"{key} =")]
        old, new = TOML, "\n".join([*kept, change])
    assert old in TOML
    read_body(toml=TOML.replace(old, new))


def urdf(change, _):
    """The example's model with the first of a text (``old -> new``) replaced."""
    old, new = change.split(" -> ")
    assert old in URDF
    read_body(URDF.replace(old, new, 1))


def columns(statement, _):
    """A plan's table changed by a statement on its columns."""
    found = {name: column.copy() for name, column in table_of(planned(steps=1)).items()}
    exec(statement, {"np": np}, found)
    read(found)


def run(settings, folder):
    """Planning is not reached: its gait could not be planned."""
    path = folder / "run.toml"
    changed = load_run("normal", ["gait.switching_velocity=0.01", *settings.split()])
    path.write_text(ampm.dump_run(changed), encoding="utf-8")
    val.walk(str(path))


def push(text, _):
    simulated(disturbances=[Push(*json.loads(text))], progress=lambda *_: pytest.fail("walked"))


USES = {
    "setting": lambda text, _: load_run("normal", [text]),
    "settings": lambda text, _: load_run("normal", text.split()),
    "run file": of_file(lambda path: load_run(path, ["gait.c_y=1"]), "bad.toml"),
    "source": lambda text, folder: load_run(ROOT / text if "/" in text else text),
    "sweep": lambda text, _: check_classes(parse_sweep(text)),
    "table": of_file(read_columns, "table.csv"),
    "footsteps": of_file(routes.read_footsteps, "walk.csv"),
    "summary": of_file(lambda path: read_json(path, SUMMARY, "walk again"), "summary.json"),
    "study": of_file(val.load_uncertainty, "convergence.json"),
    "rows": of_file(lambda path: RowFile(path.parent), "rows.jsonl"),
    "body": body,
    "urdf": urdf,
    "columns": columns,
    "samples": lambda text, _: test_make_plan.changed(text),
    "push": push,
    "walk": lambda text, _: simulated(*text.split()),
    "run": run,
}


def evaluate(module):
    """Evaluate an expression with the names of a module, and ``folder``."""
    return lambda text, folder: eval(text, {**vars(import_module(module)), "folder": folder})


USES |= {row["how"]: evaluate(row["how"]) for row in ROWS if "." in row["how"]}


def assert_said(message, words):
    assert "\n" not in message
    assert [word for word in words.split(" | ") if word not in message] == [], message


@pytest.mark.parametrize("row", rows_of(*USES))
def test_bad_input_is_refused_with_key_and_value(row, tmp_path):
    with pytest.raises(AmpmError) as caught:
        USES[row["how"]](row["input"].replace("\\n", "\n"), tmp_path)
    error = caught.value
    assert_said(str(error), row["words"])
    if isinstance(error, RefusedGait):
        assert error.reason == row["key"] or not row["key"]
        assert error.way_out in str(error)
        assert not math.isnan(error.limit)
    else:
        assert isinstance(error, InputError)
        assert row["key"] in ("", error.details.get("key"))
        assert row["key"] in str(error)


@pytest.mark.parametrize("row", rows_of("command"))
def test_a_bad_command_is_one_sentence_before_anything_is_done(row, ampm, run_of, tmp_path, monkeypatch):
    line = row["input"]
    if "RUN" in line:
        line = line.replace("RUN", str(run_of()))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    (tmp_path / "EMPTY").mkdir()
    (tmp_path / "bad.rrd").write_bytes(b"RRF2 and nothing else")
    (tmp_path / "sweep.toml").write_text('[[vary]]\nmethod = "list"\ngait.c_y = [0.8]')
    (tmp_path / "own_parts.py").write_text("class Rope:\n    pass\n")
    monkeypatch.delitem(sys.modules, "own_parts", raising=False)
    (tmp_path / "tests.py").touch()
    (tmp_path / "exits.py").write_text("raise SystemExit(0)\n")
    (tmp_path / "bad.toml").write_text("[gait]\nc_y = -1.0\n")
    (tmp_path / "walk.csv").write_text("foot,x,y,heading\n" + "right,0,-0.1,0\nleft,0,0.1,0\n" * 2)
    given = {*tmp_path.iterdir()}
    answer = ampm(*line.split())
    assert (answer.status, answer.out) == (Status.REFUSED, "")
    *progress, said = answer.err.splitlines()
    assert said.startswith("ampm: ")
    assert not progress or line.startswith("compare normal")  # the first of two walks was planned
    assert_said(said, row["words"])
    assert {*tmp_path.iterdir()} - {tmp_path / "__pycache__"} == given


EXTREMES = st.sampled_from([0.0, -1.0, 1e-300, 5e-324, 1e308, -1e308, math.nan, math.inf, -math.inf])
NUMBERS = st.floats() | EXTREMES | st.integers(-(10**400), 10**400)
CELLS = NUMBERS | st.text(max_size=8) | st.just("")
SIZES = pytest.mark.parametrize("examples", [40, pytest.param(1000, marks=pytest.mark.slow)])


def fuzz(examples, check, *strategies):
    """Try examples; only errors of ours may be raised."""

    def tried(values):
        with suppress(AmpmError):
            check(*values)

    test = given(st.tuples(*strategies))(tried)
    settings(max_examples=examples, deadline=None, derandomize=True, database=None)(test)()


@SIZES
def test_keys(examples):
    def check(key, value):
        run = load_request("normal", [f"{key}={value}"], as_is=True).run
        found = run.value(key)
        assert found == found
        check_formula(load_request(run))

    own_files = ("gait.planner", "body.source", "controller.name", "sensors.estimator")
    fuzz(examples, check, st.sampled_from([key for key in KEYS if key not in own_files]), CELLS)


LOG = "time,force_x,force_y,force_z,zmp_x,zmp_y,com_x,com_y,com_z\n" + "\n".join(
    f"{0.005 * i},0,0,588.6,{0.002 * i},{0.001 * i},{0.002 * i},{0.001 * i},0.86" for i in range(40)
)
PLAN = (
    "time,stance,com_x,com_y,zmp_x,zmp_y,left_placement_x,left_placement_y,right_placement_x,right_placement_y\n"
    + "\n".join(
        f"{0.01 * i},{'left' if i < 30 else 'both'},{0.001 * i},0,{0.001 * i},0,0,0.09,0.3,-0.09"
        for i in range(40)
    )
)
STEPS = "foot,x,y,heading,time\n" + "\n".join(
    f"{'left' if i % 2 else 'right'},{0.3 * i},{0.09 * (-1) ** (i + 1)},0," for i in range(6)
)
TABLES = {"log": LOG, "plan": PLAN, "footsteps": STEPS}


def numbers(kind, path):
    if kind == "log":
        found = read_log(read_columns(path), 588.6)
        return [found.signals["force"], found.time]
    if kind == "plan":
        motion = table_motion(read_columns(path))
        return [motion["com"], motion["zmp"]]
    steps = load_run("normal", footsteps=read_footsteps(path)).footsteps
    return [(item.x, item.y, item.z, item.heading, item.time or 0.0) for item in steps]


@SIZES
@pytest.mark.parametrize("kind", TABLES)
def test_tables(kind, examples, tmp_path):
    good = [line.split(",") for line in TABLES[kind].splitlines()]

    def check(rows, column, cell, suffix):
        table = copy.deepcopy(good)
        for row in rows:
            table[row][column % len(table[0])] = cell
        path = tmp_path / "table.csv"
        text = "\n".join(",".join(map(str, cells)) for cells in table) + suffix
        path.write_bytes(text.encode("utf-8", "surrogatepass"))
        for values in numbers(kind, path):
            assert np.isfinite(values).all()

    rows = st.lists(st.integers(0, len(good) - 1), max_size=40)
    fuzz(examples, check, rows, st.integers(0, 9), CELLS, st.sampled_from(["", "\n", "\n1,2", "\0"]))


@cache
def attributes():
    """Places of the numbers of the example's URDF: element, attribute."""
    return [
        (i, name)
        for i, element in enumerate(ET.fromstring(URDF).iter())
        for name, value in element.items()
        if re.search(r"\d", value)
    ]


@SIZES
@pytest.mark.filterwarnings("ignore:Inertia matrix:UserWarning")
def test_models_of_bodies(examples):
    def check(place, value, number):
        tree = ET.fromstring(URDF)
        element, name = list(tree.iter())[place[0]], place[1]
        words = element.get(name).split()
        words[number % len(words)] = str(value)
        element.set(name, " ".join(words))
        assert math.isfinite(read_body(ET.tostring(tree, encoding="unicode")).description.mass)

    fuzz(max(examples // 3, 8), check, st.sampled_from(attributes()), NUMBERS, st.integers(0, 2))

"""Bad keys, tables, bodies and summaries are refused in one sentence: no other error, and no NaN accepted."""

import copy
import math
import re
from contextlib import suppress
from functools import cache
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ampm import AmpmError, load_run
from ampm.parameters import KEYS, BodyParameters, RunParameters
from ampm.planner.routes import read_footsteps
from ampm.planner.table import table_motion
from models.load import build_body
from validation.judge.profiles import DEFAULT
from validation.judge.verdict import judge_summary
from validation.measure.log import read_log
from validation.show.cost_table import cost_table, reported_table
from validation.store.json import write_json
from validation.store.metric_table import metric_table
from validation.store.summary import SUMMARY, read_json
from validation.trial.plan import check_formula, load_request
from validation.trial.users import read_columns

EXAMPLES = Path(__file__).parents[1] / "docs" / "examples"
NUMBERS = st.one_of(
    st.floats(),
    st.sampled_from([0.0, -1.0, 1e-300, 5e-324, 1e308, -1e308, math.nan, math.inf, -math.inf]),
    st.integers(-(10**400), 10**400),
)
CELLS = NUMBERS | st.text(max_size=8) | st.just("")
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=4,
)
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


def numbers_of_log(path):
    found = read_log(read_columns(path), 588.6)
    return [found.signals["force"], found.time]


def numbers_of_plan(path):
    motion = table_motion(read_columns(path))
    return [motion["com"], motion["zmp"]]


def numbers_of_footsteps(path):
    steps = load_run("normal", footsteps=read_footsteps(path)).footsteps
    return [(item.x, item.y, item.z, item.heading, item.time or 0.0) for item in steps]


TABLES = {
    "log": (LOG, numbers_of_log),
    "plan": (PLAN, numbers_of_plan),
    "footsteps": (STEPS, numbers_of_footsteps),
}


@SIZES
@pytest.mark.parametrize("kind", TABLES)
def test_tables(kind, examples, tmp_path):
    text, numbers = TABLES[kind]
    good = [line.split(",") for line in text.splitlines()]

    def check(rows, column, cell, suffix):
        table = copy.deepcopy(good)
        for row in rows:
            table[row][column % len(table[0])] = cell
        path = tmp_path / "table.csv"
        text = "\n".join(",".join(map(str, cells)) for cells in table) + suffix
        path.write_bytes(text.encode("utf-8", "surrogatepass"))
        for values in numbers(path):
            assert np.isfinite(values).all()

    rows = st.lists(st.integers(0, len(good) - 1), max_size=40)
    fuzz(examples, check, rows, st.integers(0, 9), CELLS, st.sampled_from(["", "\n", "\n1,2", "\0"]))


@cache
def attributes():
    """Places of the numbers of the example's URDF: element, attribute."""
    tree = ET.fromstring((EXAMPLES / "biped.urdf").read_text(encoding="utf-8"))
    found = [(i, name) for i, element in enumerate(tree.iter()) for name in element.keys()]  # noqa: SIM118
    return [(i, name) for i, name in found if re.search(r"\d", list(tree.iter())[i].attrib[name])]


@SIZES
@pytest.mark.filterwarnings("ignore:Inertia matrix:UserWarning")
def test_models_of_bodies(examples, tmp_path):
    (tmp_path / "biped.toml").write_bytes((EXAMPLES / "biped.toml").read_bytes())
    urdf = (EXAMPLES / "biped.urdf").read_text(encoding="utf-8")
    run = RunParameters(body=BodyParameters(source=str(tmp_path / "biped.toml")))

    def check(place, value, number):
        tree = ET.fromstring(urdf)
        element, name = list(tree.iter())[place[0]], place[1]
        words = element.get(name).split()
        words[number % len(words)] = str(value)
        element.set(name, " ".join(words))
        (tmp_path / "biped.urdf").write_text(ET.tostring(tree, encoding="unicode"), encoding="utf-8")
        body = build_body(run).description
        assert math.isfinite(body.mass)

    fuzz(max(examples // 3, 8), check, st.sampled_from(attributes()), NUMBERS, st.integers(0, 2))


def places(value, path=()):
    """Keys of all entries of a nested dictionary."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield (*path, key)
            yield from places(item, (*path, key))


@SIZES
def test_summaries(examples, run_of, tmp_path):
    path = tmp_path / "summary.json"
    good = read_json(run_of() / "summary.json", SUMMARY, "")[0]

    def check(place, value):
        changed = copy.deepcopy(good)
        inner = changed
        for key in place[:-1]:
            inner = inner[key]
        inner[place[-1]] = value
        write_json(path, changed)
        found = read_json(path, SUMMARY, "walk the gait again")[0]
        for made in (metric_table(found), cost_table(found), reported_table(found)):
            assert str(made)
        assert judge_summary(found, DEFAULT)["reason"]

    fuzz(examples, check, st.sampled_from(sorted(places(good))), JSON)

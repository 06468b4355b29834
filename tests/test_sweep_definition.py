"""Definition of a sweep: what a file may say, what is told to whoever errs, and which runs follow."""

import math
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from ampm.parameters import RunParameters
from ampm.run_file import leaves_open, load_run
from tests.sweep_table import parse_sweep
from validation.study.sweep.design import check_classes, dump_sweep, load_sweep
from validation.trial.plan import own_gait

DOCS = Path(__file__).parents[1] / "docs"
EXAMPLES = [DOCS / "examples" / f"{name}.toml" for name in ("gate", "unseen")]
GRID = '[[vary]]\nmethod = "grid"\n'
LIST = '[[vary]]\nmethod = "list"\n'
SOBOL = '[[vary]]\nmethod = "sobol"\ncount = 8\n'


def values(text):
    """Values of every varied key in all runs."""
    sweep = parse_sweep(text)
    runs = [sweep.varied(run) for run in range(len(sweep))]
    return {key: np.array([run[key] for run in runs]) for key in sweep.keys}


def sampled(lines, method="sobol", count=8, seed=1):
    return values(f'[sweep]\nseed = {seed}\n[[vary]]\nmethod = "{method}"\ncount = {count}\n{lines}')


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda p: p.stem)
def test_examples_load_and_read_back(path):
    definition = load_sweep(path)
    assert definition.name == path.stem
    assert parse_sweep(dump_sweep(definition)) == definition
    for run in (0, len(definition) - 1):
        assert isinstance(definition.parameters(run), RunParameters)


def test_the_example_in_the_docs_is_a_sweep():
    text = (DOCS / "sweeps.md").read_text(encoding="utf-8")
    blocks = [part.split("```")[0] for part in text.split("```toml\n")[1:]]
    assert [len(parse_sweep(block)) for block in blocks if "[[vary]]" in block] == [7 * 3 * 16]


def test_fixed_values_and_steps_are_in_every_run():
    sweep = parse_sweep(
        '[sweep]\ngait = "momentum"\nsteps = 4\n[set]\nbody.height = 1.8\n"contact.friction" = 1\n'
        'simulation.integrator = "implicitfast"\ngait.a_s = inf\n'
        f"{GRID}gait.c_y = [0.4, 1]\nsolver.max_iterations = [500, 900]"
    )
    assert len(sweep) == 4
    run = sweep.parameters(2)
    assert (run.gait.c_s, run.gait.c_y, run.gait.steps, run.gait.a_s) == (1.2, 1.0, 4, math.inf)
    assert (run.body.height, run.contact.friction, run.simulation.integrator) == (1.8, 1.0, "implicitfast")
    assert run.solver.max_iterations == 500


def test_defaults_and_nested_quoted_and_dotted_keys():
    texts = "gait.c_y = [0.4, 1.0]", '"gait.c_y" = [0.4, 1]', "[vary.gait]\nc_y = [0.4, 1.0]"
    sweep, *others = (parse_sweep(GRID + text) for text in texts)
    assert all(other == sweep for other in others)
    assert (sweep.name, sweep.gait, sweep.steps, sweep.judged_by.name) == ("sweep", "normal", 30, "default")
    for force, profile in ((5.0, "pushed"), (0.0, "default")):  # all runs, or some of them
        assert parse_sweep(f"{GRID}disturbance.push_x = [{force}, 9.0]").judged_by.name == profile
    assert (sweep.recordings, sweep.wall_clock, sweep.shared) == ("failures", 600.0, (load_run("normal"),))
    assert sweep.keys == ("gait.c_y",)


def test_a_sweep_that_tunes_leaves_open_what_nothing_names():
    sweep = parse_sweep(
        f'[sweep]\ntune = true\ngait = "normal"\nsteps = 4\n[set]\nbody.lean = 0.1\n{GRID}body.mass = [50]'
    )
    named = {"gait.step_length", "gait.switching_velocity", "gait.c_s", "gait.c_y", "gait.steps"}
    for definition in (sweep, parse_sweep(dump_sweep(sweep))):
        assert definition.tune
        assert definition.parameters(0).given == named | {"body.lean", "body.mass"}
        assert leaves_open(definition.parameters(0))
    assert not leaves_open(parse_sweep(f"[sweep]\n{GRID}body.mass = [50]").parameters(0))


def test_blocks_are_crossed_and_the_last_key_changes_fastest():
    text = GRID + "gait.c_s = { from = 0.9, to = 1.1, count = 2 }\ngait.c_y = [0.2, 0.4, 0.6]\n"
    text += LIST + "body.height = [1.6, 1.8]\nbody.mass = [50, 80]"
    sweep = parse_sweep(text)
    rows = [tuple(sweep.varied(i).values()) for i in range(len(sweep))]
    again = parse_sweep(dump_sweep(sweep))
    assert [tuple(again.varied(i).values()) for i in range(len(sweep))] == rows
    assert rows == [
        (c_s, c_y, height, mass)
        for c_s in (0.9, 1.1)
        for c_y in (0.2, 0.4, 0.6)
        for height, mass in ((1.6, 50.0), (1.8, 80.0))
    ]
    assert list(zip(*values(text).values(), strict=True)) == rows
    assert [sweep.name_of(i) for i in (0, 11)] == ["00", "11"]


def test_ranges_of_a_grid():
    columns = values(
        GRID + "gait.c_s = { from = 0.8, to = 1.4, count = 7 }\n"
        'controller.com_stiffness = { from = 1, to = 1000, count = 4, scale = "log" }\n'
        "solver.max_iterations = { from = 10, to = 13, count = 3 }\n"
        'simulation.integrator = ["Euler", "implicitfast"]'
    )
    # Exactly 1, where the moment about the COM is exactly zero.
    assert np.unique(columns["gait.c_s"]).tolist() == [0.8, 0.9, 1.0, 1.1, 1.2, 1.3, 1.4]
    np.testing.assert_allclose(np.unique(columns["controller.com_stiffness"]), [1, 10, 100, 1000], rtol=1e-12)
    assert np.unique(columns["solver.max_iterations"]).tolist() == [10, 12, 13]
    assert columns["solver.max_iterations"].dtype == np.int64
    assert set(columns["simulation.integrator"]) == {"Euler", "implicitfast"}


@pytest.mark.parametrize("method", ["sobol", "latin_hypercube"])
def test_sampled_blocks_fill_their_ranges_and_hang_on_the_seed_alone(method):
    lines = "body.height = { from = 1.5, to = 1.9 }\nbody.mass = { from = 40, to = 90 }"
    columns, again, other = (sampled(lines, method, 256, seed) for seed in (1, 1, 2))
    for key, (low, high) in {"body.height": (1.5, 1.9), "body.mass": (40, 90)}.items():
        assert low <= columns[key].min() <= columns[key].max() <= high
        assert np.histogram(columns[key], 8, (low, high))[0].tolist() == [32] * 8  # even in every key
        np.testing.assert_array_equal(columns[key], again[key])
    assert (other["body.mass"] != columns["body.mass"]).any()
    block = SOBOL.replace("sobol", method)
    both = values(f"{block}gait.c_s = {{ from = 0, to = 1 }}\n{block}gait.c_y = {{ from = 0, to = 1 }}")
    first, second = (set(column) for column in both.values())
    assert len(first) == len(second) == 8
    assert not first & second  # two blocks draw different points


def test_any_number_of_sobol_points_are_the_first_of_more(recwarn):
    lines = "gait.c_y = { from = 0, to = 1 }"
    few, more = (sampled(lines, count=count)["gait.c_y"] for count in (3, 128))
    np.testing.assert_array_equal(few, more[:3])  # a design grows without losing runs
    assert not recwarn.list


def test_options_behind_a_name_are_of_one_planner_alone(tmp_path, monkeypatch):
    own = "from ampm.planners import PeriodicPlanner\n\nclass Own(PeriodicPlanner):\n"
    own += "    def __init__(self, roll=1.0):\n        super().__init__()\n"
    (tmp_path / "rolling.py").write_text(own, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    soft = 'controller.name = ["tests.test_options:Soft"]\ncontroller.options.gain = [0.5, 2.0]'
    check_classes(parse_sweep(GRID + soft))  # also while another role's classes are checked
    planners = '["ampm", "rolling:Own,roll=0.09", "rolling:Own,roll=2"]'
    sweep = parse_sweep(f"{GRID}gait.planner = {planners}")
    runs = [sweep.parameters(run) for run in range(3)]
    assert [run.gait.planner for run in runs] == ["ampm", "rolling:Own", "rolling:Own"]
    assert [run.planner.options for run in runs] == [{}, {"roll": 0.09}, {"roll": 2}]
    assert parse_sweep(dump_sweep(sweep)) == sweep


def test_several_gaits_are_crossed_with_all_blocks_and_keep_their_own_values(tmp_path):
    sides = (("right", -0.1), ("left", 0.1))
    rows = [{"foot": foot, "x": 0.3 * n, "y": y} for n in range(3) for foot, y in sides]
    stones = {"footsteps": rows, "gait": {"steps": 7}, "sensors": {"delay": 0.002}}
    (tmp_path / "stones.toml").write_text(tomli_w.dumps(stones))
    path = tmp_path / "league.toml"
    path.write_text(
        '[sweep]\ngait = ["normal", "stones.toml"]\n[set]\nsensors.seed = 3\n'
        f'{GRID}gait.planner = ["ampm", "dcm"]\n'
        f"{LIST}disturbance.seed = [1, 2, 3]\ncontact.friction = [0.7, 0.8, 0.9]"
    )
    sweep = load_sweep(path)
    (tmp_path / "stones.toml").unlink()
    for found in (sweep, parse_sweep(dump_sweep(sweep))):
        assert found == sweep
        assert (len(found), found.gaits, found.steps) == (12, ("normal", "stones.toml"), None)
        first, last = found.parameters(0), found.parameters(11)
        assert (first.gait.planner, first.contact.friction, first.footsteps) == ("ampm", 0.7, ())
        assert (last.gait.planner, last.contact.friction, len(last.footsteps)) == ("dcm", 0.9, 6)
        assert (first.gait.steps, last.gait.steps, last.sensors.delay, last.sensors.seed) == (30, 7, 0.002, 3)
        assert [found.gait_of(run) for run in range(12)] == 6 * [0] + 6 * [1]
        assert last.given == last.as_is().given


@pytest.mark.parametrize("place", ["set", "vary"])
def test_a_robot_has_the_values_that_suit_its_engine(place):
    varied = '[[vary]]\nmethod = "list"\nsimulation.engine = ["drake", "mujoco"]\n'
    fixed = 'simulation.engine = "drake"\n[[vary]]\nmethod = "list"\ngait.c_s = [1.1, 1.2]\n'
    head = '[sweep]\n[set]\nbody.source = "suite-humanoid"\n'
    sweep = parse_sweep(head + (fixed if place == "set" else varied))
    runs = [sweep.parameters(run) for run in range(2)]
    assert [parse_sweep(dump_sweep(sweep)).parameters(run) for run in range(2)] == runs
    shares = [(run.controller.landing_share, run.controller.stance_yield) for run in runs]
    assert shares == [(0.6, 0.2), (0.6, 0.2) if place == "set" else (0.15, 0.6)]


def test_times_and_rates_of_a_range_are_whole_steps_and_ticks_of_their_run():
    fixed = f"{GRID}simulation.time_step = [0.002, 0.001]\n"
    ranges = (
        "sensors.delay = { from = 0, to = 0.008 }\n"
        "disturbance.actuation_delay = { from = 0, to = 0.009 }\n"
        "sensors.rate = { from = 100, to = 500 }\n"
    )
    sweep = parse_sweep(f'{fixed}[[vary]]\nmethod = "latin_hypercube"\ncount = 8\n{ranges}')
    runs = [sweep.parameters(run) for run in range(16)]  # none is refused
    assert len({run.sensors.delay for run in runs}) > 6
    assert {run.count("sensors.delay") for run in runs} >= {0, 1, 2, 3, 4, 7}
    assert max(run.count("disturbance.actuation_delay") for run in runs) == 4
    ends = parse_sweep(f"{GRID}sensors.delay = {{ from = 0.0, to = 0.0032, count = 2 }}\n")
    assert [ends.varied(run)["sensors.delay"] for run in (0, 1)] == [0.0, 0.003]  # not beyond the range


def test_a_robot_has_the_values_that_suit_its_sensors():
    fixed = '[set]\nbody.source = "suite-humanoid"\n'
    sweep = parse_sweep(f"{fixed}{LIST}sensors.delay = [0.0, 0.002, 0.00031]\n")
    found = [sweep.parameters(run) for run in range(2)]
    body = {"source": "suite-humanoid"}
    assert found == [own_gait(load_run(None, body=body, sensors={"delay": late})) for late in (0.0, 0.002)]
    assert found[0].controller.stance_yield != found[1].controller.stance_yield
    assert sweep.values_of(2)["controller.stance_yield"] == 0.6  # its delay is a part of a step of physics

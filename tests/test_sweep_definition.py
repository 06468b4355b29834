"""Definition of a sweep: what a file may say, what is told to whoever errs, and which runs follow."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import validation.study.sweep
from ampm.exceptions import BodilyRefusal, InputError
from ampm.parameters import RunParameters, dump_run, keys, load_run
from validation.cli import app as cli
from validation.study.sweep.blocks import METHODS, MOST_CASES
from validation.study.sweep.definition import dump_sweep, load_sweep, parse_sweep
from validation.study.sweep.dry_run import plan_dry_run
from validation.study.sweep.dry_run_text import print_dry_run
from validation.study.sweep.keys import key_info
from validation.study.sweep.probing import SOLVED, wilson
from validation.study.sweep.sampling import cases
from validation.trial import plan as planning

EXAMPLES = sorted((Path(validation.study.sweep.__file__).parent / "examples").glob("*.toml"))
GRID = '[[vary]]\nmethod = "grid"\n'
SOBOL = '[[vary]]\nmethod = "sobol"\ncount = 8\n'


def one(lines, method="grid", **words):
    """A sweep of one block."""
    own = "".join(f"{k} = {v}\n" for k, v in words.items())
    return parse_sweep(f'[[vary]]\nmethod = "{method}"\n{own}{lines}\n')


def refused(text):
    with pytest.raises(InputError) as caught:
        parse_sweep(text)
    return str(caught.value)


# --- examples ---


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda p: p.stem)
def test_examples_load_and_read_back(path):
    definition = load_sweep(path)
    assert definition.name == path.stem
    assert parse_sweep(dump_sweep(definition)) == definition
    drawn = cases(definition)
    for case in (0, len(drawn) - 1):
        assert isinstance(drawn.run(case), RunParameters)


def test_there_are_examples_of_every_method_but_one():
    used = {block.method for path in EXAMPLES for block in load_sweep(path).vary}
    assert len(EXAMPLES) >= 3
    assert used >= {"grid", "list", "sobol"}
    assert used <= set(METHODS)


def test_the_example_in_the_docs_is_one():
    text = (Path(__file__).parents[1] / "docs" / "sweeps-definition.md").read_text(encoding="utf-8")
    blocks = [part.split("```")[0] for part in text.split("```toml\n")[1:]]
    whole = [block for block in blocks if "[[vary]]" in block]
    assert whole
    for block in whole:
        assert len(parse_sweep(block)) >= 1


# --- what a file means ---


def test_defaults():
    sweep = parse_sweep(GRID + "gait.c_y = [0.4, 1]")
    assert (sweep.name, sweep.gait, sweep.steps, sweep.seed) == ("sweep", "normal", 30, 1)
    assert (sweep.profile, sweep.recordings, sweep.worst, sweep.instrument) == ("default", "worst", 5, None)
    assert sweep.limits.wall_clock == 600.0
    assert sweep.run == load_run("normal")
    assert sweep.keys == ("gait.c_y",)


def test_fixed_values_and_steps_are_in_every_run():
    sweep = parse_sweep(
        '[sweep]\ngait = "momentum"\nsteps = 4\n[set]\nbody.height = 1.8\n"contact.friction" = 1\n'
        f'solver.qp = "daqp"\ngait.a_s = inf\n{GRID}gait.c_y = [0.4, 1]\nsolver.max_iterations = [500, 900]'
    )
    drawn = cases(sweep)
    assert len(drawn) == 4
    run = drawn.run(2)
    assert (run.gait.c_s, run.gait.c_y, run.gait.steps, run.gait.a_s) == (1.2, 1.0, 4, math.inf)
    assert (run.body.height, run.contact.friction, run.solver.qp) == (1.8, 1.0, "daqp")
    assert run.solver.max_iterations == 500
    assert load_run("momentum", drawn.settings(2)) == run


def test_nested_quoted_and_dotted_keys_are_one_thing():
    texts = (
        GRID + "gait.c_y = [0.4, 1.0]",
        GRID + '"gait.c_y" = [0.4, 1.0]',
        GRID + "[vary.gait]\nc_y = [0.4, 1.0]",
        GRID + "gait = { c_y = [0.4, 1.0] }",
    )
    assert len({dump_sweep(parse_sweep(text)) for text in texts}) == 1


def test_blocks_are_crossed_and_the_last_key_changes_fastest():
    drawn = cases(
        parse_sweep(
            GRID + "gait.c_s = [0.9, 1.1]\ngait.c_y = [0.2, 0.4, 0.6]\n"
            '[[vary]]\nmethod = "list"\nbody.height = [1.6, 1.8]\nbody.mass = [50, 80]'
        )
    )
    assert drawn.keys == ("gait.c_s", "gait.c_y", "body.height", "body.mass")
    rows = [tuple(drawn.row(i).values()) for i in range(len(drawn))]
    assert rows == [
        (c_s, c_y, height, mass)
        for c_s in (0.9, 1.1)
        for c_y in (0.2, 0.4, 0.6)
        for height, mass in ((1.6, 50.0), (1.8, 80.0))
    ]
    columns = drawn.values
    assert [tuple(columns[k][i] for k in drawn.keys) for i in range(len(drawn))] == rows
    assert drawn.columns(3, 5)["gait.c_y"].tolist() == [row[1] for row in rows[3:5]]
    assert [drawn.name(i) for i in (0, 11)] == ["00", "11"]


def test_ranges_of_a_grid():
    sweep = one(
        "gait.c_s = { from = 0.8, to = 1.4, count = 7 }\n"
        'controller.com_stiffness = { from = 1, to = 1000, count = 4, scale = "log" }\n'
        "solver.max_iterations = { from = 10, to = 13, count = 3 }"
    )
    columns = {axis.key: axis.values for axis in cases(sweep).axes}
    # Exactly 1, where the moment about the COM is exactly zero.
    assert columns["gait.c_s"].tolist() == [0.8, 0.9, 1.0, 1.1, 1.2, 1.3, 1.4]
    np.testing.assert_allclose(columns["controller.com_stiffness"], [1, 10, 100, 1000], rtol=1e-12)
    assert columns["solver.max_iterations"].tolist() == [10, 12, 13]
    assert columns["solver.max_iterations"].dtype == np.int64
    assert not columns["gait.c_s"].flags.writeable


@pytest.mark.parametrize("method", ["sobol", "latin_hypercube"])
def test_sampled_blocks_fill_their_ranges_and_hang_on_the_seed_alone(method):
    lines = "body.height = { from = 1.5, to = 1.9 }\nbody.mass = { from = 40, to = 90 }"
    columns = cases(one(lines, method, count=256)).values
    again = cases(one(lines, method, count=256)).values
    for key, (low, high) in {"body.height": (1.5, 1.9), "body.mass": (40, 90)}.items():
        values = columns[key]
        assert values.min() >= low
        assert values.max() <= high
        assert values.mean() == pytest.approx(0.5 * (low + high), rel=0.01)
        assert np.histogram(values, 8, (low, high))[0].tolist() == [32] * 8  # even in every key
        np.testing.assert_array_equal(values, again[key])
    other = cases(parse_sweep(f'[sweep]\nseed = 2\n[[vary]]\nmethod = "{method}"\ncount = 256\n{lines}'))
    assert (other.values["body.mass"] != columns["body.mass"]).any()


def test_two_sampled_blocks_draw_different_points():
    drawn = cases(
        parse_sweep(SOBOL + "gait.c_s = { from = 0, to = 1 }\n" + SOBOL + "gait.c_y = { from = 0, to = 1 }")
    )
    first, second = (axis.values for axis in drawn.axes)
    assert sorted(first) != sorted(second)
    assert len(drawn) == 64


@pytest.mark.parametrize("method", ["sobol", "latin_hypercube"])
@pytest.mark.parametrize("scale", ["linear", "log"])
def test_whole_numbers_get_equal_shares(method, scale):
    lines = f'solver.max_iterations = {{ from = 10, to = 13, scale = "{scale}" }}'
    values = cases(one(lines, method, count=4096)).values["solver.max_iterations"]
    assert values.dtype == np.int64
    number, count = np.unique(values, return_counts=True)
    assert number.tolist() == [10, 11, 12, 13]
    expected = np.diff(np.log(np.arange(9.5, 14))) if scale == "log" else np.ones(4)
    np.testing.assert_allclose(count / 4096, expected / expected.sum(), atol=2e-3)


def test_a_log_range_has_equal_ratios():
    values = cases(one('contact.friction = { from = 0.01, to = 1, scale = "log" }', "sobol", count=64)).values
    logs = np.log10(values["contact.friction"])
    assert np.histogram(logs, 8, (-2, 0))[0].tolist() == [8] * 8


@pytest.mark.parametrize("count", [1, 3, 100])
def test_any_number_of_sobol_points(count, recwarn):
    sweep = one("gait.c_y = { from = 0, to = 1 }", "sobol", count=count)
    values = cases(sweep).values["gait.c_y"]
    assert len(np.unique(values)) == count
    assert not recwarn.list
    assert bool(sweep.notes()) == (count != 1)
    # The first points of more: a design grows without losing runs.
    more = cases(one("gait.c_y = { from = 0, to = 1 }", "sobol", count=128)).values["gait.c_y"]
    np.testing.assert_array_equal(values, more[:count])


def test_texts_can_be_varied():
    drawn = cases(one('solver.qp = ["osqp", "daqp"]\ngait.model = ["ampm"]'))
    assert [drawn.run(i).solver.qp for i in range(2)] == ["osqp", "daqp"]
    assert drawn.values["solver.qp"].dtype == object


def test_a_million_cases_are_not_held():
    drawn = cases(
        one(
            "gait.c_s = { from = 0.5, to = 1.5, count = 1000 }\n"
            "gait.c_y = { from = 0.1, to = 1.1, count = 1000 }"
        )
    )
    assert len(drawn) == 1_000_000
    assert sum(axis.values.size for axis in drawn.axes) == 2000
    last = drawn.run(999_999)
    assert (last.gait.c_s, last.gait.c_y) == (1.5, 1.1)
    assert drawn.name(1) == "000001"
    for outside in (-1, 1_000_000):
        with pytest.raises(IndexError):
            drawn.row(outside)


def test_a_gait_from_a_file_is_carried_along(tmp_path):
    gait = tmp_path / "mine.toml"
    gait.write_text("[gait]\nstep_length = 0.5\nsteps = 7\n")
    path = tmp_path / "study.toml"
    path.write_text('[sweep]\ngait = "mine.toml"\n' + GRID + "gait.c_y = [0.4, 1.0]")
    sweep = load_sweep(path)
    assert (sweep.name, sweep.steps, sweep.base.gait.step_length) == ("study", 7, 0.5)
    text = dump_sweep(sweep)
    gait.unlink()
    again = parse_sweep(text)
    assert again == sweep
    assert again.run == sweep.run


def test_a_definition_cannot_be_changed():
    sweep = parse_sweep(GRID + "gait.c_y = [0.4, 1.0]")
    with pytest.raises(Exception, match="frozen"):
        sweep.steps = 3  # type: ignore[misc]


numbers = st.floats(min_value=1e-3, max_value=50, allow_nan=False)


@given(
    values=st.lists(numbers, min_size=1, max_size=5, unique=True),
    ends=st.tuples(numbers, numbers).filter(lambda e: e[0] < e[1]),
    count=st.integers(min_value=1, max_value=40),
    scale=st.sampled_from(["linear", "log"]),
    method=st.sampled_from(["sobol", "latin_hypercube"]),
    seed=st.integers(min_value=0, max_value=2**63 - 1),
    fixed=numbers,
)
@settings(max_examples=40, deadline=None)
def test_every_definition_reads_back(values, ends, count, scale, method, seed, fixed):
    text = (
        f"[sweep]\nseed = {seed}\n[set]\nbody.lean = {min(fixed, 0.4)!r}\n{GRID}gait.c_s = {values!r}\n"
        f'[[vary]]\nmethod = "{method}"\ncount = {count}\n'
        f'gait.c_y = {{ from = {ends[0]!r}, to = {ends[1]!r}, scale = "{scale}" }}'
    )
    sweep = parse_sweep(text)
    again = parse_sweep(dump_sweep(sweep))
    assert again == sweep
    assert dump_sweep(again) == dump_sweep(sweep)
    drawn, same = cases(sweep), cases(again)
    assert len(drawn) == len(values) * count
    for key in drawn.keys:
        np.testing.assert_array_equal(drawn.values[key], same.values[key])
    assert drawn.values["gait.c_y"].min() >= ends[0]
    assert drawn.values["gait.c_y"].max() <= ends[1]


# --- what goes wrong ---


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["varies nothing", "[[vary]]"]),
        ("[vary]\nmethod = 'grid'\ngait.c_y = [1]", ["[[vary]]"]),
        ("[gait]\nc_s = 1", ["[gait]", "[set]"]),
        ("[swep]\n", ["[swep]", "[sweep]"]),
        ("sweep = 3", ["[sweep]"]),
        ("[sweep]\nsede = 3", ["sweep.sede", "sweep.seed"]),
        ("[limits]\nwallclock = 3", ["limits.wallclock", "limits.wall_clock"]),
        ("[limits]\nwall_clock = 0\n", ["limits.wall_clock", "greater than 0"]),
        ('[sweep]\nsteps = "5"', ["sweep.steps", "whole number"]),
        ("[sweep]\nsteps = 0", ["sweep.steps", "at least 1"]),
        ("[sweep]\nseed = -1", ["sweep.seed", "at least 0"]),
        ("[sweep]\ngait = 3", ["sweep.gait", "text"]),
        ('[sweep]\nname = ""', ["sweep.name"]),
        ('[sweep]\ngait = "nromal"', ["nromal", "normal"]),
        ('[sweep]\nprofile = "strct"\n' + GRID + "gait.c_y = [1.0]", ["strct", "strict"]),
        ('[sweep]\nrecordings = "some"\n' + GRID + "gait.c_y = [1.0]", ["some", "failures", "worst"]),
        ('[sweep]\nrecordings = "none"\nworst = 3', ["worst", "none"]),
        ('[sweep]\ninstrument = "force-plat"\n', ["force-plat", "force-plate"]),
        ("[set]\ngait.c_x = 1\n", ["gait.c_x", "gait.c_y"]),
        ("[set]\ngait.c_y = [1, 2]\n", ["[set]", "[[vary]]"]),
        ("[set]\ngait.c_y = 1e9\n" + GRID + "gait.c_s = [1.0]", ["gait.c_y", "at most 100"]),
        ('[set]\ngait.c_y = "one"\n', ["gait.c_y", "number"]),
        ('[set]\nsolver.qp = "osq"\n', ["solver.qp", "osqp"]),
        ("[set]\ngait.steps = 9\n", ["gait.steps", "[sweep]"]),
        (GRID + "gait.steps = [5, 10]", ["gait.steps", "[sweep]"]),
        (GRID + "c_s = [1.0]", ["c_s", "gait.c_s"]),
        (GRID + "gait.c_z = [1.0]", ["gait.c_z", "gait.c_"]),
        (GRID + "gat.c_s = [1.0]", ["gait.c_s"]),
        (GRID, ["varies no key"]),
        ("[[vary]]\ngait.c_s = [1.0]", ["no method", "grid"]),
        ('[[vary]]\nmethod = "gird"\ngait.c_s = [1.0]', ["gird", "grid"]),
        ('[[vary]]\nmethod = "lhs"\ngait.c_s = [1.0]', ["latin_hypercube"]),
        ('[[vary]]\nmethod = ["grid"]\ngait.c_s = [1.0]', ["method"]),
        ('[[vary]]\nmethd = "grid"\nmethod = "grid"\ngait.c_s = [1.0]', ["methd", "method"]),
        (GRID + "gait.c_s = []", ["gait.c_s", "empty"]),
        (GRID + "gait.c_s = 1.0", ["gait.c_s", "[set]"]),
        (GRID + "gait.c_s = [1.0, 1]", ["twice"]),
        (GRID + "gait.c_s = [1.0, nan]", ["nan"]),
        (GRID + "gait.c_s = [true]", ["number"]),
        (GRID + 'gait.c_s = ["one"]', ["number"]),
        (GRID + 'solver.qp = ["osqp", "dapq"]', ["dapq", "daqp"]),
        (GRID + "solver.qp = [1]", ["solver.qp"]),
        (GRID + "solver.qp = { from = 1, to = 2, count = 2 }", ["text", "osqp"]),
        (GRID + "solver.max_iterations = [100.5]", ["whole"]),
        (GRID + "solver.max_iterations = { from = 10, to = 12, count = 9 }", ["3 whole numbers"]),
        (GRID + "gait.c_s = { from = 1, to = 2 }", ["count"]),
        (GRID + "gait.c_s = { from = 2, to = 1, count = 3 }", ["from", "less than"]),
        (GRID + "gait.c_s = { from = 1, to = 1, count = 3 }", ["[set]"]),
        (GRID + "gait.c_s = { from = 1, count = 3 }", ["'to'"]),
        (GRID + "gait.c_s = { from = 1, to = inf, count = 3 }", ["finite"]),
        (GRID + "gait.c_s = { from = 1, to = 2, count = 1 }", ["at least 2"]),
        (GRID + "gait.c_s = { from = 1, to = 2, count = 2.5 }", ["whole number"]),
        (GRID + "gait.c_s = { from = 1, to = 2, step = 0.1 }", ["step", "count"]),
        (GRID + 'gait.c_s = { from = 0, to = 2, count = 3, scale = "log" }', ["log", "> 0"]),
        (GRID + 'gait.c_s = { from = 1, to = 2, count = 3, scale = "cubic" }', ["cubic", "log"]),
        (GRID + "count = 3\ngait.c_s = [1.0]", ["count"]),
        (GRID + "gait.c_s = [1.0]\n" + GRID + "gait.c_s = [2.0]", ["blocks 1 and 2"]),
        ("[set]\ngait.c_s = 1\n" + GRID + "gait.c_s = [1.0]", ["fixed", "varied"]),
        ('[[vary]]\nmethod = "list"\ngait.c_s = [1, 2]\ngait.c_y = [1]', ["equally long", "grid"]),
        ('[[vary]]\nmethod = "list"\ngait.c_s = { from = 1, to = 2, count = 3 }', ["grid"]),
        ('[[vary]]\nmethod = "list"\ngait.c_s = [1, 1]\ngait.c_y = [2, 2]', ["twice"]),
        ('[[vary]]\nmethod = "sobol"\ngait.c_s = { from = 1, to = 2 }', ["count"]),
        ('[[vary]]\nmethod = "sobol"\ncount = 0\ngait.c_s = { from = 1, to = 2 }', ["count", "at least 1"]),
        ('[[vary]]\nmethod = "sobol"\ncount = "8"\ngait.c_s = { from = 1, to = 2 }', ["count"]),
        (SOBOL + "gait.c_s = { from = 1, to = 2, count = 3 }", ["block"]),
        (SOBOL + "gait.c_s = [1, 2]", ["list", "block of its own"]),
        (SOBOL + 'solver.qp = ["osqp"]', ["list"]),
        (SOBOL.replace("8", str(10**12)) + "gait.c_s = { from = 1, to = 2 }", ["10,000,000"]),
        (
            GRID + "".join(f"{k} = {{ from = 0.1, to = 1, count = 9999999 }}\n" for k in keys()[6:9]),
            ["runs", "10,000,000"],
        ),
        (f"{GRID}gait.c_s = [{10**400}, 1]\n" + GRID + "gait.c_s = [1.0]", ["blocks 1 and 2"]),
        ("[base]\ngait.c_x = 1\n" + GRID + "gait.c_s = [1.0]", ["gait.c_x"]),
    ],
)
def test_errors_name_the_value_and_a_way_out(text, words):
    message = refused(text)
    for word in words:
        assert word in message, message
    assert "\n" not in message


def test_files_that_are_no_sweep(tmp_path):
    with pytest.raises(InputError, match="no sweep file"):
        load_sweep(tmp_path / "none.toml")
    with pytest.raises(InputError, match="cannot be read"):
        load_sweep(tmp_path)
    broken = tmp_path / "broken.toml"
    broken.write_text("[sweep\n")
    with pytest.raises(InputError, match=r"no valid TOML.*line 1"):
        load_sweep(broken)
    run = tmp_path / "run.toml"
    run.write_text(dump_run(load_run("normal")))
    with pytest.raises(InputError, match=r"\[gait\].*\[set\]"):
        load_sweep(run)


def test_a_range_too_fine_for_its_numbers():
    with pytest.raises(InputError, match="not all different"):
        cases(one(f"gait.c_s = {{ from = 1, to = {math.nextafter(1, 2)!r}, count = 3 }}"))


def test_crossing_up_to_the_limit():
    assert MOST_CASES >= 1_000_000
    size = one(
        "gait.c_s = { from = 0.5, to = 1.5, count = 10000 }\ngait.c_y = { from = 0.1, to = 1, count = 1000 }"
    )
    assert len(size) == MOST_CASES


def test_what_is_known_of_the_keys():
    for key in keys():
        info = key_info(key)
        assert info.description
        low, high = info.ends
        assert low < high
    assert key_info("gait.a_s").finite is False
    assert key_info("solver.qp").options == ("osqp", "daqp")
    assert key_info("solver.max_iterations").kind == "int"


# --- dry run ---

HEIGHTS = '[sweep]\ngait = "flat"\nsteps = 2\n' + GRID + "gait.c_y = { from = 0.5, to = 1, count = %d }\n"


@pytest.fixture
def solver(monkeypatch):
    """Motions that are not really solved; low slopes have none."""
    asked = []

    def plan_walk(request, *_):
        asked.append(request.run.gait.c_y)
        if request.run.gait.c_y < 0.6:
            raise BodilyRefusal(
                "hip", reason="joint_limits", value=-0.1, limit=0.0, unit="rad", way_out="bend [less]"
            )
        if request.run.gait.c_y > 0.9:
            raise ZeroDivisionError

    monkeypatch.setattr(planning, "plan_walk", plan_walk)
    return asked


def test_a_dry_run_solves_some_motions(solver, capsys):
    definition = parse_sweep(HEIGHTS % 41)
    dry = plan_dry_run(definition, 1, solve=None)
    assert len(solver) == dry.solved.motions == SOLVED
    low, high = dry.interval
    assert 0 < low < dry.walking < high < 41
    assert dry.walking == pytest.approx(41 * dry.solved.passing, abs=1)
    assert set(dry.solved.refused) == {"joint_limits", "crashed (ZeroDivisionError)"}
    print_dry_run(dry)
    told = capsys.readouterr().out
    for words in (
        "walk, at most",
        "with 95 % confidence",
        "bend [less]",
        "20 of them solved",
        "falls show only",
    ):
        assert words in told
    assert dry.as_dict()["walk_at_most"]["interval"] == [low, high]
    first = solver.copy()
    assert plan_dry_run(definition, 1, solve=None).interval == (low, high)
    assert solver == first * 2
    every = plan_dry_run(definition, 1, solve=99)
    assert every.exact
    assert every.interval == (every.walking,) * 2 == (24 + 1,) * 2


def test_a_small_dry_run_solves_none(solver):
    dry = plan_dry_run(parse_sweep(HEIGHTS % SOLVED), 1, solve=None)
    assert not solver
    assert dry.walking == SOLVED
    assert "--probe" in dry.as_dict()["unseen"]
    some = plan_dry_run(parse_sweep(HEIGHTS % SOLVED), 1, probed=10)
    assert some.interval[0] < some.walking == some.interval[1] == SOLVED


@pytest.mark.parametrize(
    ("share", "number", "ends"),
    [(0.0, 10, (0.0, 0.2775)), (0.5, 10, (0.2366, 0.7634)), (1.0, 128, (0.9709, 1.0)), (0.5, 0, (0.0, 1.0))],
)
def test_the_interval_is_wilsons(share, number, ends):
    assert wilson(share, number, 0.95) == pytest.approx(ends, abs=1e-4)


def test_a_dry_run_ends_as_the_sweep_would(solver, tmp_path, capsys):
    path = tmp_path / "sweep.toml"
    for text, extra, status in (
        (HEIGHTS % 3, (), 0),
        (GRID + "gait.switching_velocity = [0.1, 0.2]\n", (), 2),
        ('[sweep]\ngait = "flat"\n' + GRID + "gait.com_height = [1.2]\n", (), 2),
        ('[sweep]\ngait = "flat"\n' + GRID + "gait.c_y = [0.5, 0.55]\n", ("--probe", "5"), 2),
        ('[sweep]\ngait = "flat"\n' + GRID + "gait.c_y = [0.5, 0.7]\n", ("--probe", "5"), 0),
    ):
        path.write_text(text, encoding="utf-8")
        assert cli.call(["sweep", str(path), "--dry-run", *extra]) == status
        assert ("every run is refused" in capsys.readouterr().out) == (status == 2)
    assert cli.call(["sweep", str(path), "--dry-run", "--probe", "-1"]) == 2
    assert cli.call(["sweep", str(path), "--out", str(tmp_path / "out"), "--probe", "1"]) == 2
    assert "--probe goes with --dry-run" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_dry_run_warns_of_memory_and_of_clocks():
    text = "[sweep]\nsteps = 30\n" + GRID + "simulation.time_step = [0.002, %s]\n"
    assert not plan_dry_run(parse_sweep(text % 0.001), 1).notes()
    (note,) = plan_dry_run(parse_sweep(text % 0.0005), 1).notes()
    assert "time steps" in note
    assert "--workers" in note
    drawn = parse_sweep(SOBOL + "simulation.time_step = { from = 0.001, to = 0.002 }")
    assert "whole number of time steps" in drawn.notes()[0]

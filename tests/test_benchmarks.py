"""The benchmarks run and say what they measured; no test judges a time."""

import csv
import json
import math

import numpy as np
import pytest

from ampm.control.controller import TrackingController
from ampm.exceptions import InputError
from benchmarks import cli, scaling, sweeping, table
from benchmarks.clock import Line, least, repeat
from benchmarks.run import BenchmarkResult, run_benchmarks
from validation.cli.options import Status
from validation.progress import Progress
from validation.show.text import format_duration
from validation.study.sweep.design import parse_sweep
from validation.table import print_tables
from validation.trial.plan import load_request

STEPS = 2
SOLVERS = ("osqp", "daqp")


@pytest.fixture(scope="module")
def result() -> BenchmarkResult:
    return run_benchmarks("normal", (), steps=STEPS, walks=1, solvers=SOLVERS, progress=Progress())


@pytest.mark.slow
def test_everything_is_measured(result):
    assert result.environment["processor"]
    # Nothing else is noted in a heading: the walks complete, every QP is solved, the clocks change no bit.
    walks = [f"walk with {name.upper()}, {STEPS} steps" for name in SOLVERS]
    assert [*result.sections] == ["once per gait", *walks, "trial in a process of its own"]
    for heading, lines in result.sections.items():
        for line in lines:
            assert 0.0 < line.median <= line.p99 <= line.maximum, (heading, line)
    for heading in walks:
        lines = {line.name: line for line in result.sections[heading]}
        tick = lines["control tick"].count
        assert tick == lines["closed loop, one control period"].count + 1 == lines["QP: iterations"].count
        assert lines["control tick, all but the QP"].count == lines["QP: update and solve"].count == tick
        assert lines["physics alone, one control period"].count in (tick, tick - 1)
        assert lines["closed loop, one control period"].of_loop == 1.0
    cost = {line.name: line for line in result.sections["trial in a process of its own"]}
    size = cost["recording, per simulated second"]
    assert size.limit is not None
    assert size.median < size.limit, "a recording takes at most 1 MB per simulated second"
    assert min(cost["memory peak"].median, result.memory_peak or 0.0) > 50.0


@pytest.mark.slow
def test_the_table_shows_every_line(result, capsys, tmp_path):
    print_tables([table.table(result)])
    shown = capsys.readouterr().out
    for heading, lines in result.sections.items():
        assert heading in shown
        assert all(line.name in shown for line in lines)
    document = tmp_path / "benchmarks.md"
    document.write_bytes(table.DOCUMENT.read_bytes())
    for _ in range(2):
        table.update_document(result, document)
    text = document.read_text(encoding="utf-8")
    assert table.page_table(result).markdown() in text
    assert all(f"| {name} |" in text for name in table.ON_PAGE)
    assert text.splitlines()[0] == table.DOCUMENT.read_text(encoding="utf-8").splitlines()[0]


@pytest.mark.slow
@pytest.mark.parametrize("to", ["file", "stdout"])
def test_the_command_line_writes_json(result, tmp_path, monkeypatch, capsys, to):
    asked: dict[str, object] = {}

    def instead(gait, settings, **named):
        asked.update(named, gait=gait, settings=tuple(settings))
        return result

    monkeypatch.setattr("benchmarks.run.run_benchmarks", instead)
    file = tmp_path / "figures.json"
    options = ["--steps", "2", "--qp", "osqp", "--gait", "flat", "--set", "gait.c_y=0.9"]
    assert cli.main([*options, "--json", "-" if to == "stdout" else str(file)]) == Status.PASS
    shown = capsys.readouterr()
    written = json.loads(shown.out if to == "stdout" else file.read_text(encoding="utf-8"))
    assert [*written["sections"]] == [*result.sections]
    assert (asked["gait"], asked["settings"], asked["steps"]) == ("flat", ("gait.c_y=0.9",), 2)
    assert asked["solvers"] == ("osqp",)
    if to == "file":
        assert "control tick" in shown.out
        assert cli.main(["--json", str(file)]) == Status.REFUSED
        assert "--force" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--gait", "limp"], "limp"),
        (["--steps", "0"], "--steps"),
        (["--qp", "magic"], "magic"),
        (["--set", "gait.stride=1"], "stride"),
        (["sweep", "--runs", "4"], "at least 32"),
        (["peers", "--only", "chess"], "chess"),
    ],
)
def test_bad_requests_are_refused_in_one_sentence(capsys, options, said):
    assert cli.main(options) == Status.REFUSED
    answer = capsys.readouterr()
    assert answer.out == ""
    assert said in answer.err
    assert answer.err.count("\n") == 1


def test_lines():
    line = Line.of("a", range(101), loop=100.0)
    assert (line.median, line.p99, line.maximum, line.count, line.of_loop) == (50.0, 99.0, 100.0, 101, 0.5)
    assert math.isnan(Line.of("a", []).median)
    assert Line.of("a", 3.0, "MB", limit=4.0).cells() == ("a", "3 MB", "", "at most 4 MB")
    np.testing.assert_array_equal(least([[1.0, 5.0], [2.0, 3.0]]), [1.0, 3.0])
    assert len(repeat(lambda: None, 3)) == 3


def test_every_run_of_a_timed_sweep_is_another():
    definition = parse_sweep(sweeping.DEFINITION.format(gait="flat", steps=2, runs=32))
    assert len({definition.parameters(number).model_dump_json() for number in range(32)}) == 32


@pytest.mark.slow
def test_a_sweep_is_timed(monkeypatch):
    """The benchmark itself, with runs that are too few to mean anything."""
    monkeypatch.setattr(sweeping, "_FEWEST", 2)
    timing = sweeping.time_sweep("flat", 2, 2, Progress())
    assert timing["overhead"] > 0.0
    assert not sweeping.is_met({**timing, "overhead": 1.0})
    assert all(text for _, text, _ in sweeping.rows(timing))
    with pytest.raises(InputError):
        sweeping.time_sweep("flat", 2, 1, Progress())


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (float("nan"), "–"),
        (0.0, "0 µs"),
        (5.43e-6, "5.43 µs"),
        (123.4e-6, "123 µs"),
        (0.0123, "12.3 ms"),
        (2.5, "2.5 s"),
        (89, "89 s"),
        (90, "2 min"),
        (3599, "60 min"),
        (5400, "1 h 30 min"),
        (7200, "2 h"),
        (1e6, "11.6 days"),
    ],
)
def test_durations_have_a_unit_that_suits_them(seconds, text):
    assert format_duration(seconds) == text


@pytest.mark.slow
def test_scaling_is_measured_written_and_drawn(monkeypatch, tmp_path, capsys):
    small = scaling.Sizes((1,), hinges=(0, 6), points=(6, 12), rates=(500,), workers=(1,), runs=1)
    monkeypatch.setattr(scaling, "Sizes", lambda: small)
    monkeypatch.setattr(scaling, "TIME_STEPS", (0.002,))
    monkeypatch.setattr(scaling, "DATA", tmp_path / "scaling.csv")
    monkeypatch.setattr(scaling, "PICTURE", tmp_path / "scaling.svg")
    assert cli.main(["scaling", "--most", "2", "--markdown"]) == Status.PASS
    assert "degrees of freedom" in capsys.readouterr().out
    with (tmp_path / "scaling.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["panel"] for row in rows} == set(scaling.TITLES)
    assert all(float(row["y"]) > 0.0 for row in rows)
    assert {row["x"] for row in rows if row["panel"] == "disk"} == {"1", "2"}
    assert {row["x"] for row in rows if row["panel"] == "hinges"} == {"40", "46"}
    drawn = (tmp_path / "scaling.svg").read_text(encoding="utf-8")
    assert all(unit in drawn for unit in ("memory peak [MB]", "control rate [Hz]", "workers"))


def test_a_larger_body_walks_the_same_ticks():
    run = load_request("normal", ["gait.steps=1"], as_is=True).run
    robot, ticks = scaling._ticks_of(run)
    ticks = ticks[:50]

    def torques(body, ticks):
        controller = TrackingController(body, run)
        return np.stack([controller.update(*tick).torque for tick in ticks])

    alone = torques(robot, ticks)
    same, of = scaling.with_points(robot, 6)
    np.testing.assert_array_equal(of, np.arange(12))
    np.testing.assert_allclose(torques(same, ticks), alone, atol=1e-6)
    more, of = scaling.with_points(robot, 24)
    weight = robot.mass * robot.gravity
    shared = sum(scaling._spread(ticks[20], of).touch.normal_force)
    assert shared == pytest.approx(sum(ticks[20].touch.normal_force), abs=1e-6 * weight)
    assert np.abs(torques(more, [scaling._spread(tick, of) for tick in ticks]) - alone).max() < 5.0
    longer = scaling.with_hinges(robot, 10)
    assert longer.nv == robot.nv + 10
    with_chain = torques(longer, [scaling._longer(tick, 10) for tick in ticks])
    assert np.abs(with_chain[:, : robot.nu] - alone).max() < 1.0

"""The benchmark runs and says what it measured; no test judges a time."""

from __future__ import annotations

import json

import numpy as np
import pytest

from benchmarks import cli, table
from benchmarks.clock import Statistics, Stopwatch, least, repeat
from benchmarks.run import BenchmarkResult, run_benchmarks
from benchmarks.walking import PARTS
from validation.cli.app import Status
from validation.show.text import format_duration

STEPS = 2


@pytest.fixture(scope="module")
def result() -> BenchmarkResult:
    return run_benchmarks("normal", steps=STEPS, walks=1)


def test_everything_is_measured_for_both_solvers(result):
    found = result.as_dict()
    assert set(found["walks"]) == {"osqp", "daqp"}
    assert found["memory_peak"] > 50.0
    assert found["environment"]["processor"]
    for once in (found[name] for name in ("plan", "plan_with_feet", "orbit", "ik_tick")):
        assert 0.0 < once["median"] <= once["p99"] <= once["maximum"]
        assert once["count"] >= 1


def test_the_recordings_cost_is_of_a_whole_trial(result):
    cost = result.recording
    assert cost.share == pytest.approx(cost.recording / cost.run)
    assert cost.recording > 0.0
    assert 0.0 < cost.rate < 1e6, "a recording takes at most 1 MB per simulated second"
    assert cost.memory_peak > 50.0


@pytest.mark.parametrize("solver", ["osqp", "daqp"])
def test_a_walk_is_the_same_with_and_without_clocks(result, solver):
    walk = result.walks[solver]
    assert walk.outcome == "completed"
    assert walk.steps_completed == STEPS
    assert walk.same_walk


@pytest.mark.parametrize("solver", ["osqp", "daqp"])
def test_the_parts_of_a_tick_are_all_there(result, solver):
    walk = result.walks[solver]
    ticks = walk.control_tick.count
    assert ticks == walk.closed_loop_tick.count + 1 == walk.qp.count == walk.iterations.count
    assert tuple(walk.parts) == tuple(PARTS)
    assert all(part.count == ticks and part.median > 0.0 for part in walk.parts.values())
    assert walk.physics_tick.count in (ticks, ticks - 1)
    assert min(walk.times_real_time, walk.times_real_time_whole, walk.times_real_time_undisturbed) > 0.0
    assert all(np.isfinite(ratio) and ratio > 0.0 for ratio in walk.ratios.values())
    assert {f"{name}_to_control" for name in PARTS} < set(walk.ratios)


def test_the_table_shows_every_row(result, capsys):
    table.print_result(result)
    shown = capsys.readouterr().out
    for name, *_ in table.rows(result):
        assert name in shown
    assert f"| **walk with OSQP, {STEPS} steps** |" in table.markdown(result)


def test_the_table_of_the_documentation_is_replaced(result, tmp_path):
    document = tmp_path / "benchmarks.md"
    document.write_bytes(table.DOCUMENT.read_bytes())
    for _ in range(2):
        table.update_document(result, document)
    text = document.read_text(encoding="utf-8")
    assert table.markdown(result) in text
    assert text.splitlines()[0] == table.DOCUMENT.read_text(encoding="utf-8").splitlines()[0]


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
    found = json.loads(shown.out if to == "stdout" else file.read_text(encoding="utf-8"))
    assert found["walks"]["osqp"]["parts"].keys() == PARTS.keys()
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
    ],
)
def test_bad_requests_are_refused_in_one_sentence(capsys, options, said):
    assert cli.main(options) == Status.REFUSED
    answer = capsys.readouterr()
    assert answer.out == ""
    assert said in answer.err
    assert answer.err.count("\n") == 1


def test_a_stopwatch_charges_every_part_for_its_own_time_only(monkeypatch):
    now = [0.0]
    monkeypatch.setattr("benchmarks.clock.time.perf_counter", lambda: now[0])

    class Work:
        def outer(self):
            now[0] += 1.0
            answer = self.inner() + self.inner()
            now[0] += 2.0
            return answer

        def inner(self):
            now[0] += 10.0
            return 1

    work, watch = Work(), Stopwatch()
    watch.time("out", work, "outer")
    watch.time("in", work, "inner")
    assert work.outer() == 2
    watch.end_round()
    work.inner()
    watch.end_round()
    assert watch.rounds == {"out": [3.0, 0.0], "in": [20.0, 10.0]}
    with pytest.raises(AttributeError):
        watch.time("out", work, "renamed")


def test_statistics():
    found = Statistics.of(range(101))
    assert (found.median, found.p99, found.maximum, found.count) == (50.0, 99.0, 100.0, 101)
    assert np.isnan(Statistics.of([]).median)
    np.testing.assert_array_equal(least([[1.0, 5.0], [2.0, 3.0]]), [1.0, 3.0])
    assert repeat(lambda: None, 3).count == 3


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (float("nan"), "–"), (0.0, "0 µs"), (5.43e-6, "5.43 µs"), (123.4e-6, "123 µs"), (0.0123, "12.3 ms"),
        (2.5, "2.5 s"), (89, "89 s"), (90, "2 min"), (3599, "60 min"), (5400, "1 h 30 min"), (7200, "2 h"),
        (1e6, "11.6 days"),
    ],
)  # fmt: skip
def test_durations_have_a_unit_that_suits_them(seconds, text):
    assert format_duration(seconds) == text

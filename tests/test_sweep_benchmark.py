"""The benchmark of sweeping says what it measured; how fast this machine is, no test judges."""

from __future__ import annotations

import pytest

from ampm.exceptions import InputError
from benchmarks import sweeping
from benchmarks.cli import main
from validation.cli.console import Narrator

TIMING = sweeping.SweepTiming(
    gait="normal",
    steps=30,
    runs=64,
    bare=4.0,
    bare_pair=4.1,
    one=260.0,
    two=134.0,
    ratio=260.0 / 134.0,
    machine_ratio=1.95,
    overhead=0.0156,
    overhead_steady=0.004,
    memory_peak=420.0,
    memory_growth=1.0,
    load=0.1,
    environment={"processor": "some processor", "cores": 2, "revision": "0123456789abcdef"},
)


def test_the_page_holds_every_figure(tmp_path, monkeypatch):
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- speed -->\nold\n<!-- end of speed -->\nafter\n", encoding="utf-8")
    monkeypatch.setattr(sweeping, "PAGE", page)
    sweeping.update_page(TIMING)
    sweeping.update_page(TIMING)
    text = page.read_text(encoding="utf-8")
    assert text.startswith(
        "before\n<!-- speed -->\n64 runs of `normal`, 30 steps each, some processor, 2 cores"
    )
    assert text.endswith("<!-- end of speed -->\nafter\n")
    assert "| throughput, 2 workers over 1 | 1.940 | >= 1.85 |" in text
    assert "| overhead per run, everything | 1.56 % | <= 3 % |" in text
    assert "| memory of a worker, peak | 420 MB | < 500 MB |" in text
    assert "old" not in text


def test_too_few_runs_tell_nothing():
    with pytest.raises(InputError, match="at least 32"):
        sweeping.time_sweep("flat", 2, 4, Narrator())
    assert main(["sweep", "--runs", "4"]) == 2


def test_what_is_timed_is_a_sweep_that_differs_from_run_to_run():
    from validation.study.sweep.design import parse_sweep
    from validation.study.sweep.sampling import cases

    definition = parse_sweep(sweeping._DEFINITION.format(gait="flat", steps=2, runs=32))
    runs = cases(definition)
    assert len({runs.run(number).model_dump_json() for number in range(32)}) == 32

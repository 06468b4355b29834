"""The benchmark of sweeping: what it times, and what it refuses."""

from __future__ import annotations

import pytest

from ampm.exceptions import InputError
from benchmarks import sweeping
from benchmarks.cli import main
from validation.progress import Progress
from validation.study.sweep.design import parse_sweep


def test_too_few_runs_are_refused():
    with pytest.raises(InputError, match="at least 32"):
        sweeping.time_sweep("flat", 2, 4, Progress())
    assert main(["sweep", "--runs", "4"]) == 2


def test_every_run_that_is_timed_is_another():
    definition = parse_sweep(sweeping._DEFINITION.format(gait="flat", steps=2, runs=32))
    assert len({definition.parameters(number).model_dump_json() for number in range(32)}) == 32

"""Nothing that is computed has changed: the golden values, checked in a process of their own."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def check(*arguments: str) -> None:
    command = [sys.executable, "-m", "tests.golden", *arguments]
    answer = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert answer.returncode == 0, answer.stdout[-5000:] + answer.stderr[-2000:]


def test_two_gaits_have_the_recorded_values():
    check("--only", "presets", "--preset", "normal", "--preset", "momentum")


@pytest.mark.slow
def test_everything_has_the_recorded_values():
    check()

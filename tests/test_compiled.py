"""Compiled functions: compiled once per machine, with one message; the same bits in every process."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from ampm import compiled

ROOT = Path(__file__).resolve().parents[1]

CROSS = """
from ampm.vectors import cross, dot
assert cross((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)) == (0.0, 0.0, 1.0)
assert dot((1.0, 2.0, 3.0), (1.0, 1.0, 1.0)) == 6.0
"""
WALK = """
import hashlib
import ampm, validation
trial = validation.walk(ampm.load_run("momentum", gait={"steps": 2, "step_length": 0.55}))
record, motion, sample = trial.record, trial.plan.posture.motion, trial.plan.sample(trial.record.time)
arrays = sample.com, sample.zmp, motion.q, motion.acceleration, record.q, record.torque, record.point_force
print(*(hashlib.sha256(array.tobytes()).hexdigest() for array in arrays))
print({name: metric.value for name, metric in trial.metrics.items()})
"""


def run(code: str, cache: Path, *arguments: str, **environment: str) -> tuple[str, str]:
    """Output and errors of a fresh interpreter."""
    given = {**os.environ, "NUMBA_CACHE_DIR": str(cache), "XDG_CACHE_HOME": str(cache), **environment}
    command = [sys.executable, "-c", code, *arguments]
    answer = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=given)
    assert answer.returncode == 0, answer.stderr
    return answer.stdout, answer.stderr


@pytest.mark.slow
def test_the_first_process_compiles_and_reports_it_once(tmp_path):
    first, second = (run(CROSS, tmp_path)[1] for _ in range(2))
    assert first.count("Compiling") == 1
    assert "Compiling" not in second
    assert "Compiling" not in run(CROSS, tmp_path / "none", NUMBA_DISABLE_JIT="1")[1]


def test_a_walk_has_the_same_bits_in_another_process_and_with_other_kernels(tmp_path):
    """Open values that are found, plan, body, periodic motion, walk and metrics."""
    here = {"NUMBA_CACHE_DIR": str(compiled.folder().parent)}
    one, other = (run(WALK, tmp_path, OPENBLAS_CORETYPE=k, **here)[0] for k in ("Haswell", "Nehalem"))
    assert "zmp_x_rmse" in one
    assert one == other


def test_what_a_walk_needs_is_compiled_before_workers_start_and_only_once(tmp_path, monkeypatch):
    from validation.run import walk  # here, because it loads the simulator

    walked: list[object] = []
    monkeypatch.setattr(walk, "folder", lambda: tmp_path)
    monkeypatch.setattr(walk, "walk", walked.append)
    for _ in range(2):
        walk.compile_once()
        assert len(walked) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["complete"]

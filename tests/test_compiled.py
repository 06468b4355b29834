"""Compiled functions: compiled once per machine, with one message; the same bits in every process."""

import copy
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
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
trial = validation.walk(ampm.load_run("momentum", gait={"steps": 2}))
record, motion, sample = trial.record, trial.plan.posture.motion, trial.plan.sample(trial.record.time)
arrays = sample.com, sample.zmp, motion.q, motion.acceleration, record.q, record.torque, record.point_force
print(*(hashlib.sha256(array.tobytes()).hexdigest() for array in arrays))
print({name: metric.value for name, metric in trial.metrics.items()})
"""
STAND = """
import sys
import ampm, numpy
from validation.measure import standing
from validation.trial.plan import make_body
standing.DURATION = 0.04
run = ampm.load_run("normal")
numpy.save(sys.argv[1], standing.stand(run, make_body(run).model).torque)
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


@pytest.mark.slow
def test_compiling_is_no_part_of_a_stage(tmp_path):
    code = """
import ampm, numba
from ampm.compiled import compiled
from validation.run.walk import timed
seconds = {}
with timed(seconds, "walk"):
    compiled(lambda x: x + 1.0)(1.0)
print(seconds["walk"])
"""
    assert float(run(code, tmp_path)[0]) < 0.05


@pytest.mark.slow
def test_plain_python_gives_the_same_torques(tmp_path):
    """Of a body that is put down: inverse kinematics, control ticks and their record."""
    for name, plain in (("compiled", "0"), ("plain", "1")):
        run(STAND, compiled.folder().parent, str(tmp_path / name), NUMBA_DISABLE_JIT=plain)
    here, there = (np.load(tmp_path / f"{name}.npy") for name in ("compiled", "plain"))
    assert len(here) >= 20
    np.testing.assert_allclose(there, here, atol=1e-6)


def test_a_bundle_hands_over_its_parts_under_their_names():
    @compiled.compiled
    def use(own, more):
        for i in range(len(own.rows)):
            own.rows[i].place[1] = own.grid[i, 0]
        own.grid[1, 0] = own.scale * own.count + more
        return own.on

    rows, grid = compiled.records(2, [("name", np.int64), ("place", np.float64, (3,))]), np.ones((2, 4))
    own = compiled.Bundle(rows=rows, grid=grid[:, ::2], scale=0.5, count=3, on=True)
    assert compiled.bound(use, (own,), 1.0)(2.0) is True
    assert grid.tolist() == [[1.0] * 4, [3.5, 1.0, 1.0, 1.0]]
    assert rows["place"][:, 1].tolist() == [1.0, 1.0]
    with pytest.raises(TypeError, match="address"):
        copy.copy(own)
    with pytest.raises(AttributeError, match="replaced"):
        own.grid = grid


def test_other_sources_are_compiled_anew(tmp_path, monkeypatch):
    now = compiled.folder()
    monkeypatch.setattr(compiled, "_SOURCES", compiled._SOURCES[1:])
    assert compiled.folder.__wrapped__() != now


@pytest.mark.slow
def test_a_walk_has_the_same_bits_in_another_process(tmp_path):
    """Plan, body, periodic motion, walk and metrics."""
    here, again = (run(WALK, tmp_path, NUMBA_CACHE_DIR=str(compiled.folder().parent))[0] for _ in range(2))
    assert "zmp_x_rmse" in here
    assert here == again


def test_what_a_walk_needs_is_compiled_before_workers_start_and_only_once(tmp_path, monkeypatch):
    from validation.run import walk  # here, because it loads the simulator

    monkeypatch.setattr(walk, "folder", lambda: tmp_path)
    walk.compile_once()
    monkeypatch.setattr(walk, "walk", None)
    walk.compile_once()
    assert [path.name for path in tmp_path.iterdir()] == ["complete"]

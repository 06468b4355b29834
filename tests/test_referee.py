"""The referee of refused gaits (docs/referee.py) finds an easy gait, with slopes as by differences."""

import numpy as np
import pytest

from ampm.run_file import load_run
from tests.test_negative_controls import script
from validation.trial.plan import make_body


@pytest.mark.slow
def test_an_easy_gait_walks_and_slopes_are_those_of_differences():
    run = load_run(None, ["gait.step_length=0.5", "gait.steps=2"])
    problem, motion, violated, _ = script("referee").judged(run, make_body(run).robot)
    assert max(violated.values()) <= 1.0
    tasks, nv, n = problem.tasks(motion.x), problem.robot.nv, len(motion.q)
    values, slopes = problem.linearised(motion, tasks)
    change = 1e-6 * np.random.default_rng(0).normal(size=(n, nv))
    step = np.concatenate([change.ravel(), [1e-6], np.zeros(len(motion.x))])
    moved, _ = problem.linearised(problem._moved(motion, step), tasks)
    for k in range(n):
        near = np.concatenate([change[k - 1], change[k], change[(k + 1) % n], [1e-6]])
        steady = (values[k] > 0.1) | (values[k] < 0.0)  # where no limit begins to be broken
        np.testing.assert_allclose((moved - values)[k][steady], (slopes[k] @ near)[steady], atol=1e-5)

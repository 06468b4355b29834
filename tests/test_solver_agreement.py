"""ADMM, the default, makes OSQP's iterations at every tick of every preset and body.

Both get the same QPs: those of a walk with OSQP. ADMM is then the default because it is the faster one of two
equal solvers.
"""

from __future__ import annotations

import numpy as np
import pytest

from ampm.control.controller import TrackingController
from ampm.parameters import RunParameters
from ampm.qp import QPSettings, make_backend
from tests.golden import PRESETS
from tests.test_bodies import PACKAGES, run_of
from validation.trial.plan import load_request, plan_walk
from validation.trial.simulate import simulate

SETTINGS = ("gait.steps=2", "simulation.time_step=0.002", "solver.qp=osqp")


class Both:
    """A backend that solves every QP with another one, too."""

    def __init__(self, first, second) -> None:
        self.first, self.second = first, second
        self.solves: list[tuple[int, int, float]] = []

    def solve(self, *problem):
        one, other = self.first.solve(*problem), self.second.solve(*problem)
        gap = np.abs(one.x - other.x).max() / np.abs(one.x).max()
        self.solves.append((one.status - other.status, one.iterations - other.iterations, gap))
        return one


def compared(gait: str | None, source: str = "human") -> np.ndarray:
    """Differences of status, iterations and answer at every tick, shape (T, 3)."""
    request = load_request(gait, SETTINGS, as_is=gait is not None, sections={"body": {"source": source}})
    planned, both = plan_walk(request), []

    def factory(robot, run):
        controller = TrackingController(robot, run)
        form, solver = controller.condensed, run.solver
        settings = QPSettings(tolerance=solver.tolerance, max_iterations=solver.max_iterations)
        other = make_backend("admm", form.P_mask(), form.A_mask(), settings)
        form.backend = Both(form.backend, other)
        both.append(form.backend)
        return controller

    record = simulate(planned.plan, planned.run, planned.body.model, controller=factory)
    assert record.outcome.completed
    return np.array(both[0].solves)


def check(solves: np.ndarray) -> None:
    status, iterations, gap = solves.T
    assert len(solves) > 300
    assert not status.any()
    assert not iterations.any()
    assert gap.max() < 1e-6
    assert np.median(gap) < 1e-10


def test_it_is_the_default() -> None:
    assert RunParameters().solver.qp == "admm"


@pytest.mark.parametrize("gait", PRESETS)
def test_presets(gait: str) -> None:
    check(compared(gait))


@pytest.mark.parametrize("source", ["suite-humanoid", *PACKAGES])
def test_bodies(source: str) -> None:
    run_of(source)  # skips what is not installed
    check(compared(None, source))

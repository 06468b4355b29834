"""The QP solver against known answers, and what it says when there is no answer."""

import math
from functools import partial
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import osqp
import pytest

from ampm.control.qp import QPProblem, QPSettings, QPSolver

EXACT = QPSettings(tolerance=1e-10, max_iterations=20000)
N, M, EQUALITIES = 12, 16, 3


def problem(seed):
    """A strictly convex QP made around its solution, by its KKT conditions: ``P, q, A, lower, upper, x``."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(N, N))
    P = root @ root.T / N + np.eye(N)
    A = rng.normal(size=(M, N)) * (rng.random((M, N)) < 0.6)
    x = rng.normal(size=N)
    rows = A @ x
    lower, upper = rows - rng.uniform(0.5, 2.0, M), rows + rng.uniform(0.5, 2.0, M)
    multiplier = np.zeros(M)
    lower[:EQUALITIES] = upper[:EQUALITIES] = rows[:EQUALITIES]
    multiplier[:EQUALITIES] = rng.normal(size=EQUALITIES)
    for row in range(EQUALITIES, EQUALITIES + 4):
        multiplier[row] = rng.uniform(0.2, 1.0) * (1 if row % 2 else -1)
        (upper if row % 2 else lower)[row] = rows[row]
    lower[-1], upper[-2] = -np.inf, np.inf
    return P, -(P @ x + A.T @ multiplier), A, lower, upper, x


def solver_of(settings=EXACT, n=N, m=M):
    """A function that solves any problem of this size."""
    problem = QPProblem(np.zeros((n, n)), np.zeros(n), np.zeros((m, n)), np.zeros(m), np.zeros(m))
    solver = QPSolver(problem, np.ones((n, n), dtype=bool), np.ones((m, n), dtype=bool), settings)
    return partial(solved, solver)


def solved(solver, *problem):
    for array, values in zip(solver.problem, problem, strict=True):
        array[...] = values
    return solver.solve()


def test_known_solutions():
    solver = solver_of()
    for seed in range(20):
        P, q, A, lower, upper, x = problem(seed)
        solution = solver(P, q, A, lower, upper)
        assert solution.solved
        np.testing.assert_allclose(solution.x, x, atol=1e-6)
        assert solution.residual < 1e-6
        assert solution.seconds > 0.0


@pytest.mark.parametrize("used", [False, True], ids=["fresh", "used"])
def test_contradicting_bounds_are_infeasible(used):
    """OSQP's own update would keep the last bounds and call the last problem's answer solved."""
    solver = solver_of(n=2, m=2)
    P, q, A = np.eye(2), np.zeros(2), np.eye(2)
    if used:
        assert solver(P, q, A, np.ones(2), np.ones(2)).solved
    solution = solver(P, q, A, np.array([2.0, 0.0]), np.array([1.0, 1.0]))
    assert not solution.solved
    assert np.isnan(solution.x).all()
    assert solution.residual > 0.0
    assert solver(P, q, A, np.ones(2), np.ones(2)).solved


def test_running_out_of_iterations_gives_the_last_iterate():
    solver = solver_of(QPSettings(tolerance=1e-12, max_iterations=10))
    solution = solver(*problem(3)[:5])
    assert not solution.solved
    assert np.isfinite(solution.x).all()
    assert solution.iterations == 10


@pytest.mark.parametrize("used", [False, True], ids=["fresh", "used"])
def test_a_nan_is_not_a_solution(used):
    solver = solver_of()
    P, q, A, lower, upper, x = problem(4)
    if used:
        solver(P, q, A, lower, upper)
    solution = solver(P, q * np.nan, A, lower, upper)
    assert not solution.solved
    assert solution.residual == math.inf
    np.testing.assert_allclose(solver(P, q, A, lower, upper).x, x, atol=1e-6)


def test_interrupt_during_a_solve_is_raised():
    """OSQP catches the signal and comes back with a status of its own."""
    solver = solver_of(n=1, m=1)
    status = osqp.SolverStatus.OSQP_SIGINT
    solver.args[0]._solver = stopped = Mock()
    stopped.solution.x = np.zeros(1)
    stopped.info = SimpleNamespace(status_val=status, prim_res=0.0, iter=1)
    with pytest.raises(KeyboardInterrupt):
        solver(np.eye(1), np.zeros(1), np.eye(1), np.zeros(1), np.ones(1))
    assert solver(np.eye(1), np.zeros(1), np.eye(1), np.ones(1), np.ones(1)).solved

"""The control QPs of a walk, solved by other solvers through qpsolvers (Caron et al.)."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.sparse import csc_matrix

from ampm.body.robot import Robot
from ampm.control.controller import TrackingController
from ampm.control.qp import QPProblem, QPSolution, QPSolver
from ampm.geometry import Array
from ampm.parameters import RunParameters
from benchmarks.peer import Peer
from validation.progress import Progress
from validation.trial.plan import PlannedWalk
from validation.trial.simulate import simulate

SOLVERS = {
    "daqp": "daqp",
    "proxqp": "proxsuite",
    "piqp": "piqp",
    "clarabel": "clarabel",
    "quadprog": "quadprog",
}
"""Solvers by their names in qpsolvers, and the distributions that have them."""
EXACT = 1e-10
"""Tolerance at which our solver gives the solutions that errors are measured from; quadprog confirms them."""
_ROUNDS = 3  # equal passes over all problems, of which the least times count


def compare_solvers(planned: PlannedWalk, problems: Sequence[QPProblem], progress: Progress) -> list[Peer]:
    """Our solver, timed with the update of its workspace, and solvers by qpsolvers, without their set-up.

    Errors are the largest of a point's normal force, beside :data:`EXACT`.
    """
    run, robot = planned.run, planned.body.robot
    with progress.stage("QPs by our solver"):
        seconds, ours = _solve(problems, run, robot)
        exact = _solve(problems, run.replace({"solver.tolerance": EXACT}), robot, rounds=1)[1]
    normals = TrackingController(robot, run).contact_qp.normals

    def error(x: Array) -> str:
        return f"{robot.mass * robot.gravity * np.abs(x - exact)[:, normals].max():.2g} N"

    peers = [Peer.of("ours", seconds, error(ours))]
    for name, distribution in SOLVERS.items():
        title = f"qpsolvers, {name}"
        with progress.stage(f"QPs by qpsolvers, {name}"):
            try:
                seconds, x = _solve_by_qpsolvers(problems, name)
            except ImportError as reason:
                peers.append(Peer.missing(title, reason))
                continue
        peers.append(Peer.of(title, seconds, error(x), distribution))
    return peers


def solve(solver: QPSolver, problem: QPProblem) -> QPSolution:
    """Solve a problem with a solver of its shape and pattern."""
    for array, values in zip(solver.problem, problem, strict=True):
        array[...] = values
    return solver.solve()


def record_problems(planned: PlannedWalk, progress: Progress) -> list[QPProblem]:
    """The QPs of a walk as the controller hands them to its solver, one for each tick."""
    problems: list[QPProblem] = []

    def recorded(robot: Robot, run: RunParameters) -> TrackingController:
        controller = TrackingController(robot, run)
        solver = controller.contact_qp.solver
        solve = solver.solve

        def keep() -> QPSolution:
            problems.append(QPProblem._make(array.copy() for array in solver.problem))
            return solve()

        solver.solve = keep  # type: ignore[method-assign]
        return controller

    with progress.stage("control QPs of a walk"):
        simulate(planned, controller=recorded)
    return problems


def _solve(
    problems: Sequence[QPProblem], run: RunParameters, robot: Robot, rounds: int = _ROUNDS
) -> tuple[Array, Array]:
    """Times [s] and solutions of the controller's own solver, shapes (T,) and (T, n)."""
    found = []
    for _ in range(rounds):
        solver = TrackingController(robot, run).contact_qp.solver
        found.append([solve(solver, problem) for problem in problems])
    seconds = np.min([[solution.seconds for solution in solutions] for solutions in found], axis=0)
    return seconds, np.stack([solution.x for solution in found[0]])


def _solve_by_qpsolvers(problems: Sequence[QPProblem], solver: str) -> tuple[Array, Array]:
    """Times without set-up [s] and solutions with the solver's defaults, shapes (T,) and (T, n).

    Raises :class:`ImportError` if qpsolvers or the solver is not installed.
    """
    import qpsolvers  # an optional package

    if solver not in qpsolvers.available_solvers:
        raise ImportError(f"{solver} is not installed")
    matrix = np.ascontiguousarray if solver in qpsolvers.dense_solvers else csc_matrix
    forms = [qpsolvers.Problem(*_one_sided(problem, matrix)) for problem in problems]
    rounds = [[qpsolvers.solve_problem(form, solver) for form in forms] for _ in range(_ROUNDS)]
    seconds = np.min([[solution.solve_time for solution in solutions] for solutions in rounds], axis=0)
    return seconds, np.stack([solution.x for solution in rounds[0]])


def _one_sided(problem: QPProblem, matrix: Callable[[Array], Any]) -> tuple[Any, ...]:
    """P, q, G, h, A, b of a problem with ``G x <= h`` and ``A x = b``; matrices made by ``matrix``."""
    P, q, rows, lower, upper = problem
    same = lower == upper
    above, below = ~same & np.isfinite(upper), ~same & np.isfinite(lower)
    G = np.concatenate([rows[above], -rows[below]])
    h = np.concatenate([upper[above], -lower[below]])
    return matrix(P), q, matrix(G), h, matrix(rows[same]), upper[same]

"""Convex quadratic programs ``min 1/2 x'Px + q'x  s.t.  l <= A x <= u``, solved by OSQP.

A :class:`QPSolver` keeps its workspace between calls: the sparsity pattern is fixed when it is made, and a
call only passes new numbers. It has no time limit: the same numbers give the same answer.
"""

import math
import time
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import osqp
import scipy.sparse as sparse
from numpy.typing import NDArray

from ampm.compiled import bound, compiled, refer
from ampm.exceptions import SolverError
from ampm.geometry import Array

_SOLVED, _INTERRUPTED = int(osqp.SolverStatus.OSQP_SOLVED), int(osqp.SolverStatus.OSQP_SIGINT)
_STOPPED = int(osqp.SolverStatus.OSQP_SOLVED_INACCURATE), int(osqp.SolverStatus.OSQP_MAX_ITER_REACHED)
"""Iterations used up; what is neither solved nor stopped is a certificate of infeasibility."""
_INFINITY = 1e30  # of OSQP


class QPProblem(NamedTuple):
    """``min 1/2 x'Px + q'x  s.t.  lower <= A x <= upper``, in arrays that are filled anew for every solve."""

    P: Array  # symmetric positive semidefinite cost matrix, dense, shape (n, n)
    q: Array  # linear cost, shape (n,)
    A: Array  # rows of the constraints, dense, shape (m, n); zero outside the pattern
    lower: Array  # shape (m,), may be `-inf`
    upper: Array  # shape (m,), may be `inf`


class QPSolution(NamedTuple):
    """Answer of one solve."""

    x: Array  # minimiser, or the last iterate if unsolved; NaN if infeasible, shape (n,)
    solved: bool  # whether the solver met its tolerance
    residual: float  # bound of the violation of `l <= A x <= u`, in the rows' own units
    iterations: int  # of the solver
    seconds: float  # wall-clock time of update and solve [s]; for statistics only


@dataclass(frozen=True)
class QPSettings:
    """Settings of OSQP; all tolerances are in the units of the scaled problem."""

    tolerance: float  # absolute and relative tolerance
    max_iterations: int  # iterations after which a QP counts as unsolved
    rho: float = 1.0  # ADMM penalty at the start
    alpha: float = 1.1  # over-relaxation
    rho_interval: int = 50  # iterations between two changes of the penalty
    # sweeps of equilibration when the workspace is made; 0 for problems that come well scaled
    scaling: int = 0


def _places(mask: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Places of a pattern's values in the dense matrix, in CSC order."""
    columns, rows = np.nonzero(mask.T)
    return rows * mask.shape[1] + columns


class SparseValues(NamedTuple):
    """A problem as OSQP takes it."""

    P_places: NDArray[np.intp]  # places of the values of P in the dense matrix, in CSC order
    A_places: NDArray[np.intp]  # the same of A
    P: Array  # values of the upper triangle
    A: Array  # values
    lower: Array  # finite, shape (m,)
    upper: Array  # finite, shape (m,)


@compiled
def gather(problem: QPProblem, values: SparseValues) -> float:
    """Take dense matrices to their values in CSC order, and bounds to finite ones.

    Returns the largest difference of a lower bound and its upper one, positive where no point is feasible.
    """
    P, A, lower, upper = problem.P.reshape(-1), problem.A.reshape(-1), problem.lower, problem.upper
    for i in range(len(values.P)):
        values.P[i] = P[values.P_places[i]]
    for i in range(len(values.A)):
        values.A[i] = A[values.A_places[i]]
    gap = -np.inf
    for i in range(len(lower)):
        values.lower[i], values.upper[i] = max(lower[i], -_INFINITY), min(upper[i], _INFINITY)
        gap = max(gap, values.lower[i] - values.upper[i])
    return gap


class QPSolver:
    """OSQP with one workspace and fixed patterns (Stellato et al. 2020).

    Args:
        problem: C-contiguous arrays of float64, which every solve reads.
        P_mask: pattern of the symmetric cost matrix, shape (n, n).
        A_mask: pattern of the constraint matrix, shape (m, n).
        settings: tolerances and penalties.
    """

    def __init__(
        self, problem: QPProblem, P_mask: NDArray[np.bool_], A_mask: NDArray[np.bool_], settings: QPSettings
    ) -> None:
        self.problem = problem
        self._P, self._A = (sparse.csc_matrix(mask, dtype=np.float64) for mask in (np.triu(P_mask), A_mask))
        self._values = SparseValues(
            P_places=_places(np.triu(P_mask)),
            A_places=_places(A_mask),
            P=self._P.data,
            A=self._A.data,
            lower=np.empty(len(A_mask)),
            upper=np.empty(len(A_mask)),
        )
        self._gather = bound(gather, (refer(problem), refer(self._values)))
        self._settings = settings
        self._solver: Any = None

    def solve(self) -> QPSolution:
        """Solve the problem as it stands now, warm-started from the last answer.

        Raises :class:`SolverError` if OSQP does not take it, for example because the cost is not convex.
        """
        start, q = time.perf_counter(), self.problem.q
        gap = self._gather()
        if gap > 0.0:  # OSQP would keep the last bounds and solve with those
            return QPSolution(np.full(len(q), np.nan), False, gap, 0, time.perf_counter() - start)
        solver = self._solver
        if solver is None:
            solver = self._solver = self._setup()
        else:
            values = self._values
            solver.update_data_vec(q=q, l=values.lower, u=values.upper)
            solver.update_data_mat(P_x=values.P, P_i=None, A_x=values.A, A_i=None)
        solver.solve()
        x = solver.solution.x  # a copy of the solver's
        seconds = time.perf_counter() - start
        info = solver.info
        code, residual = info.status_val, float(info.prim_res)
        if code == _INTERRUPTED:
            self._solver = None
            raise KeyboardInterrupt  # OSQP catches the signal itself
        if code != _SOLVED and code not in _STOPPED:
            x[:] = math.nan
        elif not math.isfinite(x.dot(x)):  # OSQP calls a problem with a NaN solved
            residual = math.inf
        finite = math.isfinite(x.dot(x))
        if not finite:
            self._solver = None  # its iterates must not warm-start the next solve
        elif info.rho_updates:  # a penalty that suits one hard problem slows down all that follow
            solver.update_rho(self._settings.rho)
        return QPSolution(x, finite and code == _SOLVED, residual, int(info.iter), seconds)

    def _setup(self) -> Any:
        """OSQP's compiled solver with the gathered values; its wrapper takes longer than a small solve."""
        settings, values = self._settings, self._values
        solver = osqp.OSQP(algebra="builtin")
        try:
            solver.setup(
                self._P,
                self.problem.q,
                self._A,
                values.lower,
                values.upper,
                eps_abs=settings.tolerance,
                eps_rel=settings.tolerance,
                max_iter=settings.max_iterations,
                rho=settings.rho,
                adaptive_rho=1,  # by iterations, as times would not repeat
                adaptive_rho_interval=settings.rho_interval,
                alpha=settings.alpha,
                sigma=1e-6,
                scaling=settings.scaling,
                check_termination=5,  # iterations between two checks
                check_dualgap=False,
                polishing=False,
                time_limit=1e10,  # never: a clock would make runs irreproducible
                warm_starting=True,
                verbose=False,
            )
        except osqp.OSQPException as error:
            why = "its numbers are too large" if error.args == (1,) else "its cost may not be convex"
            raise SolverError(f"OSQP does not take the problem (error {error}): {why}") from error
        return solver._solver

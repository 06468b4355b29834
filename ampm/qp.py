"""Convex quadratic programs ``min 1/2 x'Px + q'x  s.t.  l <= A x <= u`` behind one small interface.

A :class:`QPBackend` keeps its workspace between calls: the sparsity pattern is fixed when it is made, and a
call only passes new numbers. :class:`OsqpBackend`, the default, is an ADMM; :class:`DaqpBackend` is an exact
active-set solver. No backend has a time limit: the same numbers give the same answer.
"""

import enum
import math
import time
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
import osqp
import scipy.sparse as sparse
from numpy.typing import NDArray

from ampm.compiled import bound, compiled, refer
from ampm.exceptions import InputError, SolverError

Array = NDArray[np.float64]

BACKENDS = ("osqp", "daqp")
"""Names that :func:`make_backend` accepts."""


class QPStatus(enum.IntEnum):
    """How a QP ended."""

    SOLVED = 0
    UNSOLVED = 1
    INFEASIBLE = 2


_OSQP_STATUS = {
    int(osqp.SolverStatus.OSQP_SOLVED): QPStatus.SOLVED,
    int(osqp.SolverStatus.OSQP_SOLVED_INACCURATE): QPStatus.UNSOLVED,
    int(osqp.SolverStatus.OSQP_MAX_ITER_REACHED): QPStatus.UNSOLVED,
}
"""All others are certificates of infeasibility."""

_INTERRUPTED = int(osqp.SolverStatus.OSQP_SIGINT)
_INFINITY = 1e30  # of both solvers


class QPSolution(NamedTuple):
    """Answer of one solve.

    Attributes:
        x: minimiser, or the last iterate if unsolved; meaningless if infeasible, shape (n,).
        status: solved, unsolved (iterations used up, or not finite) or infeasible.
        residual: bound of the violation of ``l <= A x <= u``, in the rows' own units.
        iterations: of the solver.
        seconds: wall-clock time of update and solve [s]; for statistics only.
    """

    x: Array
    status: QPStatus
    residual: float
    iterations: int
    seconds: float

    @property
    def solved(self) -> bool:
        """Whether the solver met its tolerance."""
        return self.status == QPStatus.SOLVED


@dataclass(frozen=True)
class QPSettings:
    """Settings of OSQP; all tolerances are in the units of the scaled problem.

    Attributes:
        tolerance: absolute and relative tolerance.
        max_iterations: iterations after which a QP counts as unsolved.
        rho: ADMM penalty.
        adaptive_rho: whether the penalty adapts (by iterations, never by time).
        alpha: over-relaxation.
        check_every: iterations between two termination checks.
        scaling: sweeps of equilibration when the workspace is made; 0 for problems that come well scaled.
    """

    tolerance: float = 3e-4
    max_iterations: int = 400
    rho: float = 1.0
    adaptive_rho: bool = True
    alpha: float = 1.1
    check_every: int = 5
    scaling: int = 0


class QPBackend(Protocol):
    """Interface of a solver for controller and inverse kinematics."""

    def solve(self, P: Array, q: Array, A: Array, lower: Array, upper: Array) -> QPSolution:
        """Solve with new numbers, arrays of float64.

        Args:
            P: symmetric positive semidefinite cost matrix, dense, shape (n, n).
            q: linear cost, shape (n,).
            A: rows of the constraints, dense, C-contiguous, shape (m, n); zero outside the pattern.
            lower: shape (m,), may be ``-inf``.
            upper: shape (m,), may be ``inf``.
        """
        ...


class _Pattern:
    """Sparsity pattern of a matrix, and the places that take a dense array to its CSC values."""

    def __init__(self, mask: NDArray[np.bool_]) -> None:
        self._csc = sparse.csc_matrix(mask, dtype=np.float64)
        columns, rows = np.nonzero(mask.T)  # column-major order, as CSC wants
        self.places = rows * mask.shape[1] + columns

    def matrix(self, dense: Array) -> sparse.csc_matrix:
        """The sparse matrix itself, explicit zeros kept."""
        csc = self._csc
        return sparse.csc_matrix((dense.take(self.places), csc.indices, csc.indptr), shape=csc.shape)


class SparseValues(NamedTuple):
    """A problem as OSQP takes it.

    Attributes:
        P_places: places of the values of P in the dense matrix, in CSC order.
        A_places: the same of A.
        P: values of the upper triangle.
        A: values.
        lower: finite, shape (m,).
        upper: finite, shape (m,).
    """

    P_places: NDArray[np.intp]
    A_places: NDArray[np.intp]
    P: Array
    A: Array
    lower: Array
    upper: Array


@compiled
def gather(values: SparseValues, P: Array, A: Array, lower: Array, upper: Array) -> float:
    """Take dense matrices to their values in CSC order, and bounds to finite ones.

    Returns:
        The largest difference of a lower bound and its upper one, positive where no point is feasible.
    """
    dense_P, dense_A = P.reshape(-1), A.reshape(-1)
    for i in range(len(values.P)):
        values.P[i] = dense_P[values.P_places[i]]
    for i in range(len(values.A)):
        values.A[i] = dense_A[values.A_places[i]]
    gap = -np.inf
    for i in range(len(lower)):
        values.lower[i], values.upper[i] = max(lower[i], -_INFINITY), min(upper[i], _INFINITY)
        gap = max(gap, lower[i] - upper[i])
    return gap


class OsqpBackend:
    """OSQP with one workspace and fixed patterns (Stellato et al. 2020).

    Args:
        P_mask: pattern of the symmetric cost matrix, shape (n, n).
        A_mask: pattern of the constraint matrix, shape (m, n).
        settings: tolerances and penalties.
    """

    def __init__(self, P_mask: NDArray[np.bool_], A_mask: NDArray[np.bool_], settings: QPSettings) -> None:
        self._P, self._A = _Pattern(np.triu(P_mask)), _Pattern(A_mask)
        self._values = SparseValues(
            P_places=self._P.places,
            A_places=self._A.places,
            P=np.empty(self._P.places.size),
            A=np.empty(self._A.places.size),
            lower=np.empty(len(A_mask)),
            upper=np.empty(len(A_mask)),
        )
        matrix, vector = np.empty((1, 1)), np.empty(1)
        self._gather = bound(gather, (refer(self._values),), matrix, matrix, vector, vector)
        self._settings = settings
        self._solver: Any = None

    def solve(self, P: Array, q: Array, A: Array, lower: Array, upper: Array) -> QPSolution:
        """See :class:`QPBackend`; warm-started from the last answer.

        Raises:
            SolverError: OSQP does not take the problem, for example because the cost is not convex.
            KeyboardInterrupt: the user interrupted the solve.
        """
        start = time.perf_counter()
        P, A = np.ascontiguousarray(P), np.ascontiguousarray(A)
        gap = self._gather(P, A, np.ascontiguousarray(lower), np.ascontiguousarray(upper))
        if gap > 0.0:  # OSQP would keep the last bounds and solve with those
            no_point = np.full(len(q), np.nan)
            return QPSolution(no_point, QPStatus.INFEASIBLE, gap, 0, time.perf_counter() - start)
        solver = self._solver
        if solver is None:
            solver = self._solver = self._setup(P, q, A, lower, upper)
        else:
            values = self._values
            solver.update_data_vec(q=q, l=values.lower, u=values.upper)
            solver.update_data_mat(P_x=values.P, P_i=None, A_x=values.A, A_i=None)
        solver.solve()
        x = solver.solution.x  # a copy of the solver's
        seconds = time.perf_counter() - start
        info = solver.info
        code = info.status_val
        status, residual = _OSQP_STATUS.get(code, QPStatus.INFEASIBLE), float(info.prim_res)
        if status is not QPStatus.INFEASIBLE and not math.isfinite(x.dot(x)):
            status = QPStatus.UNSOLVED  # OSQP calls a problem with a NaN solved
            residual = math.inf
            self._solver = None
        if status is QPStatus.INFEASIBLE:
            self._solver = None  # its iterates must not warm-start the next solve
        elif info.rho_updates:  # a penalty that suits one hard problem slows down all that follow
            solver.update_rho(self._settings.rho)
        if code == _INTERRUPTED:
            raise KeyboardInterrupt  # OSQP catches the signal itself
        return QPSolution(x, status, residual, int(info.iter), seconds)

    def _setup(self, P: Array, q: Array, A: Array, lower: Array, upper: Array) -> Any:
        """A workspace: OSQP's compiled solver, without the wrapper that takes longer than a small solve."""
        s = self._settings
        solver = osqp.OSQP(algebra="builtin")
        try:
            solver.setup(
                self._P.matrix(P),
                q,
                self._A.matrix(A),
                lower,
                upper,
                eps_abs=s.tolerance,
                eps_rel=s.tolerance,
                max_iter=s.max_iterations,
                rho=s.rho,
                adaptive_rho=int(s.adaptive_rho),  # 1: by iterations; a time-based interval would not repeat
                adaptive_rho_interval=50,
                alpha=s.alpha,
                sigma=1e-6,
                scaling=s.scaling,
                check_termination=s.check_every,
                check_dualgap=False,
                polishing=False,
                time_limit=1e10,  # never: a clock would make runs irreproducible
                warm_starting=True,
                verbose=False,
            )
        except osqp.OSQPException as error:
            raise SolverError(
                f"OSQP does not take the problem (error {error}); is its cost convex?"
            ) from error
        return solver._solver


class DaqpBackend:
    """DAQP, a dual active-set solver (Arnström et al. 2022); exact, needs ``pip install -e '.[daqp]'``.

    Args:
        rows: number of constraints.
    """

    def __init__(self, rows: int) -> None:
        try:
            import daqp  # an optional package
        except ImportError as error:
            raise InputError(
                "solver.qp = daqp needs the package daqp, which is not installed; "
                "install it with 'pip install -e .[daqp]' in the checkout or use solver.qp = osqp."
            ) from error
        self._daqp = daqp
        self._sense = np.zeros(rows, dtype=np.int32)

    def solve(self, P: Array, q: Array, A: Array, lower: Array, upper: Array) -> QPSolution:
        """See :class:`QPBackend`; cold-started every time."""
        start = time.perf_counter()
        up, low = np.minimum(upper, _INFINITY), np.maximum(lower, -_INFINITY)
        A = np.ascontiguousarray(A)
        x, _, flag, info = self._daqp.solve(P, q, A, up, low, self._sense)
        seconds = time.perf_counter() - start
        x = np.array(x, dtype=np.float64)
        if flag == -1:
            status = QPStatus.INFEASIBLE
        else:
            status = QPStatus.SOLVED if flag > 0 and np.isfinite(x).all() else QPStatus.UNSOLVED
        rows = A @ x
        violation = float(max((low - rows).max(), (rows - up).max(), 0.0))
        residual = violation if math.isfinite(violation) else math.inf
        return QPSolution(x, status, residual, int(info.get("iterations", 0)), seconds)


def make_backend(
    name: str, P_mask: NDArray[np.bool_], A_mask: NDArray[np.bool_], settings: QPSettings
) -> QPBackend:
    """The backend called ``name`` for a problem of this pattern.

    Raises:
        InputError: no such backend, or its package is not installed.
    """
    if name == "osqp":
        return OsqpBackend(P_mask, A_mask, settings)
    if name == "daqp":
        return DaqpBackend(A_mask.shape[0])
    raise InputError(f"there is no QP solver {name!r}; choose one of {', '.join(BACKENDS)}.")

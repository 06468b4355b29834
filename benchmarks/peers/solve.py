"""Solve the recorded control QPs with one solver; a script that runs in the solver's own environment.

``python solve.py NAME SET OUT`` needs NumPy and the solver alone, for the project's own solvers the project.
What converts a problem to a solver's form is not timed.
"""

import sys
import time
from importlib import metadata
from typing import Any

import numpy as np

LOOSE, TIGHT = 3e-4, 1e-9
"""Tolerances: the controller's, and high accuracy as in qpbenchmark."""

_PASSES = 5  # over all problems; of every problem the least time counts
_MOST = 20_000  # iterations
PARTS = ("x", "y", "solved", "seconds")
"""Arrays of a result: shapes (T, n), (T, m), (T,), (T,) [s]."""
Answer = tuple[Any, Any, bool]


class Solver:
    """A solver with its workspace.

    Args:
        tolerance: absolute and relative, None for an exact solver.
        patterns: where P and A are ever other than zero.
    """

    package, exact = "", False

    def __init__(self, tolerance: float | None, patterns: tuple[Any, Any]) -> None:
        self.tolerance, self.patterns = tolerance, patterns
        self.key: Any = None
        self.work: Any = None

    def form(self, P: Any, q: Any, A: Any, low: Any, high: Any) -> Any:
        """The problem as :meth:`solve` takes it."""
        return P, q, A, low, high

    def solve(self, form: Any) -> Any:
        """Solve; a workspace of an earlier call is used again where the solver can."""
        raise NotImplementedError

    def answer(self, form: Any, found: Any) -> Answer:
        """Solution, multipliers with ``P x + q + A' y = 0``, and whether the solver calls it solved."""
        raise NotImplementedError


class Own(Solver):
    """OSQP as the controller calls it."""

    package = "osqp"

    def solve(self, form: Any) -> Any:
        from ampm.qp import QPSettings, make_backend

        if self.work is None:
            most = 400 if self.tolerance == LOOSE else _MOST
            settings = QPSettings(tolerance=float(self.tolerance or 0.0), max_iterations=most)
            self.work = make_backend("osqp", *self.patterns, settings)
        return self.work.solve(*form)

    def answer(self, form: Any, found: Any) -> Answer:
        return found.x, self.work._solver.solution.y, found.solved


class Osqp(Solver):
    """OSQP with its own defaults."""

    package = "osqp"

    def form(self, P: Any, q: Any, A: Any, low: Any, high: Any) -> Any:
        return sparse(np.triu(P), np.triu(self.patterns[0])), q, sparse(A, self.patterns[1]), low, high

    def solve(self, form: Any) -> Any:
        import osqp

        P, q, A, low, high = form
        if self.work is None:
            self.work, eps = osqp.OSQP(), self.tolerance
            # By iterations, not by time, so that equal problems have equal answers.
            adapt = {"adaptive_rho_interval": 50, "max_iter": _MOST, "verbose": False}
            self.work.setup(P.copy(), q, A.copy(), low, high, eps_abs=eps, eps_rel=eps, **adapt)
        else:
            self.work.update(q=q, l=low, u=high, Px=P.data, Ax=A.data)
        return self.work.solve(raise_error=False)

    def answer(self, form: Any, found: Any) -> Answer:
        return found.x, found.y, found.info.status == "solved"


class Daqp(Solver):
    """DAQP; its working set is kept from call to call."""

    package, exact = "daqp", True

    def form(self, P: Any, q: Any, A: Any, low: Any, high: Any) -> Any:
        sense = np.where(low == high, 5, 0).astype(np.int32)
        return P, q, A, high.clip(max=1e30), low.clip(min=-1e30), sense

    def solve(self, form: Any) -> Any:
        import daqp

        *data, sense = form
        if self.work is None or self.key != sense.tobytes():  # other equalities
            self.work, self.key = daqp.Model(), sense.tobytes()
            self.work.setup(*data, sense)
        else:
            self.work.update(*data)
        return self.work.solve()

    def answer(self, form: Any, found: Any) -> Answer:
        return found[0], found[3]["lam"], found[2] > 0


class Split(Solver):
    """A solver that takes equalities apart; a workspace serves while these are the same rows."""

    def form(self, P: Any, q: Any, A: Any, low: Any, high: Any) -> Any:
        same = low == high
        return (P, q, A[same], high[same], A[~same], low[~same], high[~same]), same

    def solve(self, form: Any) -> Any:
        data, same = form
        if fresh := self.work is None or self.key != same.tobytes():
            self.key = same.tobytes()
        return self.run(data, fresh)

    def run(self, data: Any, fresh: bool) -> Any:
        """Solve, with a new workspace or the last one."""
        raise NotImplementedError

    def join(self, form: Any, equal: Any, other: Any) -> Any:
        """Multipliers in the rows' own order."""
        y = np.empty(len(form[1]))
        y[form[1]], y[~form[1]] = equal, other
        return y


class ProxQp(Split):
    """ProxQP, dense."""

    package = "proxsuite"

    def run(self, data: Any, fresh: bool) -> Any:
        from proxsuite import proxqp

        if fresh:
            self.work = proxqp.dense.QP(len(data[1]), len(data[3]), len(data[5]))
            settings = self.work.settings
            settings.eps_abs = settings.eps_rel = self.tolerance
            self.work.init(*data)
        else:
            self.work.settings.initial_guess = proxqp.InitialGuess.WARM_START_WITH_PREVIOUS_RESULT
            self.work.update(*data)
        self.work.solve()
        self.solved = proxqp.QPSolverOutput.PROXQP_SOLVED
        return self.work.results

    def answer(self, form: Any, found: Any) -> Answer:
        return found.x, self.join(form, found.y, found.z), found.info.status == self.solved


class Piqp(Split):
    """PIQP, dense; an interior-point method: the workspace is kept, the iteration starts anew."""

    package = "piqp"

    def form(self, P: Any, q: Any, A: Any, low: Any, high: Any) -> Any:
        data, same = super().form(P, q, A, low, high)
        return tuple(np.asfortranarray(array) for array in data), same

    def run(self, data: Any, fresh: bool) -> Any:
        import piqp

        if fresh:
            self.work = piqp.DenseSolver()
            settings = self.work.settings
            settings.eps_abs = settings.eps_rel = self.tolerance
            settings.eps_duality_gap_abs = settings.eps_duality_gap_rel = self.tolerance
            self.work.setup(*data)
        else:
            self.work.update(*data)
        self.solved = self.work.solve() == piqp.PIQP_SOLVED
        return self.work.result

    def answer(self, form: Any, found: Any) -> Answer:
        return found.x, self.join(form, found.y, found.z_u - found.z_l), self.solved


class OneSided(Split):
    """A solver with equations first, then rows ``G x <= h``: the upper bounds, and the lower ones negated."""

    def one_sided(self, P: Any, q: Any, A: Any, low: Any, high: Any) -> Any:
        """Rows, whether they are ever other than zero, right-hand sides; and what :meth:`signed` needs."""
        (_, _, C, b, G, low, high), same = Split.form(self, P, q, A, low, high)
        pattern, below, above = self.patterns[1], np.isfinite(low), np.isfinite(high)
        rows = np.concatenate([C, G[above], -G[below]])
        mask = np.concatenate([pattern[same], pattern[~same][above], pattern[~same][below]])
        return rows, mask, np.concatenate([b, high[above], -low[below]]), (len(b), below, above), same

    def signed(self, form: Any, z: Any) -> Any:
        """Multipliers of the rows as they were."""
        equal, below, above = form[0][-1]
        other = np.zeros(len(below))
        other[above] += z[equal : equal + above.sum()]
        other[below] -= z[equal + above.sum() :]
        return self.join(form, z[:equal], other)


class Clarabel(OneSided):
    """Clarabel; an interior-point method: the workspace is kept, the iteration starts anew."""

    package = "clarabel"

    def form(self, P: Any, q: Any, A: Any, low: Any, high: Any) -> Any:
        rows, mask, right, sides, same = self.one_sided(P, q, A, low, high)
        P = sparse(np.triu(P), np.triu(self.patterns[0]))
        return (P, q, sparse(rows, mask), right, sides), same

    def run(self, data: Any, fresh: bool) -> Any:
        import clarabel

        P, q, A, right, (equal, _, _) = data
        if fresh:
            settings = clarabel.DefaultSettings()
            settings.verbose = settings.presolve_enable = False
            settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = self.tolerance
            cones = [clarabel.ZeroConeT(equal), clarabel.NonnegativeConeT(len(right) - equal)]
            self.work = clarabel.DefaultSolver(P, q, A, right, cones, settings)
        else:
            self.work.update(P=P, q=q, A=A, b=right)
        return self.work.solve()

    def answer(self, form: Any, found: Any) -> Answer:
        return np.array(found.x), self.signed(form, np.array(found.z)), str(found.status) == "Solved"


class Quadprog(OneSided):
    """quadprog: Goldfarb and Idnani's dual method; it has no workspace."""

    package, exact = "quadprog", True

    def form(self, P: Any, q: Any, A: Any, low: Any, high: Any) -> Any:
        rows, _, right, sides, same = self.one_sided(P, q, A, low, high)
        return (P, -q, np.ascontiguousarray(-rows.T), -right, sides), same

    def run(self, data: Any, fresh: bool) -> Any:
        import quadprog

        *arguments, (equal, _, _) = data
        return quadprog.solve_qp(*arguments, equal)

    def answer(self, form: Any, found: Any) -> Answer:
        return found[0], self.signed(form, found[4]), True


SOLVERS: dict[str, type[Solver]] = {
    "OSQP": Own,
    "OSQP, its defaults": Osqp,
    "DAQP": Daqp,
    "ProxQP": ProxQp,
    "PIQP": Piqp,
    "Clarabel": Clarabel,
    "quadprog": Quadprog,
}


def sparse(dense: Any, mask: Any) -> Any:
    """CSC matrix with the values of a pattern, explicit zeros kept."""
    from scipy.sparse import csc_matrix

    columns, rows = np.nonzero(mask.T)
    starts = np.concatenate([[0], np.cumsum(np.bincount(columns, minlength=mask.shape[1]))])
    return csc_matrix((dense[rows, columns], rows, starts), shape=mask.shape)


def time_solver(name: str, problems: Any, passes: int = _PASSES) -> dict[str, Any]:
    """Solve every problem, with each tolerance, with new workspaces and with one that is kept.

    Returns:
        The arrays of :data:`PARTS` by ``tolerance/start``, with start ``cold`` or ``warm``.
    """
    kind = SOLVERS[name]
    patterns = tuple((problems[matrix] != 0.0).any(axis=0) for matrix in "PA")
    rows = list(zip(*(problems[part] for part in "PqAlu"), strict=True))
    first = np.flatnonzero(np.diff(problems["sequence"], prepend=-1))
    results = {}
    for tolerance in (None,) if kind.exact else (LOOSE, TIGHT):
        forms = [kind(tolerance, patterns).form(*row) for row in rows]
        for start in ("cold", "warm"):
            seconds = np.full(len(rows), np.inf)
            answers: list[Answer] = []
            for _ in range(passes):
                answers.clear()
                for k, form in enumerate(forms):
                    if start == "cold" or k in first:
                        solver = kind(tolerance, patterns)
                    begin = time.perf_counter()
                    found = solver.solve(form)
                    seconds[k] = min(seconds[k], time.perf_counter() - begin)
                    x, y, solved = solver.answer(form, found)
                    answers.append((np.array(x), np.array(y), solved))
            stacked = [np.stack(values) for values in zip(*answers, strict=True)]
            results[f"{tolerance}/{start}"] = dict(zip(PARTS, (*stacked, seconds), strict=True))
    return results


if __name__ == "__main__":
    asked, source, target = sys.argv[1:]
    with np.load(source) as data:
        found = time_solver(asked, {name: data[name] for name in data.files})
    flat = {f"{mode}/{part}": value for mode, result in found.items() for part, value in result.items()}
    package = SOLVERS[asked].package
    np.savez(target, **flat, version=f"{package} {metadata.version(package)}")

"""Plans of COM and ZMP by other methods, on the footsteps, times and feet of a gait."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ampm.geometry import Array, polygon_margin
from ampm.planner.step_planners import dcm_steps, preview_steps, reference_zmp, step_axes
from ampm.planner.support import StepPlan, plan_steps
from ampm.qp import DaqpBackend
from benchmarks.clock import repeat
from validation.trial.plan import load_request, make_body

HORIZON, PERIODS = 1.6, (0.1, 0.025)
"""Horizon of the MPC and its sampling, of Herdt et al. and finer [s]."""
JERK_COST = 1e-6
"""Cost of the squared jerk over that of the squared ZMP error [s^6], of Wieber."""

STEPS = 10
_AHEAD = 4  # further steps, into which the MPC's horizon reaches
_FINE = 0.005  # between instants at which a plan is judged [s]
_TIMES = 30  # how often each plan is made


class Judged(NamedTuple):
    """A plan and what it took.

    Attributes:
        seconds: times of equal plans, COM and feet [s].
        error: largest distance of the ZMP from the one that the method follows [m]; zero for a closed form.
        margin: least distance of the ZMP from the edge of the support, negative outside [m].
        jump: largest jump of the COM's acceleration over g [1].
    """

    seconds: list[float]
    error: float
    margin: float
    jump: float


def plans(gait: str = "normal") -> dict[str, Judged]:
    """Plan ten steps by every method; ours first."""
    run = load_request(gait, [f"gait.steps={STEPS}"]).run
    sole = make_body(run).robot.description.sole
    given = run.gait, run.body.mass, run.foot, sole
    ours, preview, dcm = plan_steps(*given), preview_steps(*given), dcm_steps(*given)
    times = np.arange(0.0, ours.duration, _FINE)
    wanted = _reference(ours, times)
    found = {}
    methods: dict[str, tuple[Callable[[], object], StepPlan]] = {
        "AMPM, closed form": (lambda: plan_steps(*given), ours),
        "DCM, closed form": (lambda: dcm_steps(*given), dcm),
        "ZMP preview control": (lambda: preview_steps(*given), preview),
    }
    for name, (make, plan) in methods.items():
        error = float(np.abs(plan.sample(times).zmp - wanted).max()) if plan is preview else 0.0
        margin, jump = plan.least_zmp_margin()[0], plan.residuals().acceleration
        found[name] = Judged(repeat(make, _TIMES), error, margin, jump)
    longer = plan_steps(run.gait.model_copy(update={"steps": STEPS + _AHEAD}), *given[1:])
    start = preview.sample([0.0])
    state = np.stack([start.com[0, :2], start.com_velocity[0, :2], start.com_acceleration[0, :2]])
    points, contact = ours.points_in_contact(times)
    for period in PERIODS:
        mpc = Mpc(longer, period)

        def make_mpc(mpc: Mpc = mpc) -> tuple[Array, Array]:
            plan_steps(*given)
            return mpc.follow(state, int(ours.duration / mpc.period) + 1)

        zmp = mpc.zmp(*make_mpc(), times)
        margin = float(polygon_margin(points, contact, zmp).min())
        error = float(np.abs(zmp - wanted).max())
        found[f"LIPM MPC, sampled at {1e3 * period:g} ms"] = Judged(
            repeat(make_mpc, _TIMES), error, margin, 0.0
        )
    return found


def _reference(steps: StepPlan, times: Array) -> Array:
    """ZMP that preview control and MPC follow, shape (N, 2) [m]."""
    return np.stack([reference_zmp(steps, axis, times) for axis in step_axes(steps)], axis=1)


def cart(time: float) -> tuple[Array, Array]:
    """A, (3, 3), and B, (3,), of the COM under a constant jerk, for the state (u, u', u'')."""
    A = np.array([[1.0, time, 0.5 * time**2], [0.0, 1.0, time], [0.0, 0.0, 1.0]])
    return A, np.array([time**3 / 6.0, 0.5 * time**2, time])


class Mpc:
    """Model predictive control of the cart-table (Wieber, Humanoids 2006; Herdt et al., IROS 2010).

    At every sample a QP finds the jerks over the horizon, constant between samples, for which the ZMP of the
    samples follows a reference and stays within the support polygon. The first of them is applied.

    Args:
        steps: footsteps and feet; longer than the plan by the horizon.
        period: sampling [s].
    """

    def __init__(self, steps: StepPlan, period: float) -> None:
        self.period, count = period, round(HORIZON / period)
        times = np.arange(0.0, steps.duration, period)
        self.reference = _reference(steps, times)
        self.edges = [_edges(steps.support_polygon(time)) for time in times]
        (A, B), self.output = cart(self.period), np.array([1.0, 0.0, -steps.com_height / steps.gravity])
        rows = [self.output @ np.linalg.matrix_power(A, k) for k in range(count + 1)]
        self.free = np.array(rows[1:])
        answer = np.array([*rows[:-1]]) @ B
        late = np.subtract.outer(np.arange(count), np.arange(count))
        self.pushed = np.where(late >= 0, answer[late], 0.0)
        cost = self.pushed.T @ self.pushed + JERK_COST * np.eye(count)
        self.P: Array = np.kron(np.eye(2), cost).astype(np.float64)

    def follow(self, state: Array, count: int) -> tuple[Array, Array]:
        """States at the samples, shape (count, 3, 2), and jerks after them, shape (count, 2).

        Raises:
            RuntimeError: a QP has no solution.
        """
        (A, B), states, jerks, horizon = cart(self.period), [], [], len(self.free)
        for k in range(count):
            ahead = self.free @ state
            q = self.pushed.T @ (ahead - self.reference[k + 1 : k + 1 + horizon])
            edges = self.edges[k + 1 : k + 1 + horizon]
            sample = np.repeat(np.arange(horizon), [len(edge) for edge in edges])
            normal, level = (np.concatenate(edges)[:, part] for part in (slice(0, 2), 2))
            rows = np.hstack([normal[:, :1] * self.pushed[sample], normal[:, 1:] * self.pushed[sample]])
            upper = level - np.einsum("ij,ij->i", normal, ahead[sample])
            solver = DaqpBackend(len(self.P), len(rows))
            solution = solver.solve(self.P, q.T.ravel(), rows, np.full(len(rows), -np.inf), upper)
            if not solution.solved:
                raise RuntimeError(f"the QP at {k * self.period:.1f} s has no solution")
            states.append(state)
            jerks.append(solution.x[::horizon])
            state = A @ state + np.outer(B, jerks[-1])
        return np.stack(states), np.stack(jerks)

    def zmp(self, states: Array, jerks: Array, times: Array) -> Array:
        """ZMP between the samples, too, shape (N, 2) [m]."""
        place = np.minimum((times / self.period + 1e-9).astype(int), len(states) - 1)
        parts = []
        for k, rest in zip(place, times - self.period * place, strict=True):
            A, B = cart(float(rest))
            parts.append(self.output @ (A @ states[k] + np.outer(B, jerks[k])))
        return np.stack(parts)


def _edges(corners: Array) -> Array:
    """Outward normals of a polygon's edges and their levels, ``n . p <= level``, shape (k, 3)."""
    along = np.roll(corners, -1, axis=0) - corners
    normal = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.hypot(*along.T)[:, None]
    return np.column_stack([normal, np.einsum("ij,ij->i", normal, corners)])

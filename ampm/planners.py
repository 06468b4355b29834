"""Planners: from a request to a complete walk."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ampm.body.feasibility import check_body
from ampm.body.motion import PeriodicPosture, WholeBodyMotion
from ampm.body.robot import Robot
from ampm.exceptions import BodilyRefusal, InputError
from ampm.parameters import RunParameters
from ampm.planner.contacts import Footstep
from ampm.planner.footstep_walk import plan_footstep_walk, stops, walk_again
from ampm.planner.live import LiveWalk
from ampm.planner.stride import plan_feet
from ampm.planner.support import StepPlan
from ampm.planner.table import closed_step, repeats, table_plan
from ampm.planner.zmp_laws import STEP_PLANNERS, StepPlanner
from ampm.walk import Boundary, Planner, WalkPlan


@dataclass(frozen=True)
class WalkRequest:
    """Request to a planner.

    Attributes:
        run: parameters of gait, body, feet and controller.
        robot: the body.
        progress: called with a line of text now and then; None: no progress.
    """

    run: RunParameters
    robot: Robot
    progress: Callable[[str], None] | None = None


@dataclass(frozen=True)
class PeriodicWalk(WalkPlan):
    """A walk of equal steps.

    Attributes:
        posture: the periodic step, mirrored from step to step.
    """

    posture: PeriodicPosture


def periodic_walk(steps: StepPlan, motion: WholeBodyMotion, robot: Robot) -> PeriodicWalk:
    """A plan of equal steps and its periodic motion as one plan."""
    return PeriodicWalk.of(steps, posture=PeriodicPosture(motion, robot))


class AmpmPeriodic:
    """The paper's planner: equal steps in closed form, and the periodic whole-body motion for them.

    Attributes:
        steps: makes COM and feet; the other planners of :data:`PLANNERS` replace it.
    """

    steps: StepPlanner = staticmethod(STEP_PLANNERS["ampm"])

    def plan(self, request: WalkRequest, begin: Boundary | None = None) -> PeriodicWalk:
        """Plan a walk.

        Args:
            request: run and body.
            begin: must be None: a periodic walk begins on its own motion.

        Raises:
            MathematicalRefusal: the closed form has no solution.
            BodilyRefusal: the body cannot walk it.
            InputError: a boundary was given, or the grid is too coarse for the posture's gains.
        """
        if begin is not None:
            raise InputError("a periodic walk begins on its own motion; plan it without a boundary.")
        run, robot = request.run, request.robot
        steps = self.steps(run.gait, run.body.mass, run.foot, robot.description.sole)
        return periodic_walk(steps, periodic_motion(steps, request), robot)


def periodic_motion(steps: StepPlan, request: WalkRequest) -> WholeBodyMotion:
    """Periodic whole-body motion of a plan's first step, checked.

    Raises:
        BodilyRefusal: the body cannot walk it.
        InputError: the grid is too coarse for the posture's gains.
    """
    run, robot = request.run, request.robot
    check_body(steps, robot.description)
    # Imported here, as the inverse kinematics is compiled.
    from ampm.body.orbit import solve_motion

    return solve_motion(steps, run, robot, progress=request.progress)


class IpmPeriodic(AmpmPeriodic):
    """The plain inverted pendulum on the footsteps, times and feet of the gait; its ZMP jumps."""

    steps = staticmethod(STEP_PLANNERS["ipm"])


class PreviewPeriodic(AmpmPeriodic):
    """ZMP preview control (Kajita et al., ICRA 2003) on the footsteps, times and feet of the gait."""

    steps = staticmethod(STEP_PLANNERS["preview"])


class DcmPeriodic(AmpmPeriodic):
    """DCM planning (Englsberger et al., T-RO 2015) on the footsteps, times and feet of the gait."""

    steps = staticmethod(STEP_PLANNERS["dcm"])


PLANNERS: Mapping[str, type[AmpmPeriodic]] = {
    "ampm": AmpmPeriodic, "ipm": IpmPeriodic, "preview": PreviewPeriodic, "dcm": DcmPeriodic,
}  # fmt: skip
"""Planners of equal steps by name, see :mod:`ampm.planner.zmp_laws`."""


ENOUGH_ROWS = 200.0
"""Rows of a table with which its walk is that of the plan that wrote it, within 5 % of the errors [1/s]."""


class TablePlanner:
    """COM and ZMP of a table on its footsteps, see :mod:`ampm.planner.table`; the feet swing as the gait's.

    Steps that repeat are walked with their periodic whole-body motion, others with a constant posture.

    Args:
        table: columns by name, shape (N,) each.
        name: for reports.

    Raises:
        InputError: the table is the name of a file.
    """

    def __init__(self, table: Mapping[str, Any], name: str = "table") -> None:
        if isinstance(table, str | Path):
            raise InputError("TablePlanner takes columns, not a file; pass a file to val.walk(planner=).")
        self.table, self.name = table, name

    def plan(self, request: WalkRequest, begin: Boundary | None = None) -> WalkPlan:
        """Plan the walk of the table.

        Raises:
            InputError: a boundary was given, or the table makes no plan.
            BodilyRefusal: the body cannot walk it; the way out of a table with few rows is more of them.
        """
        if begin is not None:
            raise InputError("a table begins with its first row; plan it without a boundary.")
        try:
            return self._plan(request)
        except BodilyRefusal as error:
            time = np.asarray(self.table["time"], dtype=np.float64)
            rate = (time.size - 1) / (time[-1] - time[0])
            way_out = error.way_out.replace("gait.", "the table's ")
            if rate <= 0.99 * ENOUGH_ROWS:
                way_out = f"give the table {ENOUGH_ROWS:g} rows a second or more, it has {rate:.3g}"
            raise BodilyRefusal(
                str(error).removesuffix(f"; {error.way_out}."),
                reason=error.reason, value=error.value, limit=error.limit, unit=error.unit,
                way_out=way_out,
            ) from error  # fmt: skip

    def _plan(self, request: WalkRequest) -> WalkPlan:
        run, robot = request.run, request.robot
        plan = table_plan(self.table, mass=run.body.mass, com_height=run.gait.com_height)
        lift_speed = plan.constants.l_s / plan.constants.single_support_duration
        feet = plan_feet(plan.contacts, run.foot, robot.description.sole, lift_speed)
        steps = StepPlan.of(plan, feet=feet)
        if repeats(steps):
            closed = closed_step(steps)
            posture = PeriodicPosture(periodic_motion(closed, request), robot)
            momentum = closed.phases[0].angular_momentum
            steps = replace(steps, phases=(steps.phases[0]._replace(angular_momentum=momentum),))
            return WalkPlan.of(steps, posture=posture)
        # Imported here, as the inverse kinematics is compiled.
        from ampm.body.constant_posture import ConstantPosture

        check_body(steps, robot.description)
        return WalkPlan.of(steps, posture=ConstantPosture(steps, run, robot))


SPREAD_ARMS = 0.25
"""Least abduction of the arms over footsteps, for thighs that swing sideways [rad]."""


@dataclass(frozen=True)
class FootstepWalk(WalkPlan):
    """A walk over footsteps, from standing to standing."""

    @property
    def judged_from(self) -> float:
        """Begin of what a trial judges [s]: the first motion."""
        return 0.0


class AmpmFootsteps:
    """The walk over the footsteps of a run, see :mod:`ampm.planner.footsteps`, with a constant posture.

    Args:
        stop: time of a request to stop [s]; None: no request.
        changes: other requests, in their order: time [s] and footsteps from there on, see
            :class:`ampm.planner.live.LiveWalk`. After the last swing of a walk, another one begins as soon as
            the body stands.
    """

    def __init__(
        self, stop: float | None = None, changes: Sequence[tuple[float, Sequence[Footstep]]] = ()
    ) -> None:
        self.stop, self.changes = stop, tuple(changes)
        requests = [f"changed at {at:g} s" for at, _ in changes]
        requests += [] if stop is None else [f"stop at {stop:g} s"]
        self.name = ", ".join(["footsteps", *requests])

    def plan(self, request: WalkRequest, begin: Boundary | None = None) -> FootstepWalk:
        """Plan the walk.

        Raises:
            InputError: a boundary was given, or the footsteps are no walk.
            MathematicalRefusal: the gait has no closed form.
            BodilyRefusal: the body cannot walk them.
        """
        if begin is not None:
            raise InputError("a walk over footsteps begins at rest; plan it without a boundary.")
        # Imported here, as the inverse kinematics is compiled.
        from ampm.body.constant_posture import ConstantPosture
        from ampm.body.walk_motion import check_walk

        run, robot = request.run, request.robot
        asked = self.changes or self.stop is not None
        steps = self._requested(run, robot) if asked else plan_footstep_walk(run, robot.description)
        for angle in (SPREAD_ARMS, 2.0 * SPREAD_ARMS):
            spread = run.replace({"body.arm_abduction": max(run.body.arm_abduction, angle)})
            posture = ConstantPosture(steps, spread, robot, stops(steps.contacts))
            try:
                check_walk(steps, posture, spread, robot)
                break
            except BodilyRefusal as refusal:  # hands pass thighs on wide steps if they are spread further
                if refusal.reason != "arm_collision" or angle > SPREAD_ARMS:
                    raise
        return FootstepWalk.of(steps, posture=posture)

    def _requested(self, run: RunParameters, robot: Robot) -> StepPlan:
        """The walk with its requests."""
        live, since = LiveWalk.of(run, robot.description), 0.0
        earlier: StepPlan | None = None
        requests: list[tuple[float, Sequence[Footstep] | None]] = [*self.changes]
        requests += [] if self.stop is None else [(self.stop, None)]
        for at, footsteps in sorted(requests, key=lambda request: request[0]):
            if footsteps is None:
                live = live.stopped(at - since)
            elif not live.ends_before(at - since):
                live = live.changed(at - since, footsteps)
            else:
                earlier = live.steps if earlier is None else walk_again(earlier, live.steps, since)
                again = max(at, since + live.rests_from)
                live, since = live.again(footsteps), again
        return live.steps if earlier is None else walk_again(earlier, live.steps, since)


def planner_name(planner: Planner[WalkRequest]) -> str:
    """Name of a planner: its own, that in :data:`PLANNERS`, or that of its class."""
    kind: type = type(planner)
    named = next((name for name, known in PLANNERS.items() if known is kind), kind.__name__)
    return str(getattr(planner, "name", named))

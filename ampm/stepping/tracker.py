"""A walk's plan as the stabiliser that steps follows it, phase by phase.

On the plan nothing changes. Where the walk must leave it (:func:`ampm.stepping.walker.must_leave`), the plan
is read by its own clock from the next tick on, which may be late or early. Every foot has a shift from its
planned place. In single support the standing foot's shift moves everything, in double support from one to the
other; the swing foot's path moves to where the next step must be (:mod:`ampm.stepping.step_choice`).
"""

import bisect
import math
from typing import Any

import numpy as np

from ampm.body.robot import Robot
from ampm.compiled import bound, refer
from ampm.control.workspace import Curves, Stepper, SteppingState, Workspace, rows_of
from ampm.geometry import Array
from ampm.planner.contacts import Contacts, Phase
from ampm.reference import Timing, reference_type
from ampm.stepping.floor import SINK
from ampm.stepping.walker import OFF_HEIGHT, pass_time
from ampm.walk import WalkPlan

_TICKS = 2  # ticks between two rows of a phase's table
_COARSE = 25  # instants of a phase's curves while the walk is on the plan
CYCLE = 4
"""Phases after which a periodic walk repeats."""
BACK = 0.005  # distance from the plan within which a walk is on it again [m]
STILL = 0.05
"""Speed up to which a COM is at rest [m/s]."""


def walks_on(contacts: Contacts, com_velocity: Array) -> bool:
    """Whether the COM still moves at a plan's end, after which the plan's last cycle is then repeated."""
    return bool(np.abs(com_velocity).max() > STILL) and len(contacts.phases) > CYCLE


def repeated(contacts: Contacts, index: Any, goes_on: bool) -> tuple[Any, Array]:
    """Phases of the plan that phases ``index``, shape (...), repeat, and the way from there (..., 3) [m]."""
    phases, placements = len(contacts.phases), contacts.placements[:, 0]
    if not goes_on:
        return np.minimum(index, phases - 1), np.zeros((*np.shape(index), 3))
    cycles = np.maximum(index - phases, -1) // CYCLE + 1
    way = np.multiply.outer(cycles, placements[-1] - placements[-1 - CYCLE])
    way[..., 2] += way[..., :2] @ contacts.slope
    return np.maximum(index - CYCLE * cycles, 0), way


class StepTracker:
    """The Python part of the stepping stabiliser: which phase it is, and the phase's tables.

    The plan is sampled when it is handed over, and not later. After the end of a plan that walks on, its last
    two steps are repeated.

    Args:
        plan: of the walk.
        timing: look-ahead of the references.
        robot: the body, as the controller knows it.
        workspace: of the controller; its stepping state is reset.

    Attributes:
        stepped: state of this tick off the plan, before the body's was sensed; None on the plan.
    """

    stepped: SteppingState | None = None

    def __init__(self, plan: WalkPlan, timing: Timing, robot: Robot, workspace: Workspace) -> None:
        self.plan, self._timing, self._workspace = plan, timing, workspace
        self._state: SteppingState = workspace.stepping.view(np.recarray)[0]
        self._reset()
        self._state.force_factor = 1.0
        self._stepper = Stepper(
            omega=math.sqrt(workspace.body.gravity / plan.com_height),
            tick=1.0 / workspace.gains.frequency,
            size=robot.description.scale,
            foot_width=2.0 * robot.description.sole.half_width,
            slope=np.array(plan.contacts.slope),
            curves=Curves(np.zeros((2, 2)), np.zeros((2, 2)), np.zeros((2, 2))),
            table=rows_of(np.zeros(2, reference_type(robot.nq, robot.nv))),
        )
        # Views, as reading a field of one entry takes longer.
        states = workspace.stepping
        self._leaves, self._off_plan, self._clock = states["leaves"], states["off_plan"], states["clock"]
        self._pass_time = bound(pass_time, (states, self._stepper.tick))
        self._index, self._loaded, self._next = -1, -1, -math.inf
        self._starts = [*plan.contacts.starts.tolist(), math.inf]
        end = plan.sample(np.array([plan.duration]))
        self._goes_on = walks_on(plan.contacts, end.com_velocity)
        self._coarse = self._coarse_curves()
        self._tables = [self._table(phase) for phase in plan.contacts.phases]

    def begin(self, time: float) -> Any:
        """Go to the phase of the tick at a time [s]; return a reference to its :class:`Stepper`."""
        if self._leaves[0]:
            self._leave()
        if self._off_plan[0]:
            may_switch = self._goes_on or self._index + 1 < len(self.plan.contacts.phases)
            if self._pass_time() and may_switch:
                self._switch()
                if self._is_back():
                    self._return()
        if self._off_plan[0]:
            if self._loaded != self._index:
                self._load()
            self._state.time, self._state.phase = time, self._index
            self.stepped = self._workspace.stepping[0].copy()
        else:
            self.stepped = None
            if time + 1e-9 >= self._next:
                self._enter(max(bisect.bisect_right(self._starts, time + 1e-9) - 1, 0))
            self._clock[0] = time - self._starts[self._index]
        return self._handle

    def _phase(self, index: int) -> Phase:
        return self.plan.contacts.phases[repeated(self.plan.contacts, index, self._goes_on)[0]]

    def _reset(self) -> None:
        """Set the state to that of a walk on the plan, but keep the floor's height."""
        floor = self._state.floor
        self._workspace.stepping[:] = 0
        self._state.floor, self._state.rate, self._state.factor, self._state.choice = floor, 1.0, 1.0, -1

    def _enter(self, index: int) -> None:
        """Set the state to the begin of a phase."""
        state, phase, following = self._state, self._phase(index), self._phase(index + 1)
        state.single = phase.kind == "single_support"
        if state.single:
            state.stance = phase.left is None
        elif index:  # the foot that stood before leaves next
            state.stance = self._phase(index - 1).left is None
        else:
            state.stance = following.left is not None
        state.duration = phase.duration
        state.double = following.duration if following.kind == "double_support" else phase.duration
        state.stood, state.waited = 0.0, 0.0
        self._index = index
        if not state.off_plan:
            self._next = self._starts[index + 1]
            self._use(self._coarse[index])
            left, right = self.plan.contacts.placements[index]
            x, y, _ = left - right
            heading = self.plan.contacts.headings[index]
            state.width = abs(math.cos(heading) * y - math.sin(heading) * x)

    def _coarse_curves(self) -> list[Curves]:
        """Curves of all phases of the plan, on a coarse grid."""
        phases = self.plan.contacts.phases
        sample = self.plan.sample(np.concatenate([self._grid(phase, _COARSE) for phase in phases]))
        curves = self._curves(sample.com, sample.com_velocity, sample.com_acceleration, sample.moment)
        by_phase = (np.split(curve, len(phases)) for curve in curves)
        return [Curves(*parts) for parts in zip(*by_phase, strict=True)]

    def _grid(self, phase: Phase, count: int) -> Array:
        """Equal intervals of a phase, the ends just within it, shape (count,) [s]."""
        grid = phase.start + 1e-9 + (phase.duration - 2e-9) * np.linspace(0.0, 1.0, count)
        return np.asarray(np.minimum(grid, self.plan.duration))

    def _curves(self, com: Array, velocity: Array, acceleration: Array, moment: Array) -> Curves:
        """Horizontal curves of a plan's centroidal motion; heights count from the plan's floor."""
        body, slope = self._workspace.body, self.plan.contacts.slope
        height, rate = (item[:, 2] - item[:, :2] @ slope for item in (com, acceleration))
        down = body.gravity + rate[:, None]
        r = com[:, :2] - height[:, None] / down * acceleration[:, :2]
        arm = np.stack([-moment[:, 1], moment[:, 0]], axis=1) / (body.mass * down)
        curves = r, com[:, :2] + velocity[:, :2] / self._stepper.omega, r + arm
        return Curves(*(np.ascontiguousarray(curve) for curve in curves))

    def _use(self, curves: Curves, table: Any = None) -> None:
        """Give curves, and off the plan a table, to the compiled functions."""
        self._stepper = self._stepper._replace(curves=curves, table=table or self._stepper.table)
        self._handle = refer(self._stepper)

    def _table(self, phase: Phase) -> Any:
        """Rows of references at equal intervals of a phase."""
        count = max(math.ceil(phase.duration / (_TICKS * self._stepper.tick)), 4) + 1
        return self.plan.table(self._grid(phase, count), self._timing).row

    def _load(self) -> None:
        """Give table and curves of the present phase to the compiled functions."""
        source, offset = repeated(self.plan.contacts, self._index, self._goes_on)
        table = rows_of(self._tables[source].copy())
        table.com[:] += offset
        table.foot_position[:] += offset
        self._use(self._curves(table.com, table.com_velocity, table.com_acceleration, table.moment), table)
        self._loaded = self._index

    def _leave(self) -> None:
        """Leave the plan; the shift of a foot that stands is measured, small ones count as zero."""
        state, body = self._state, self._workspace.body
        state.leaves, state.off_plan = False, True
        for foot in range(2):
            if state.touches[foot] > 1 and not (state.single and foot != state.stance):
                shift = body.com + body.feet["place"][foot] - self._workspace.wanted.foot_position[foot]
                shift[2] += SINK
                shift[:2] *= np.hypot(shift[0], shift[1]) > 0.01
                shift[2] *= abs(shift[2]) > OFF_HEIGHT
                state.shift[foot] = shift
        state.swing[0] = state.shift[1 - state.stance]

    def _is_back(self) -> bool:
        """Whether a walk that begins a phase is on the plan again; then it is followed by the time."""
        state = self._state
        timely = state.single and abs(state.late) < self._stepper.tick and self._index < len(self._starts) - 1
        in_place = np.abs(state.shift).max(axis=0) < (BACK, BACK, OFF_HEIGHT)
        level = max(abs(state.height[0]), 0.1 * np.abs(state.slope).max()) < OFF_HEIGHT
        return bool(timely and level and in_place.all() and state.away < BACK)

    def _return(self) -> None:
        """Follow the plan again."""
        force_factor, touches = self._state.force_factor, self._state.touches.copy()
        self._reset()
        self._state.force_factor, self._state.touches[:] = force_factor, touches
        self._next = -math.inf

    def _switch(self) -> None:
        """Go on to the next phase."""
        state = self._state
        over = state.clock - state.duration
        if state.single:  # until it is measured, the foot is where it was sent
            state.shift[1 - state.stance] = state.swing[0]
        self._enter(self._index + 1)
        state.clock = min(max(over, 0.0), 0.25 * state.duration)
        state.late += over - state.clock
        state.step[:], state.factor, state.choice = 0.0, 1.0, -1
        if state.single:
            state.swing[:] = 0.0
            state.swing[0] = state.shift[1 - state.stance]

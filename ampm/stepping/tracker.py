"""A walk's plan as the stabiliser that steps follows it, phase by phase.

On the plan nothing changes. Where the walk must leave it (:func:`ampm.stepping.walker.update_reference`), the
plan is read by its own clock from the next tick on, which may be late or early, and moves with the feet
(:mod:`ampm.stepping.phases`); the swing foot goes to where the next step must be
(:mod:`ampm.stepping.step_choice`).
"""

import bisect
import math
from typing import Any

import numpy as np

from ampm.body.robot import Robot
from ampm.compiled import bound, refer
from ampm.control.workspace import Curves, Stepper, SteppingState, Workspace, rows_of
from ampm.geometry import Array
from ampm.planner.contacts import Phase
from ampm.reference import Timing, reference_type
from ampm.stepping.phases import Phases, begin_phase, repeated
from ampm.stepping.sensed_floor import LEVEL_SLOPE, SINK
from ampm.stepping.walker import OFF_HEIGHT, pass_time
from ampm.walk import WalkPlan

_TICKS = 2  # ticks between two rows of a phase's table
_COARSE = 25  # instants of a phase's curves while the walk is on the plan
BACK = 0.005  # distance from the plan within which a walk is on it again [m]


class StepTracker:
    """The Python part of the stepping stabiliser: which phase it is, and the phase's tables.

    The plan is sampled when it is handed over, and not later.

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
        self._state.force_factor, self._state.touch_ticks[:] = 1.0, 0.0
        self._stepper = Stepper(
            omega=math.sqrt(workspace.body.gravity / plan.com_height),
            tick=1.0 / workspace.gains.frequency,
            size=robot.description.scale,
            foot_width=2.0 * robot.description.sole.half_width,
            plan_slope=np.array(plan.contacts.slope),
            curves=Curves(np.zeros((2, 2)), np.zeros((2, 2)), np.zeros((2, 2))),
            table=rows_of(np.zeros(2, reference_type(robot.nq, robot.nv))),
        )
        # Views, as reading a field of one entry takes longer.
        states = workspace.stepping
        names = ("leaving", "off_plan", "phase", "clock")
        self._leaving, self._off_plan, self._phase, self._clock = (states[name] for name in names)
        self._pass_time = bound(pass_time, (states, self._stepper.tick))
        self._starts = [*plan.contacts.starts.tolist(), math.inf]
        self._phases = Phases.of(plan.contacts, plan.sample(np.array([plan.duration])).com_velocity)
        phases = plan.contacts.phases
        self._coarse = [self._curves(plan.sample(self._grid(phase, _COARSE))) for phase in phases]
        self._tables = [self._table(phase) for phase in phases]

    def begin(self, time: float) -> Any:
        """Go to the phase of the tick at a time [s]; return a reference to its :class:`Stepper`."""
        if self._leaving[0]:
            self._leave()
        if self._off_plan[0]:
            may_switch = self._phases.walks_on or self._phase[0] + 2 < len(self._starts)
            if self._pass_time() and may_switch:
                self._switch()
                if self._is_back():
                    self._reset()
        if self._off_plan[0]:
            self._state.time = time
            self.stepped = self._workspace.stepping[0].copy()
        else:
            self.stepped = None
            if time + 1e-9 >= self._next:
                self._enter(max(bisect.bisect_right(self._starts, time + 1e-9) - 1, 0))
            self._clock[0] = time - self._starts[self._phase[0]]
        return self._handle

    def _reset(self) -> None:
        """Set the state to that of a walk on the plan, but keep what was found of the floor."""
        state = self._state
        rise, force_factor, touches = state.floor_rise, state.force_factor, state.touch_ticks.copy()
        self._workspace.stepping[:] = 0
        state.floor_rise, state.force_factor, state.touch_ticks[:] = rise, force_factor, touches
        state.clock_rate, state.stretch, state.choice, state.level_slope = 1.0, 1.0, -1, LEVEL_SLOPE
        self._next = -math.inf

    def _enter(self, index: int) -> None:
        """Begin a phase on the plan."""
        contacts = self.plan.contacts
        begin_phase(self._state, self._phases, index)
        self._next = self._starts[index + 1]
        self._use(self._coarse[index])
        x, y, _ = contacts.placements[index, 0] - contacts.placements[index, 1]
        heading = contacts.headings[index]
        self._state.width = abs(math.cos(heading) * y - math.sin(heading) * x)

    def _grid(self, phase: Phase, count: int) -> Array:
        """Equal intervals of a phase, the ends just within it, shape (count,) [s]."""
        grid = phase.start + 1e-9 + (phase.duration - 2e-9) * np.linspace(0.0, 1.0, count)
        return np.asarray(np.minimum(grid, self.plan.duration))

    def _curves(self, motion: Any) -> Curves:
        """Horizontal curves of a sample or table of the plan; heights count from the plan's floor."""
        body, slope = self._workspace.body, self.plan.contacts.slope
        com, acceleration, moment = motion.com, motion.com_acceleration, motion.moment
        height, rate = (item[:, 2] - item[:, :2] @ slope for item in (com, acceleration))
        down = body.gravity + rate[:, None]
        r = com[:, :2] - height[:, None] / down * acceleration[:, :2]
        arm = np.stack([-moment[:, 1], moment[:, 0]], axis=1) / (body.mass * down)
        return Curves(r, com[:, :2] + motion.com_velocity[:, :2] / self._stepper.omega, r + arm)

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
        source, strides = repeated(self._phases, self._state.phase)
        table = rows_of(self._tables[source].copy())
        table.com[:] += strides * self._phases.stride
        table.foot_position[:] += strides * self._phases.stride
        self._use(self._curves(table), table)

    def _leave(self) -> None:
        """Leave the plan; the shift of a foot that stands is measured, small ones count as zero."""
        state, body = self._state, self._workspace.body
        state.leaving, state.off_plan = False, True
        for foot in range(2):
            if state.touch_ticks[foot] > 1 and not (state.single and foot != state.stance):
                shift = body.com + body.feet["place"][foot] - self._workspace.wanted.foot_position[foot]
                shift[2] += SINK
                shift[:2] *= np.hypot(shift[0], shift[1]) > 0.01
                shift[2] *= abs(shift[2]) > OFF_HEIGHT
                state.shift[foot] = shift
        state.swing[0] = state.shift[1 - state.stance]
        self._load()

    def _is_back(self) -> bool:
        """Whether a walk that begins a phase is on the plan again; then it is followed by the time."""
        state = self._state
        timely = state.single and abs(state.delay) < self._stepper.tick
        planned = state.phase < len(self._starts) - 1
        in_place = np.abs(state.shift).max(axis=0) < (BACK, BACK, OFF_HEIGHT)
        level = max(abs(state.height[0]), 0.1 * np.abs(state.slope).max()) < OFF_HEIGHT
        return bool(timely and planned and level and in_place.all() and state.com_error < BACK)

    def _switch(self) -> None:
        """Go on to the next phase off the plan."""
        state = self._state
        over = state.clock - state.duration
        begin_phase(state, self._phases, state.phase + 1)
        state.clock = min(max(over, 0.0), 0.25 * state.duration)
        state.delay += over - state.clock
        self._load()

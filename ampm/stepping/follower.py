"""A walk's plan as the stabiliser that steps follows it, phase by phase.

On the plan nothing changes. Where the walk must leave it (:func:`ampm.stepping.walker.follow`), the plan is
read by its own clock from the next tick on, which may be late or early. Every foot has a shift from its
planned place. In single support the standing foot's shift moves everything, in double support from one to the
other; the swing foot's path moves to where the next step must be (:mod:`ampm.stepping.step_choice`).
"""

import bisect
import math
from typing import Any, NamedTuple

import numpy as np

from ampm.body.robot import Robot
from ampm.compiled import bound, records, refer
from ampm.control.workspace import Array, Wanted, Workspace, rows_of
from ampm.planner.contacts import Phase
from ampm.reference import Reference, Timing, reference_type
from ampm.stepping.floor import SINK
from ampm.stepping.stepper import WALKER, Curves, Stepper
from ampm.stepping.walker import OFF_HEIGHT, pass_time
from ampm.walk import WalkPlan

_TICKS = 2  # between the rows of a phase's table
_COARSE = 25  # instants of a phase at which a walk on the plan looks ahead
CYCLE = 4
"""Phases after which a periodic walk repeats."""
BACK = 0.005  # distance from the plan within which a walk is on it again [m]
STILL = 0.05
"""Speed up to which a COM is at rest [m/s]."""


class SteppedTick(NamedTuple):
    """State of a walk off its plan, before the state of this tick is sensed.

    Attributes:
        time: on the walk's clock [s].
        phase: its number in the plan; after its end the numbers go on.
        walker: entry of :data:`~ampm.stepping.stepper.WALKER`.
    """

    time: float
    phase: int
    walker: Any


def make_stepper(robot: Robot, c: Workspace, omega: float) -> Stepper:
    """A stepper without a phase.

    Args:
        robot: the body, as the controller knows it.
        c: of the controller.
        omega: of the pendulum [1/s].
    """
    walker = records(1, WALKER)
    walker["rate"] = walker["factor"] = walker["load"] = 1.0
    walker["choice"] = -1
    return Stepper(
        walker=walker,
        body=c.body,
        contact=c.sensed.contact,
        rates=c.tasks.rates,
        omega=omega,
        tick=1.0 / c.gains.frequency,
        size=robot.description.scale,
        foot_width=2.0 * robot.description.sole.half_width,
        curves=Curves(np.zeros((2, 2)), np.zeros((2, 2)), np.zeros((2, 2))),
        table=rows_of(np.zeros(2, reference_type(robot.nq, robot.nv))),
    )


class Follower:
    """The Python part of the stepping stabiliser: which phase it is, and the phase's tables.

    The plan is sampled when it is handed over, and not later. After the end of a plan that walks on, its last
    two steps are repeated.

    Args:
        plan: of the walk.
        timing: look-ahead of the references.
        robot: the body, as the controller knows it.
        c: of the controller.

    Attributes:
        stepped: state of this tick off the plan, before the body's was sensed; None on the plan.
    """

    stepped: SteppedTick | None = None

    def __init__(self, plan: WalkPlan, timing: Timing, robot: Robot, c: Workspace) -> None:
        self.plan, self._timing, self._c = plan, timing, c
        self._stepper = stepper = make_stepper(robot, c, math.sqrt(c.body.gravity / plan.com_height))
        self._walker, self._stepping = stepper.walker, c.stepping
        self._leaves, self._off_plan = self._walker["leaves"], self._stepping["off_plan"]
        self._clock = self._walker["clock"]
        self._stepping["force_factor"] = 1.0
        self._stepping["off_plan"] = self._stepping["com_first"] = False
        self._pass_time = bound(pass_time, (self._walker, stepper.tick))
        self._index, self._loaded, self._next = -1, -1, -math.inf
        self._starts = [*plan.contacts.starts.tolist(), math.inf]
        end = plan.sample(np.array([plan.duration])).com_velocity
        placements = plan.contacts.placements
        self._across, self._headings = placements[:, 0] - placements[:, 1], plan.contacts.headings
        self._goes_on = bool(np.abs(end).max() > STILL) and len(plan.contacts.phases) > CYCLE
        self._ahead = self._look_ahead()
        self._tables = [self._table(phase) for phase in plan.contacts.phases]
        self.handle = refer(self._stepper)

    def begin(self, time: float, reference: Reference) -> Any:
        """Go to the phase of a tick, before it.

        Args:
            time: [s].
            reference: the plan's of this tick.

        Returns:
            Reference to the :class:`~ampm.stepping.stepper.Stepper` of this phase.
        """
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
            self.stepped = SteppedTick(time, self._index, self._walker[0].copy())
        else:
            self.stepped = None
            if time + 1e-9 >= self._next:
                self._enter(max(bisect.bisect_right(self._starts, time + 1e-9) - 1, 0))
            self._clock[0] = time - self._starts[self._index]
        return self.handle

    # ------------------------------------------------------------------ parts

    def _source(self, index: int) -> tuple[int, Array]:
        """Phase of the plan that is walked, and how far it is repeated after its end, shape (2,) [m]."""
        contacts = self.plan.contacts
        again = max(index - len(contacts.phases), -1) // CYCLE + 1
        if not (again and self._goes_on):
            return min(index, len(contacts.phases) - 1), np.zeros(2)
        return max(index - CYCLE * again, 0), again * (
            contacts.placements[-1, 0, :2] - contacts.placements[-1 - CYCLE, 0, :2]
        )

    def _phase(self, index: int) -> Phase:
        return self.plan.contacts.phases[self._source(index)[0]]

    def _enter(self, index: int) -> None:
        """Begin a phase."""
        w, phase, following = self._walker[0], self._phase(index), self._phase(index + 1)
        w["single"] = phase.kind == "single_support"
        if w["single"]:
            w["stance"] = phase.left is None
        elif index:  # the foot that stood before leaves next
            w["stance"] = self._phase(index - 1).left is None
        else:
            w["stance"] = following.left is not None
        w["duration"] = phase.duration
        w["double"] = following.duration if following.kind == "double_support" else phase.duration
        w["stood"], w["waited"] = 0.0, 0.0
        self._index = index
        if not self._off_plan[0]:
            self._next = self._starts[index + 1]
            self._take(self._ahead[index])
            x, y, _ = self._across[index]
            heading = self._headings[index]
            w["width"] = abs(math.cos(heading) * y - math.sin(heading) * x)

    def _look_ahead(self) -> list[Curves]:
        """Curves of the plan's phases."""
        phases = self.plan.contacts.phases
        grids = np.concatenate([self._grid(phase, _COARSE) for phase in phases])
        sample = self.plan.sample(grids)
        curves = self._curves(sample.com, sample.com_velocity, sample.com_acceleration, sample.moment)
        parts = [range(k * _COARSE, (k + 1) * _COARSE) for k in range(len(phases))]
        return [Curves(*(curve[part.start : part.stop] for curve in curves)) for part in parts]

    def _grid(self, phase: Phase, count: int) -> Array:
        """Instants of a phase, at its ends just within it, shape (count,) [s]."""
        grid = phase.start + 1e-9 + (phase.duration - 2e-9) * np.linspace(0.0, 1.0, count)
        return np.asarray(np.minimum(grid, self.plan.duration))

    def _curves(self, com: Array, velocity: Array, acceleration: Array, moment: Array) -> Curves:
        """Horizontal curves of a plan's centroidal motion."""
        mass, gravity = self._c.body.mass, self._c.body.gravity
        down = gravity + acceleration[:, 2:]
        r = com[:, :2] - com[:, 2:] / down * acceleration[:, :2]
        arm = np.stack([-moment[:, 1], moment[:, 0]], axis=1) / (mass * down)
        curves = r, com[:, :2] + velocity[:, :2] / self._stepper.omega, r + arm
        return Curves(*(np.ascontiguousarray(curve) for curve in curves))

    def _take(self, curves: Curves, table: Wanted | None = None) -> None:
        """Give curves, and off the plan the table, to the compiled functions."""
        self._stepper = self._stepper._replace(curves=curves, table=table or self._stepper.table)
        self.handle = refer(self._stepper)

    def _table(self, phase: Phase) -> Any:
        """Rows of references at equal intervals of a phase."""
        count = max(math.ceil(phase.duration / (_TICKS * self._stepper.tick)), 4) + 1
        return self.plan.table(self._grid(phase, count), self._timing).row

    def _load(self) -> None:
        """Tables of the present phase."""
        source, offset = self._source(self._index)
        rows = rows_of(self._tables[source])
        rows.com[:, :2] += offset
        rows.foot_position[:, :, :2] += offset
        self._take(self._curves(rows.com, rows.com_velocity, rows.com_acceleration, rows.moment), rows)
        self._loaded = self._index

    def _leave(self) -> None:
        """Leave the plan: the shift of a foot that stands is measured if it matters."""
        w, body = self._walker[0], self._c.body
        w["leaves"], self._stepping["off_plan"] = False, True
        for foot in range(2):
            if w["touches"][foot] > 1 and not (w["single"] and foot != w["stance"]):
                off = body.com + body.feet["place"][foot] - self._c.wanted.foot_position[foot]
                off[2] += SINK
                off[:2] *= np.hypot(off[0], off[1]) > 0.01
                off[2] *= abs(off[2]) > OFF_HEIGHT
                w["shift"][foot] = off
        w["swing"][0] = w["shift"][1 - w["stance"]]

    def _is_back(self) -> bool:
        """Whether a walk that begins a phase is on the plan again; then it is followed by the time."""
        w = self._walker[0]
        on_time = w["single"] and abs(w["late"]) < self._stepper.tick and self._index < len(self._starts) - 1
        in_place = np.abs(w["shift"]).max(axis=0) < (BACK, BACK, OFF_HEIGHT)
        level = max(abs(w["height"][0]), 0.1 * np.abs(w["slope"]).max()) < OFF_HEIGHT
        return bool(on_time and level and in_place.all() and w["away"] < BACK)

    def _return(self) -> None:
        """Follow the plan again."""
        w = self._walker
        load, touches = float(w["load"][0]), w["touches"].copy()
        w[:] = 0
        w["load"], w["touches"], w["rate"], w["factor"], w["choice"] = load, touches, 1.0, 1.0, -1
        self._next = -math.inf
        self._stepping["com_first"], self._stepping["off_plan"] = False, False

    def _switch(self) -> None:
        """Go on to the next phase."""
        w = self._walker[0]
        over = w["clock"] - w["duration"]
        if w["single"]:  # until it is measured, the foot is where it was sent
            w["shift"][1 - w["stance"]] = w["swing"][0]
        self._enter(self._index + 1)
        w["clock"] = min(max(over, 0.0), 0.25 * w["duration"])
        w["late"] += over - w["clock"]
        w["step"], w["factor"], w["excess"], w["choice"] = 0.0, 1.0, 0.0, -1
        if w["single"]:
            w["swing"] = 0.0
            w["swing"][0] = w["shift"][1 - w["stance"]]

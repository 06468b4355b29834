"""The reference of a walk that steps where and when it must: by phase, from the foot that stands.

A plan is read by its own clock. Undisturbed, that is the time, and the controller gets the plan's reference
itself. As soon as the sole cannot hold the DCM until the next switch, or a foot stands elsewhere, earlier or
later than planned, the clock runs at its own rate, and every foot carries a shift: where it stands less
where it was planned. COM and ZMP move with the shift of the foot that stands, in double support from one to
the other; the swing foot's path moves to where the next step must be (:mod:`ampm.control.stepping`).
"""

import bisect
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ampm.compiled import bound, records
from ampm.control.floor import SINK, Sensed
from ampm.control.stepping import Curves
from ampm.control.walker import OFF_HEIGHT, WALKER, Rows, advance, departs, pass_time
from ampm.planner.contacts import Phase
from ampm.walk import ContactState, FeetState, PostureState, Reference, Timing, WalkPlan

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_TICKS = 2  # between the rows of a table
_COARSE = 25  # instants of a phase at which a walk on the plan looks ahead
_CYCLE = 4  # phases after which a periodic walk repeats
BACK = 0.005  # distance from the plan within which a walk is on it again [m]
_STILL = 0.05  # speed of a COM at rest [m/s]


class LiveReference:
    """A plan as a controller follows it.

    After the end of a plan that walks on, its last two steps are repeated.

    Args:
        plan: of the walk.
        timing: look-ahead of the references.
        feet: records of both feet, whose places and poses the controller keeps.
        points: records of the sole points.
        touching: whether they touch, kept by the controller, shape (P,).
        com: measured, likewise, shape (3,) [m].
        rates: momentum and angular momentum over the mass, likewise, shape (6, ...).
        mass: of the body [kg].
        gravity: [m/s^2].
        tick: control period [s].
        size: of the body, of which a stature of 1.70 m is one [1].
        foot_width: [m].
        share: written at every tick: axes of the standing foot (cos, sin), height of the floor [m], whether
            the COM comes first, the factor of the force that holds the COM's height, whether the walk is off
            the plan [1];
            see :func:`~ampm.control.sole.share_sole`.

    Attributes:
        live: whether the walk has left the plan.
    """

    def __init__(
        self, plan: WalkPlan, timing: Timing, feet: Any, points: Any, touching: Flags, com: Array,
        rates: Array, mass: float, gravity: float, tick: float, size: float,
        foot_width: float, share: Array,
    ) -> None:  # fmt: skip
        self.plan, self._timing = plan, timing
        omega = math.sqrt(gravity / plan.com_height)
        self._body = Sensed(feet, points, touching, com, rates, mass, omega, gravity, tick, size, foot_width)
        self._walker = records(1, WALKER)
        for name in ("rate", "factor", "load"):
            self._walker[name] = 1.0
        self._walker["choice"] = -1
        self._index, self._loaded, self._width, self._next = -1, -1, 0.0, -math.inf
        self._starts = [*plan.contacts.starts.tolist(), math.inf]
        self._origin = np.full(2, math.nan)  # of the references from the plan: a walk may be moved
        end = plan.sample(np.array([plan.duration])).com_velocity
        self._goes_on = bool(np.abs(end).max() > _STILL) and len(plan.contacts.phases) > _CYCLE
        self.live, self._share = False, share
        share[4], share[5] = 1.0, 0.0
        self._own = self._walker, self._body, share
        curves = Curves(*np.zeros((3, 2, 2)))
        self._departs = bound(
            departs, self._own, 0.0, curves, 0.0, np.zeros((5, 3)), np.zeros((len(feet), 27))
        )

    def reference(self, time: float, given: Reference) -> Reference:
        """The reference of this tick.

        Args:
            time: [s].
            given: the plan's own reference of this time, returned as long as the walk is on the plan.
        """
        if math.isnan(self._origin[0]):
            moved = given.centre[0, :2] - self.plan.sample(np.array([time])).com[0, :2]
            self._origin = moved * (np.abs(moved) > 1e-9)
        if self.live:
            ends = self._pass_time()
            if ends and (self._goes_on or self._index + 1 < len(self.plan.contacts.phases)):
                self._switch()
                self.live = not self._is_back(given)
        felt = not self.live
        if felt:
            if time + 1e-9 >= self._next:
                self._enter(max(bisect.bisect_right(self._starts, time + 1e-9) - 1, 0))
            clock = time - self._starts[self._index]
            planned = [np.ascontiguousarray(v, np.float64) for v in (given.centre, given.feet.values)]
            if not self._departs(clock, self._coarse, self._width, *planned):
                return given
            self.live = True
            self._share[5] = 1.0
            self._depart(given)
        if self._loaded != self._index:
            self._load()
        row = self._row()
        self._advance(felt, self._curves, self._table, row)
        return Reference(
            time,
            row.centre,
            float(row.right_load[0]),
            False,
            FeetState(row.feet),
            ContactState(row.planned, row.due, row.until_lift),
            PostureState(
                row.q, row.v, row.acceleration, row.trunk, row.centre[3, 2], given.posture.tilt_window
            ),
        )

    # ------------------------------------------------------------------ parts

    def _phase(self, index: int) -> tuple[Phase, Array]:
        """A phase, and how far it is repeated after the plan's end, shape (2,) [m]."""
        contacts = self.plan.contacts
        again = max(index - len(contacts.phases), -1) // _CYCLE + 1
        source = max(index - _CYCLE * again, 0)
        if not (again and self._goes_on):
            return contacts.phases[min(index, len(contacts.phases) - 1)], np.zeros(2)
        return contacts.phases[source], again * (
            contacts.placements[-1, 0, :2] - contacts.placements[-1 - _CYCLE, 0, :2]
        )

    def _enter(self, index: int) -> None:
        """Begin a phase."""
        w, (phase, _), (following, _) = self._walker[0], self._phase(index), self._phase(index + 1)
        w["single"] = phase.kind == "single_support"
        if w["single"]:
            w["stance"] = phase.left is None
        elif index:  # the foot that stood before leaves next
            w["stance"] = self._phase(index - 1)[0].left is None
        else:
            w["stance"] = following.left is not None
        w["duration"] = phase.duration
        w["double"] = following.duration if following.kind == "double_support" else phase.duration
        w["stood"], w["waited"] = 0.0, 0.0
        self._index = index
        if not self.live:
            self._next = self._starts[index + 1]
            sample = self.plan.sample(self._grid(phase, _COARSE))
            com = sample.com.copy()
            com[:, :2] += self._origin
            self._coarse = self._curves_of(com, sample.com_velocity, sample.com_acceleration, sample.moment)
            left, right = self.plan.contacts.placements[index, :, :2]
            heading = self.plan.contacts.headings[index]
            self._width = abs(math.cos(heading) * (left - right)[1] - math.sin(heading) * (left - right)[0])

    def _grid(self, phase: Phase, count: int) -> Array:
        """Instants of a phase, at its ends just within it, shape (count,) [s]."""
        grid = phase.start + 1e-9 + (phase.duration - 2e-9) * np.linspace(0.0, 1.0, count)
        return np.asarray(np.minimum(grid, self.plan.duration))

    def _curves_of(self, com: Array, velocity: Array, acceleration: Array, moment: Array) -> Curves:
        """Horizontal curves of a plan's centroidal motion."""
        body = self._body
        down = body.gravity + acceleration[:, 2:]
        r = com[:, :2] - com[:, 2:] / down * acceleration[:, :2]
        arm = np.stack([-moment[:, 1], moment[:, 0]], axis=1) / (body.mass * down)
        curves = r, com[:, :2] + velocity[:, :2] / body.omega, r + arm
        return Curves(*(np.ascontiguousarray(curve) for curve in curves))

    def _row(self) -> Rows:
        """Room for one row of the table."""
        parts: Any = [np.empty(shape, kind) for shape, kind in self._parts]
        return Rows(*parts)

    def _load(self) -> None:
        """Tables of the present phase."""
        phase, offset = self._phase(self._index)
        count = max(math.ceil(phase.duration / (_TICKS * self._body.tick)), 4) + 1
        rows = self.plan.table(self._grid(phase, count), self._timing).rows
        centre, feet = rows.centre.copy(), rows.feet.values.copy()
        offset = offset + self._origin
        centre[:, 0, :2] += offset
        feet[:, :, :2] += offset
        self._curves = self._curves_of(centre[:, 0], centre[:, 1], centre[:, 2], centre[:, 4])
        parts = centre, np.asarray(rows.right_load), feet, *rows.contacts, *rows.posture[:4]
        self._table = Rows(*(np.array(part, order="C") for part in parts))
        self._parts = [(part.shape[1:] or (1,), part.dtype) for part in self._table]
        if self._loaded < 0:
            self._advance = bound(advance, self._own, True, self._curves, self._table, self._row())
            self._pass_time = bound(pass_time, (self._walker, self._body.tick))
        self._loaded = self._index

    def _depart(self, given: Reference) -> None:
        """Leave the plan: the shift of a foot that stands is measured if it matters."""
        w, body = self._walker[0], self._body
        for foot in range(2):
            if w["touches"][foot] > 1 and not (w["single"] and foot != w["stance"]):
                off = body.com + body.feet["place"][foot] - given.feet.values[foot, 0:3]
                off[2] += SINK
                off[:2] *= np.hypot(off[0], off[1]) > 0.01
                off[2] *= abs(off[2]) > OFF_HEIGHT
                w["shift"][foot] = off
        w["swing"][0] = w["shift"][1 - w["stance"]]

    def _is_back(self, given: Reference) -> bool:
        """Whether a walk that begins a phase is on the plan again; then it is followed by the time."""
        w, off = self._walker[0], np.abs(self._body.com - given.centre[0])
        on_time = w["single"] and abs(w["late"]) < self._body.tick and self._index < len(self._starts) - 1
        in_place = np.abs(w["shift"]).max(axis=0) < (BACK, BACK, OFF_HEIGHT)
        level = max(abs(w["height"][0]), 0.1 * np.abs(w["slope"]).max()) < OFF_HEIGHT
        if not (on_time and level and in_place.all() and off.max() < BACK):
            return False
        load, touches = float(w["load"]), w["touches"].copy()
        self._walker[:] = 0
        w["load"], w["touches"], w["rate"], w["factor"], w["choice"] = load, touches, 1.0, 1.0, -1
        self._next, self._share[3], self._share[5] = -math.inf, 0.0, 0.0
        return True

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

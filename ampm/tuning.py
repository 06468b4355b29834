"""The free choices of a gait, found by an optimiser on plan and inverse kinematics alone.

The paper fixes a gait by step, speed, c_s and c_y and leaves the rest to be "set manually": how much of the
step is single support, how far the ZMP rolls under the foot, how high the COM is, when and how far the feet
turn, how the trunk leans. Here these are unknowns of a nonlinear least-squares problem. Every limit of body
and floor has a normalised margin: 0 where the limit is met exactly, 1 where it is comfortably far. What is
missing to 1 is a residual, and so is, weakly, the distance to a closed-form guess, which makes the answer
unique where nothing binds. Plan, feet, the periodic step of the inverse kinematics on a coarse grid, and the
joint torques of that step under the planned ground force are all that is looked at: no simulation.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import least_squares

from ampm.exceptions import BodilyRefusal, InputError, RefusedGait
from ampm.feasibility import check_body
from ampm.free_choices import FREE_KEYS, FreeChoices, named_keys
from ampm.gait import GaitPlan, plan_gait
from ampm.gait_limits import LIMITS, orbit_margins, plan_margins
from ampm.inverse_kinematics import Unreachable
from ampm.orbit import RoughOrbit, RoughOrbits, solve_motion
from ampm.parameters import GaitParameters, RunParameters

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from ampm.motion import WholeBodyMotion
    from ampm.robot import Robot

    Array = NDArray[np.float64]

_NODES = (32, 14)  # intervals of the grid in single and double support
_DIFFERENCE = 0.015  # step of finite differences, as a share of a choice's range
_FAILED = 6.0  # residual of a choice for which there is no periodic step
_PULL = 0.06  # weight of the distance to the guess
_SWEEPS = 12  # points at which one search may ask for a Jacobian
_DROPS = (0.0, 0.012, 0.025, 0.04, 0.06)  # how much lower the guess's COM is tried [statures]
_BUDGET = 2000  # integrated steps after which no new way is begun
_TIGHT = 0.3  # margin below which a limit is named as what ended a way
_ENOUGH = 0.9  # share of the wanted margins at which a search ends
_HOPELESS = -0.5  # margin at which a path is given up


@dataclass(frozen=True)
class Certificate:
    """Why nothing was found: the limit that stayed broken, and the best that was reached.

    Attributes:
        limit: name in :data:`LIMITS`, or the reason of another refusal.
        what: what was measured.
        value: best value over all choices that were tried while the other limits were broken least.
        bound: what it should have met.
        unit: of both.
        tried: how many choices had been tried.
        choice: free choices of that best value, by namespaced key.
        where: clause about an easier gait at which the search ended, if it did not reach the one asked for.
    """

    limit: str
    what: str
    value: float
    bound: float
    unit: str
    tried: int
    choice: Mapping[str, float]
    where: str = ""

    def __str__(self) -> str:
        """One clause."""
        if self.limit not in LIMITS:
            return self.what + self.where
        limit = LIMITS[self.limit]
        most = limit.comfort < limit.bound
        unit = "" if self.unit == "1" else f" {self.unit}"
        return (
            f"{self.what} is {self.value:.4g}{unit} at best, {self.tried} choices tried, and must be "
            f"{'at most' if most else 'at least'} {self.bound:.4g}{unit}{self.where}"
        )


@dataclass(frozen=True)
class Tuned:
    """A run whose free choices are made.

    Attributes:
        run: complete.
        plan: with feet and the motion's constant of L_y.
        motion: the periodic step, on the fine grid.
        found: the free choices, by namespaced key.
        margins: limit to value on the search's grid, in the unit of :data:`LIMITS`.
        tried: how many choices were tried.
    """

    run: RunParameters
    plan: GaitPlan
    motion: WholeBodyMotion
    found: Mapping[str, float | str]
    margins: Mapping[str, float]
    tried: int


@dataclass
class _Trial:
    """One choice that was looked at.

    Attributes:
        x: free unknowns.
        run: complete, None where the formula has no solution.
        values: limit to value; those of the orbit are missing where there is none.
        orbit: the periodic step, if there is one.
        why: why there is none.
    """

    x: Array
    run: RunParameters | None = None
    plan: GaitPlan | None = None
    values: dict[str, float] = field(default_factory=dict)
    orbit: RoughOrbit | None = None
    why: Unreachable | None = None

    @property
    def whole(self) -> bool:
        """Whether all limits have a value."""
        return self.orbit is not None

    def margins(self) -> dict[str, float]:
        """Normalised margins of the limits that have a value."""
        return {name: LIMITS[name].margin(value) for name, value in self.values.items()}

    def worst(self) -> float:
        """Least normalised margin; minus infinity where there is no periodic step."""
        return min(self.margins().values()) if self.whole else -math.inf


class _Search:
    """Least squares over one space.

    Args:
        space: the free choices.
        base: the guess, for what is not free, and to stay near to.
        orbits: solver of periodic steps.
        robot: the body.
        say: called with a line of text now and then.
        influence: choice to the change of the orbit per unit of it, as far as it is known; grows here.
    """

    def __init__(
        self,
        space: FreeChoices,
        base: Mapping[str, float],
        orbits: RoughOrbits,
        robot: Robot,
        say: Callable[[str], None],
        influence: dict[str, Array] | None = None,
    ) -> None:
        self.influence: dict[str, Array] = {} if influence is None else influence
        self.space, self.base, self.orbits, self.robot, self.say = space, base, orbits, robot, say
        self.guess = np.clip([base[name] for name in space.names], space.lower, space.upper)
        self.trials: list[_Trial] = []
        self.near: _Trial | None = None
        self._kept: dict[bytes, _Trial] = {}
        self.wanted, self.pull = 1.0, _PULL

    def look(self, x: Array, near: _Trial | None, *, again: bool = False) -> _Trial:
        """Judge one choice, from the orbit of another; ``again`` if that may lead where others did not."""
        key = x.tobytes()
        if key in self._kept and not (again and not self._kept[key].whole):
            return self._kept[key]
        trial = _Trial(np.array(x))
        self._judge(trial, near)
        self._kept[key] = trial
        self.trials.append(trial)
        return trial

    def _judge(self, trial: _Trial, near: _Trial | None) -> None:
        space, description = self.space, self.space.description
        try:
            run = space.parameters(space.values(trial.x, self.base))
            plan = plan_gait(
                run.gait.model_copy(update={"steps": 2}), mass=run.body.mass, foot=run.foot, sole=space.sole
            )
        except (RefusedGait, InputError):  # what is named may not fit what is tried
            return
        trial.run, trial.plan = run, plan
        trial.values = plan_margins(plan, run, description)
        try:
            trial.orbit = self._orbit(trial, plan, run.body.lean, near)
        except Unreachable as error:
            trial.why = error
            return
        trial.values |= orbit_margins(trial.orbit, plan, self.robot)

    def _orbit(self, trial: _Trial, plan: GaitPlan, lean: float, near: _Trial | None) -> RoughOrbit:
        """The orbit of a choice, from where the choices' known influence puts it, or else from the neighbour.

        Raises:
            Unreachable: there is none, or none was found.
        """
        if near is None:
            return self.orbits.solve(plan, lean)
        moved = [(name, dx) for name, dx in zip(self.space.names, trial.x - near.x, strict=True) if dx]
        if moved and all(name in self.influence for name, _ in moved):
            shift = np.sum([dx * self.influence[name] for name, dx in moved], axis=0)
            with contextlib.suppress(Unreachable):
                return self.orbits.solve(plan, lean, near.orbit, shift)
        return self.orbits.solve(plan, lean, near.orbit)

    def residuals(self, trial: _Trial) -> Array:
        """What is missing to comfort, limit by limit, and the distance to the guess."""
        margins = trial.margins()
        missing = np.array(
            [_missing(margins[name], self.wanted) if name in margins else _FAILED for name in LIMITS]
        )
        if not trial.whole:
            missing = np.maximum(missing, 0.5 * _FAILED)
        return np.concatenate([missing, self.pull * (trial.x - self.guess) / self.space.slack])

    def _value(self, x: Array) -> Array:
        trial = self.look(x, self.near)
        return self.residuals(trial)

    def _jacobian(self, x: Array) -> Array:
        here = self.look(x, self.near)
        if here.whole:
            self.near = here
        if here.worst() >= _ENOUGH * self.wanted:
            raise _Comfortable(here)
        base = self.residuals(here)
        jacobian = np.zeros((len(base), len(x)))
        for j in range(len(x)):
            step = _DIFFERENCE * (self.space.upper[j] - self.space.lower[j])
            for sign in (1.0, -1.0) if x[j] + step <= self.space.upper[j] else (-1.0,):
                moved = x.copy()
                moved[j] += sign * step
                if not self.space.lower[j] <= moved[j] <= self.space.upper[j]:
                    continue
                trial = self.look(moved, self.near)
                if trial.orbit is not None and here.orbit is not None:
                    shift = self.orbits.difference(here.orbit, trial.orbit)
                    self.influence[self.space.names[j]] = shift / (sign * step)
                if trial.whole == here.whole:
                    jacobian[:, j] = (self.residuals(trial) - base) / (sign * step)
                    break
        self.say(f"worst margin {here.worst():.2f} after {len(self.trials)} choices")
        return jacobian

    def minimise(
        self, start: Array, *, wanted: float = 1.0, pull: float = _PULL, sweeps: int = _SWEEPS
    ) -> _Trial:
        """Least squares from a start that has an orbit; the trial with the least residuals."""
        self.wanted, self.pull = wanted, pull
        try:
            found = least_squares(
                self._value,
                np.clip(start, self.space.lower + 1e-9, self.space.upper - 1e-9),
                jac=self._jacobian,
                bounds=(self.space.lower, self.space.upper),
                x_scale=self.space.slack,
                method="trf",
                ftol=5e-3,
                xtol=1e-3,
                gtol=1e-6,
                max_nfev=sweeps,
            )
        except _Comfortable as end:
            return end.trial
        return self.look(found.x, self.near)


class _Comfortable(Exception):
    """The search may end: every margin is wide enough."""

    def __init__(self, trial: _Trial) -> None:
        super().__init__()
        self.trial = trial


def _missing(margin: float, wanted: float) -> float:
    """Shortfall of a margin; far ones grow slowly, so that one hopeless limit does not drown the others."""
    short = max(0.0, wanted - margin)
    return 0.5 * short * (1.0 + short) if short < 2.0 else 3.0 + math.log(short - 1.0)


def tune(
    run: RunParameters,
    robot: Robot,
    *,
    fixed: Collection[str] | None = None,
    progress: Callable[[str], None] | None = None,
    cache: Path | None = None,
) -> Tuned:
    """Make the free choices of a gait.

    Args:
        run: step, speed, c_s, c_y, body, and whatever else is fixed.
        robot: the body.
        fixed: namespaced keys that stay as they are; by default those that were named (:func:`named_keys`).
        progress: called with a line of text now and then.
        cache: folder of solved motions.

    Returns:
        The complete run, its plan and its motion.

    Raises:
        MathematicalRefusal: no choice gives the formula a solution.
        BodilyRefusal: every choice breaks a limit; ``certificate`` says which, and the best that was found.
    """
    say = progress or (lambda text: None)
    space = FreeChoices(run, named_keys(run) if fixed is None else fixed, robot.description)
    if "body.angular_momentum_z" in space.fixed:
        return _confirmed(*_tune(space, robot, say, patient=True), cache)
    # Arms that take up the legs' swing about the vertical spare the feet the twist of a fast gait.
    quiet = FreeChoices(run.replace({"body.angular_momentum_z": "zero"}), space.fixed, robot.description)
    if _twists(space, robot, say):
        try:
            return _confirmed(*_tune(quiet, robot, say), cache)
        except RefusedGait:
            return _confirmed(*_tune(space, robot, say), cache)
    search, best = _tune(space, robot, say, patient=True)
    if best.margins()["twist"] < _ENOUGH:
        try:
            return _confirmed(*_tune(quiet, robot, say), cache)
        except RefusedGait:
            say("no choice with L_z at zero")
    return _confirmed(search, best, cache)


def _twists(space: FreeChoices, robot: Robot, say: Callable[[str], None]) -> bool:
    """Whether the guess already twists harder on the floor than is comfortable."""
    search = _Search(space, space.guess(), RoughOrbits(robot, space.run, _NODES), robot, say)
    start = _standing_start(search)
    return start is not None and start.margins()["twist"] < _ENOUGH


def _tune(
    space: FreeChoices, robot: Robot, say: Callable[[str], None], *, patient: bool = False
) -> tuple[_Search, _Trial]:
    """The best choice, with the search that found it.

    Args:
        space: the free choices.
        robot: the body.
        say: called with a line of text now and then.
        patient: take the ways from easy neighbours a second time, with care.

    Raises:
        RefusedGait: there is none.
    """
    guess = space.guess()
    search = _Search(space, guess, RoughOrbits(robot, space.run, _NODES), robot, say)
    start = _standing_start(search)
    best = _settle(search, start) if start is not None else None
    farthest: _Farthest | None = None
    hard = best is None or best.worst() < 0.0
    for careful in (False, True)[: 1 + patient]:  # long strides first, which may lose the better orbit
        for easy in space.easy() if hard else ():
            way = _follow(easy, search, say, careful=careful)
            if way is not None and (farthest is None or way.share > farthest.share):
                farthest = way
            if way is not None and way.share == 1.0:
                hard = way.trial.worst() < 0.0
                break
    whole = [trial for trial in search.trials if trial.whole]
    if whole and (best is None or best.worst() < 0.0):
        best = max(whole, key=_Trial.worst)
    if best is None or best.worst() < 0.0:
        raise _refusal(search, best, farthest)
    return search, best


@dataclass
class _Farthest:
    """How far a path from an easy neighbour led.

    Attributes:
        share: of the way [1].
        search: at that place.
        trial: the choice there.
        why: what ended the way.
    """

    share: float
    search: _Search
    trial: _Trial
    why: Unreachable | None = None


def _follow(
    easy: GaitParameters,
    search: _Search,
    say: Callable[[str], None],
    *,
    careful: bool = False,
) -> _Farthest | None:
    """Come from an easy neighbour: tune it, move a little towards the gait, tune again, and so on.

    Args:
        easy: where to begin.
        search: of the gait that is asked for.
        say: called with a line of text now and then.
        careful: take a stride back that leads to far broken limits.

    Returns:
        The farthest choice that has a periodic step; None if not even the easy neighbour has.
    """
    space, orbits, robot = search.space, search.orbits, search.robot
    first = space.between(easy, 0.0)
    try:
        here = _Search(first, first.guess(), orbits, robot, say, search.influence)
    except RefusedGait:
        return None
    start = _standing_start(here)
    if start is None:
        return None
    farthest, stride = _Farthest(0.0, here, here.minimise(start.x, sweeps=5)), 0.5
    budget = 2 * _BUDGET if careful else _BUDGET
    while farthest.share < 1.0 and stride > 0.02 and orbits.evaluations < budget:
        there = min(1.0, farthest.share + stride)
        follow = search
        if there < 1.0:
            place = space.between(easy, there)
            try:
                base = place.guess()
            except RefusedGait:
                base = dict(search.base)
            follow = _Search(place, base, orbits, robot, say, search.influence)
        trial = _stepped(follow, farthest.trial)
        say(f"{there:.0%} of the way: {'a periodic step' if trial.whole else trial.why or 'no plan'}")
        if not trial.whole or (careful and stride > 0.1 and trial.worst() < _HOPELESS):
            farthest.why = trial.why or farthest.why
            stride *= 0.5
            continue
        follow.near = trial
        best = _settle(follow, trial) if there == 1.0 else follow.minimise(trial.x, sweeps=4)
        if there < 1.0 and best.worst() < 0.0:
            best = _settle(follow, trial)
        farthest = _Farthest(there, follow, best)
        if best.worst() < _HOPELESS:
            break
        stride *= 1.5
    return farthest


def _stepped(follow: _Search, last: _Trial) -> _Trial:
    """The last choice on the way, at the next place; its COM lowered if the legs do not reach otherwise."""
    x = last.x
    trial = follow.look(x, last, again=True)
    if trial.run is None:
        try:
            x = follow.space.passing(x)
        except RefusedGait:
            return trial
        trial = follow.look(x, last, again=True)
    if "height" in follow.space.names:
        j = follow.space.names.index("height")
        for drop in _DROPS[1:3]:
            if trial.whole:
                break
            lower = x.copy()
            lower[j] = max(follow.space.lower[j], x[j] - drop)
            trial = follow.look(lower, last, again=True)
    return trial


def _standing_start(search: _Search) -> _Trial | None:
    """The guess, its COM lowered until there is a periodic step."""
    drops = _DROPS if "height" in search.space.names else _DROPS[:1]
    for drop in drops:
        x = search.guess.copy()
        if drop:
            j = search.space.names.index("height")
            x[j] = max(search.space.lower[j], x[j] - drop)
        trial = search.look(x, None)
        if trial.whole:
            search.near = trial
            return trial
    return None


def _settle(search: _Search, start: _Trial) -> _Trial:
    """Comfort first; where a limit stays broken, only what the limits need."""
    best = search.minimise(start.x)
    if best.worst() < 0.0:
        search.near = best if best.whole else search.near
        harder = search.minimise(best.x if best.whole else start.x, wanted=0.15, pull=0.02)
        if harder.worst() > best.worst():
            best = harder
    whole = [trial for trial in search.trials if trial.whole]
    if best.worst() < 0.0 and whole:
        best = max(whole, key=_Trial.worst)
    return best


def _confirmed(search: _Search, best: _Trial, cache: Path | None) -> Tuned:
    """The choice with its plan over all steps and its motion on the fine grid."""
    space, robot = search.space, search.robot
    if best.run is None:
        raise TypeError("a choice without a plan cannot be confirmed")
    run = best.run
    plan = plan_gait(run.gait, mass=run.body.mass, foot=run.foot, sole=space.sole)
    try:
        check_body(plan, space.description)
        motion = solve_motion(plan, run, robot, cache=cache)
    except BodilyRefusal as error:  # what the search's grid just passed, the fine one may not
        raise _unconfirmed(error, run, search) from error
    plan = plan.with_angular_momentum_offset(motion.report.angular_momentum_y_offset)
    return Tuned(
        run=run,
        plan=plan,
        motion=motion,
        found=MappingProxyType(_found(run, space)),
        margins=MappingProxyType(dict(best.values)),
        tried=len(search.trials),
    )


def _unconfirmed(error: BodilyRefusal, run: RunParameters, search: _Search) -> Untunable:
    """The refusal of the best choice by the checks that every gait has to pass."""
    choice = {k: float(v) for k, v in _found(run, search.space).items() if isinstance(v, float)}
    what = str(error).partition(";")[0]
    certificate = Certificate(
        error.reason,
        what,
        error.value,
        error.limit,
        error.unit,
        len(search.trials),
        MappingProxyType(choice),
        f" ({len(search.trials)} choices tried)",
    )
    return Untunable(
        f"the best choice just fails: {certificate}",
        certificate,
        reason=error.reason,
        way_out=error.way_out,
    )


def _found(run: RunParameters, space: FreeChoices) -> dict[str, float | str]:
    """Free keys and their values."""
    values: dict[str, float | str] = {}
    for key in FREE_KEYS:
        rolls = key.startswith("foot.") and "swing" not in key and key != "foot.schedule"
        if key not in space.fixed and not (rolls and space.flat):
            section, _, name = key.partition(".")
            values[key] = getattr(getattr(run, section), name)
    return values


class Untunable(BodilyRefusal):
    """No choice was found.

    Attributes:
        certificate: which limit, and the best that was reached.
    """

    def __init__(self, message: str, certificate: Certificate, *, reason: str, way_out: str) -> None:
        super().__init__(
            message,
            reason=reason,
            value=certificate.value,
            limit=certificate.bound,
            unit=certificate.unit,
            way_out=way_out,
        )
        self.certificate = certificate


_WAYS_OUT = {
    **dict.fromkeys(
        (name for name in LIMITS if name.endswith("_torque")),
        "lower gait.switching_velocity, or bring gait.c_s and gait.c_y nearer to 1",
    ),
    "trunk": "bring gait.c_s and gait.c_y nearer to 1",
    "arms": "bring gait.c_s and gait.c_y nearer to 1",
    "friction": "bring gait.c_s nearer to 1 or shorten gait.step_length",
    "mid_stance": "raise gait.switching_velocity, shorten gait.step_length or lower gait.c_s",
}


def _refusal(search: _Search, best: _Trial | None, farthest: _Farthest | None) -> Untunable:
    """The limit that stayed broken in the best of all choices, or where the way to the gait ended."""
    tried = len(search.trials)
    where = ""
    if best is None and farthest is not None:
        best, gait = farthest.trial, farthest.search.space.run.gait
        tried += len(farthest.search.trials)
        where = (
            f" at step {gait.step_length:.3g} m, v0 {gait.switching_velocity:.3g} m/s, c_s {gait.c_s:.3g}, "
            f"c_y {gait.c_y:.3g}, {farthest.share:.0%} of the way from an easy gait"
            + (f"; beyond, {farthest.why}" if farthest.why is not None else ", where the search ended")
        )
    name = "no_periodic_motion"
    if best is not None and best.whole:
        margins = best.margins()
        tightest = min(margins, key=lambda key: margins[key])
        limit = LIMITS[tightest]
        what, value, bound, unit = limit.what, best.values[tightest], limit.bound, limit.unit
        if not where or margins[tightest] < _TIGHT:
            name = tightest
        elif farthest is not None:
            what, value, bound, unit = "a periodic step is found only", farthest.share, 1.0, "1"
        reason = name if name not in LIMITS else limit.reason
    else:
        best = next((trial for trial in reversed(search.trials) if trial.why is not None), search.trials[-1])
        what, value, bound, unit, reason = "the formula has no solution", 0.0, 0.0, "1", name
        if best.why is not None:
            what, value, bound, unit = str(best.why), best.why.value, best.why.limit, best.why.unit
    found = _found(best.run, search.space) if best.run is not None else {}
    choice = {key: float(value) for key, value in found.items() if isinstance(value, float)}
    certificate = Certificate(
        name, what, float(value), float(bound), unit, tried, MappingProxyType(choice), where
    )
    return Untunable(
        f"no choice of timing, heights and angles lets this body walk the gait: {certificate}",
        certificate,
        reason=reason,
        way_out=_WAYS_OUT.get(name, "shorten gait.step_length, or bring gait.c_s and gait.c_y nearer to 1"),
    )

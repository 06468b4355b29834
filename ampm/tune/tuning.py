"""The free choices of a gait, found by an optimiser on plan and inverse kinematics alone.

The paper fixes a gait by step, speed, c_s and c_y and leaves the rest to be "set manually": how much of the
step is single support, how far the ZMP rolls under the foot, how high the COM is, when and how far the feet
turn, how the trunk leans. Here these are unknowns of a nonlinear least-squares problem. Every limit of body
and floor has a normalised margin: 0 where the limit is met exactly, 1 at its target. What is missing to 1 is
a residual, and so is, weakly, the distance to a closed-form guess: it makes the answer unique where nothing
binds. Plan, feet, the periodic step of the inverse kinematics on a coarse grid, and the joint torques of that
step under the planned ground force are evaluated: no simulation.

Strategies, in order: the guess and least squares from there; from an easy neighbour, in strides towards the
gait; the same once more with care; L_z held at zero where the feet would twist; the defaults.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

from ampm.body.continuation import EndOfWay, Strides, follow
from ampm.body.inverse_kinematics import Unreachable
from ampm.exceptions import BodilyRefusal, InputError, RefusedGait
from ampm.parameters import GaitParameters, RunParameters
from ampm.planner.periodic import plan_gait
from ampm.planners import AmpmPeriodic, PeriodicWalk, WalkRequest
from ampm.tune.certificate import Certificate, Untunable, way_out
from ampm.tune.choice_search import ENOUGH, Candidate, ChoiceSearch
from ampm.tune.free_choices import FreeChoices, named_keys
from ampm.tune.gait_limits import LIMITS, orbit_margins, plan_margins
from ampm.tune.rough_orbits import RoughOrbits

if TYPE_CHECKING:
    from pathlib import Path

    from ampm.body.robot import Robot

    Say = Callable[[str], None]

_NODES = (32, 14)  # intervals of the grid in single and double support
_DROPS = (0.0, 0.012, 0.025, 0.04, 0.06)  # how much lower the guess's COM is tried [statures]
_BUDGET = 2000  # integrated steps that the ways may take; a second, careful try may take as many
_STRIDES = Strides(shrink=0.5, grow=1.5)
_LONG_STRIDE = 0.1  # one that a careful try takes back if it leads to far broken limits
_TIGHT = 0.3  # margin below which a limit is named as what ended a way
_GRID = 0.1  # margin that a coarse grid may be wrong by: 2 % of a torque limit
_HOPELESS = -0.5  # margin at which a way is given up
_L_Z = "body.angular_momentum_z"


@dataclass(frozen=True)
class Tuned:
    """A run whose free choices are made.

    Attributes:
        run: complete.
        plan: complete, with the periodic step on the fine grid.
        found: the free choices, by namespaced key.
        margins: limit to value on the search's grid, in the unit of :data:`LIMITS`.
        tried: how many choices were tried.
    """

    run: RunParameters
    plan: PeriodicWalk
    found: Mapping[str, float | str]
    margins: Mapping[str, float]
    tried: int


@dataclass
class _Way:
    """How far the strides from an easy neighbour led.

    Attributes:
        share: of the way [1].
        search: at that place.
        candidate: the choice there.
        why: what ended the way.
    """

    share: float
    search: ChoiceSearch
    candidate: Candidate
    why: Unreachable | None = None


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
        InputError: the gait is the plain inverted pendulum's.
        MathematicalRefusal: no choice gives the formula a solution.
        BodilyRefusal: every choice breaks a limit; ``certificate`` says which, and the best that was found.
    """
    say = progress or (lambda text: None)
    if run.gait.model != "ampm":  # its ZMP jumps, so no choice could keep it in a support that grows
        raise InputError(
            f"gait.model = {run.gait.model!r} cannot be tuned, only 'ampm' can; 'ampm validate' walks the "
            "preset ipm as it is, and its step length, speed and heights can be set.",
            key="gait.model",
        )
    if not run.gait.c_y > 0.0:
        plan_gait(run.gait, run.body.mass)  # refuses it, in better words than a search in vain
    space = FreeChoices(run, named_keys(run) if fixed is None else fixed, robot.description)
    try:
        return _searched(space, robot, say, cache)
    except RefusedGait:
        defaults = _defaults(space, robot, cache)
        if defaults is None:
            raise
        say("the values that were left out walk at their defaults")
        return defaults


def _searched(space: FreeChoices, robot: Robot, say: Say, cache: Path | None) -> Tuned:
    """The best choice of a search.

    Raises:
        RefusedGait: there is none; of two refusals, the one that came nearer to its limit.
    """
    # Arms that take up the legs' swing about the vertical spare the feet the twist of a fast gait.
    quiet = FreeChoices(space.run.replace({_L_Z: "zero"}), space.fixed, robot.description)
    if _L_Z not in space.fixed and _twists(space, robot, say):
        try:
            return _confirmed(*_best(quiet, robot, say), cache)
        except RefusedGait as first:
            try:
                return _confirmed(*_best(space, robot, say), cache)
            except Untunable as second:
                refusals = [error for error in (second, first) if isinstance(error, Untunable)]
                raise max(refusals, key=lambda error: error.certificate.margin) from None
    search, best = _best(space, robot, say, patient=True)
    if _L_Z not in space.fixed and best.margins()["twist"] < ENOUGH:
        with contextlib.suppress(RefusedGait):
            return _confirmed(*_best(quiet, robot, say), cache)
        say("no choice with L_z at zero")
    return _confirmed(search, best, cache)


def _twists(space: FreeChoices, robot: Robot, say: Say) -> bool:
    """Whether the guess already twists harder on the floor than its target."""
    search = ChoiceSearch(space, space.guess(), RoughOrbits(robot, space.run, _NODES), say)
    start = _first_orbit(search)
    return start is not None and start.margins()["twist"] < ENOUGH


def _best(
    space: FreeChoices, robot: Robot, say: Say, *, patient: bool = False
) -> tuple[ChoiceSearch, Candidate]:
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
    orbits = RoughOrbits(robot, space.run, _NODES, budget=_BUDGET * (1 + patient))
    search = ChoiceSearch(space, guess, orbits, say)
    start = _first_orbit(search)
    best = _minimise(search, start) if start is not None else None
    farthest: _Way | None = None
    broken = best is None or best.worst() < 0.0
    for careful in (False, True)[: 1 + patient]:  # long strides first, which may lose the better orbit
        for easy in space.easy() if broken else ():
            way = _approach(easy, search, careful=careful)
            if way is not None and (farthest is None or way.share > farthest.share):
                farthest = way
            if way is not None and way.share == 1.0:
                broken = way.candidate.worst() < 0.0
                break
    if best is None or best.worst() < 0.0:
        best = search.best_with_orbit() or best
    if best is None or best.worst() < 0.0:
        raise _refusal(search, best, farthest)
    return search, best


def _approach(easy: GaitParameters, search: ChoiceSearch, *, careful: bool = False) -> _Way | None:
    """Come from an easy neighbour: tune it, move a little towards the gait, tune again, and so on.

    Args:
        easy: where to begin.
        search: of the gait that is asked for.
        careful: take a long stride back that leads to far broken limits.

    Returns:
        The farthest choice that has a periodic step; None if not even the easy neighbour has.
    """
    space, orbits = search.space, search.orbits
    first = space.between(easy, 0.0)
    try:
        here = search.elsewhere(first, first.guess())
    except RefusedGait:
        return None
    start = _first_orbit(here)
    if start is None:
        return None
    way = _Way(0.0, here, here.minimise(start.x, sweeps=5))
    hopeless = False

    def attempt(there: float, stride: float) -> bool:
        nonlocal way, hopeless
        if hopeless or orbits.evaluations >= _BUDGET * (1 + careful):
            raise EndOfWay
        local = search
        if there < 1.0:
            place = space.between(easy, there)
            try:
                base = place.guess()
            except RefusedGait:
                base = dict(search.base)
            local = search.elsewhere(place, base)
        candidate = _moved_on(local, way.candidate)
        search.say(f"{there:.0%} of the way: {candidate.why or 'done'}")
        if not candidate.has_orbit or (careful and stride > _LONG_STRIDE and candidate.worst() < _HOPELESS):
            way.why = candidate.why or way.why
            return False
        local.near = candidate
        best = _minimise(local, candidate) if there == 1.0 else local.minimise(candidate.x, sweeps=4)
        if there < 1.0 and best.worst() < 0.0:
            best = _minimise(local, candidate)
        way = _Way(there, local, best)
        hopeless = best.worst() < _HOPELESS
        return True

    follow(attempt, _STRIDES)
    return way


def _moved_on(search: ChoiceSearch, last: Candidate) -> Candidate:
    """The last choice on the way, at the next place; its COM lowered if the legs do not reach otherwise."""
    x = last.x
    candidate = search.evaluate(x, last, again=True)
    if candidate.plan is None:
        try:
            x = search.space.passing(x)
        except RefusedGait:
            return candidate
        candidate = search.evaluate(x, last, again=True)
    if "height" in search.space.names:
        for drop in _DROPS[1:3]:
            if candidate.has_orbit:
                break
            candidate = search.evaluate(search.space.lowered(x, drop), last, again=True)
    return candidate


def _first_orbit(search: ChoiceSearch) -> Candidate | None:
    """The guess, its COM lowered until there is a periodic step."""
    for drop in _DROPS if "height" in search.space.names else _DROPS[:1]:
        x = search.space.lowered(search.guess, drop) if drop else search.guess.copy()
        candidate = search.evaluate(x, None)
        if candidate.has_orbit:
            search.near = candidate
            return candidate
    return None


def _minimise(search: ChoiceSearch, start: Candidate) -> Candidate:
    """Minimise with target margins; if a hard limit is still broken, retry with small margins."""
    best = search.minimise(start.x)
    if best.worst() < 0.0:
        search.near = best if best.has_orbit else search.near
        harder = search.minimise(best.x if best.has_orbit else start.x, wanted=0.15, pull=0.02)
        if harder.worst() > best.worst():
            best = harder
    return (search.best_with_orbit() or best) if best.worst() < 0.0 else best


def _confirmed(search: ChoiceSearch, best: Candidate, cache: Path | None) -> Tuned:
    """The choice with its plan over all steps and its motion on the fine grid.

    Raises:
        Untunable: what the search's grid just passed, the fine one does not.
    """
    space, run = search.space, best.run
    try:
        plan = AmpmPeriodic().plan(WalkRequest(run, search.orbits.robot, cache=cache))
    except BodilyRefusal as error:
        reason, tried, choice = error.reason, len(search.candidates), _numbers(space.found(run))
        what = f"{str(error).partition(';')[0]} ({tried} choices tried)"
        certificate = Certificate(reason, what, error.value, error.limit, error.unit, tried, choice)
        fault = "the best choice just fails"
        raise Untunable(fault, certificate, reason=reason, way_out=error.way_out) from error
    return _tuned(plan, run, space, best.values, len(search.candidates))


def _defaults(space: FreeChoices, robot: Robot, cache: Path | None) -> Tuned | None:
    """The gait with the defaults of what it leaves out, if they keep the limits, give or take the grid."""
    run = space.run
    try:
        plan = AmpmPeriodic().plan(WalkRequest(run, robot, cache=cache))
        orbits = RoughOrbits(robot, run, _NODES)
        orbit = orbits.solve(plan, run.body.lean, motion=plan.posture.motion)
    except (RefusedGait, InputError, Unreachable):
        return None
    values = plan_margins(plan, run, space.description) | orbit_margins(orbit, plan, robot)
    if min(LIMITS[name].margin(value) for name, value in values.items()) < -_GRID:
        return None
    return _tuned(plan, run, space, values, 1)


def _tuned(
    plan: PeriodicWalk, run: RunParameters, space: FreeChoices, values: Mapping[str, float], tried: int
) -> Tuned:
    margins, found = MappingProxyType(dict(values)), MappingProxyType(space.found(run))
    return Tuned(run, plan, found, margins, tried)


def _numbers(found: Mapping[str, float | str]) -> Mapping[str, float]:
    return MappingProxyType({key: float(value) for key, value in found.items() if isinstance(value, float)})


def _refusal(search: ChoiceSearch, best: Candidate | None, farthest: _Way | None) -> Untunable:
    """The limit that stayed broken in the best of all choices, or where the way to the gait ended."""
    space, tried = search.space, len(search.candidates)
    where = beyond = ""
    if best is None and farthest is not None:
        best, gait = farthest.candidate, farthest.search.space.run.gait
        tried += len(farthest.search.candidates)
        where = (
            f"the search came {farthest.share:.0%} of the way from an easy gait, to step "
            f"{gait.step_length:.3g} m, v0 {gait.switching_velocity:.3g} m/s, c_s {gait.c_s:.3g}, "
            f"c_y {gait.c_y:.3g}"
        )
        beyond = "" if farthest.why is None else str(farthest.why)
    name = reason = "no_periodic_motion"
    if best is not None and best.has_orbit:
        margins = best.margins()
        tightest = min(margins, key=lambda key: margins[key])
        limit = LIMITS[tightest]
        what, value, bound, unit = limit.what, best.values[tightest], limit.bound, limit.unit
        if not where or margins[tightest] < _TIGHT:
            name, reason = tightest, limit.reason
        elif farthest is not None:
            what, value, bound, unit = "the last periodic step is found", farthest.share, 1.0, "1"
    else:
        failed = [candidate for candidate in search.candidates if candidate.why is not None]
        best = (failed or search.candidates)[-1]
        what, value, bound, unit = "the formula has no solution", 0.0, 0.0, "1"
        if best.why is not None:
            what, value, bound, unit = str(best.why), best.why.value, best.why.limit, best.why.unit
    choice = _numbers(space.found(best.run) if best.plan is not None else {})
    certificate = Certificate(name, what, float(value), float(bound), unit, tried, choice, where, beyond)
    return Untunable(
        "no choice of timing, heights and angles lets this body walk the gait",
        certificate,
        reason=reason,
        way_out=way_out(name, space.run, space.fixed),
    )

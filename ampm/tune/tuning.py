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

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from ampm.body.feasibility import check_body
from ampm.body.inverse_kinematics import Unreachable
from ampm.body.orbit import RoughOrbits, solve_motion
from ampm.exceptions import BodilyRefusal, InputError, RefusedGait
from ampm.parameters import GaitParameters, RunParameters
from ampm.planner.periodic import plan_gait
from ampm.planner.support import plan_steps
from ampm.planners import PeriodicWalk, periodic_walk
from ampm.tune.certificate import Certificate, Untunable, way_out
from ampm.tune.choice_search import ENOUGH, ChoiceSearch, Trial
from ampm.tune.free_choices import FREE_KEYS, FreeChoices, named_keys
from ampm.tune.gait_limits import LIMITS, orbit_margins, plan_margins

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from ampm.body.robot import Robot

    Array = NDArray[np.float64]

_NODES = (32, 14)  # intervals of the grid in single and double support
_DROPS = (0.0, 0.012, 0.025, 0.04, 0.06)  # how much lower the guess's COM is tried [statures]
_BUDGET = 2000  # integrated steps that the ways may take; a second, careful try may take as many
_TIGHT = 0.3  # margin below which a limit is named as what ended a way
_GRID = 0.1  # margin that a coarse grid may be wrong by: 2 % of a torque limit
_HOPELESS = -0.5  # margin at which a path is given up


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
        as_it_is = _as_it_is(space, robot, cache)
        if as_it_is is None:
            raise
        say("the values that were left out walk at their defaults")
        return as_it_is


def _searched(space: FreeChoices, robot: Robot, say: Callable[[str], None], cache: Path | None) -> Tuned:
    """The best choice of a search.

    Raises:
        RefusedGait: there is none.
    """
    run = space.run
    if "body.angular_momentum_z" in space.fixed:
        return _confirmed(*_tune(space, robot, say, patient=True), cache)
    # Arms that take up the legs' swing about the vertical spare the feet the twist of a fast gait.
    quiet = FreeChoices(run.replace({"body.angular_momentum_z": "zero"}), space.fixed, robot.description)
    if _twists(space, robot, say):
        try:
            return _confirmed(*_tune(quiet, robot, say), cache)
        except RefusedGait as refused:
            return _otherwise(space, robot, say, cache, refused)
    search, best = _tune(space, robot, say, patient=True)
    if best.margins()["twist"] < ENOUGH:
        try:
            return _confirmed(*_tune(quiet, robot, say), cache)
        except RefusedGait:
            say("no choice with L_z at zero")
    return _confirmed(search, best, cache)


def _as_it_is(space: FreeChoices, robot: Robot, cache: Path | None) -> Tuned | None:
    """The gait with the defaults of what it leaves out, if they keep the limits, give or take the grid."""
    run = space.run
    try:
        plan = plan_steps(run.gait, run.body.mass, run.foot, space.sole)
        check_body(plan, space.description)
        motion = solve_motion(plan, run, robot, cache=cache)
        orbit = RoughOrbits(robot, run, _NODES).solve(plan, run.body.lean, motion=motion)
    except (RefusedGait, InputError, Unreachable):
        return None
    values = plan_margins(plan, run, space.description) | orbit_margins(orbit, plan, robot)
    if min(LIMITS[name].margin(value) for name, value in values.items()) < -_GRID:
        return None
    return Tuned(
        run=run,
        plan=periodic_walk(plan, motion, robot),
        found=MappingProxyType(_found(run, space)),
        margins=MappingProxyType(values),
        tried=1,
    )


def _otherwise(
    space: FreeChoices, robot: Robot, say: Callable[[str], None], cache: Path | None, first: RefusedGait
) -> Tuned:
    """The other choice for L_z, after the first was refused.

    Raises:
        RefusedGait: it is refused as well; of the two refusals, the one that came nearer to its limit.
    """
    try:
        return _confirmed(*_tune(space, robot, say), cache)
    except Untunable as second:
        if isinstance(first, Untunable):
            raise max(second, first, key=lambda refusal: refusal.certificate.margin) from None
        raise


def _twists(space: FreeChoices, robot: Robot, say: Callable[[str], None]) -> bool:
    """Whether the guess already twists harder on the floor than is comfortable."""
    search = ChoiceSearch(space, space.guess(), RoughOrbits(robot, space.run, _NODES), robot, say)
    start = _standing_start(search)
    return start is not None and start.margins()["twist"] < ENOUGH


def _tune(
    space: FreeChoices, robot: Robot, say: Callable[[str], None], *, patient: bool = False
) -> tuple[ChoiceSearch, Trial]:
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
    search = ChoiceSearch(space, guess, orbits, robot, say)
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
        best = max(whole, key=Trial.worst)
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
    search: ChoiceSearch
    trial: Trial
    why: Unreachable | None = None


def _follow(
    easy: GaitParameters,
    search: ChoiceSearch,
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
        here = ChoiceSearch(first, first.guess(), orbits, robot, say, search.influence)
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
            follow = ChoiceSearch(place, base, orbits, robot, say, search.influence)
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


def _stepped(follow: ChoiceSearch, last: Trial) -> Trial:
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


def _standing_start(search: ChoiceSearch) -> Trial | None:
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


def _settle(search: ChoiceSearch, start: Trial) -> Trial:
    """Comfort first; where a limit stays broken, only what the limits need."""
    best = search.minimise(start.x)
    if best.worst() < 0.0:
        search.near = best if best.whole else search.near
        harder = search.minimise(best.x if best.whole else start.x, wanted=0.15, pull=0.02)
        if harder.worst() > best.worst():
            best = harder
    whole = [trial for trial in search.trials if trial.whole]
    if best.worst() < 0.0 and whole:
        best = max(whole, key=Trial.worst)
    return best


def _confirmed(search: ChoiceSearch, best: Trial, cache: Path | None) -> Tuned:
    """The choice with its plan over all steps and its motion on the fine grid."""
    space, robot = search.space, search.robot
    if best.run is None:
        raise TypeError("a choice without a plan cannot be confirmed")
    run = best.run
    plan = plan_steps(run.gait, run.body.mass, run.foot, space.sole)
    try:
        check_body(plan, space.description)
        motion = solve_motion(plan, run, robot, cache=cache)
    except BodilyRefusal as error:  # what the search's grid just passed, the fine one may not
        raise _unconfirmed(error, run, search) from error
    return Tuned(
        run=run,
        plan=periodic_walk(plan, motion, robot),
        found=MappingProxyType(_found(run, space)),
        margins=MappingProxyType(dict(best.values)),
        tried=len(search.trials),
    )


def _unconfirmed(error: BodilyRefusal, run: RunParameters, search: ChoiceSearch) -> Untunable:
    """The refusal of the best choice by the checks that every gait has to pass."""
    choice = {k: float(v) for k, v in _found(run, search.space).items() if isinstance(v, float)}
    what = f"{str(error).partition(';')[0]} ({len(search.trials)} choices tried)"
    certificate = Certificate(
        error.reason,
        what,
        error.value,
        error.limit,
        error.unit,
        len(search.trials),
        MappingProxyType(choice),
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


def _refusal(search: ChoiceSearch, best: Trial | None, farthest: _Farthest | None) -> Untunable:
    """The limit that stayed broken in the best of all choices, or where the way to the gait ended."""
    tried = len(search.trials)
    where = beyond = ""
    if best is None and farthest is not None:
        best, gait = farthest.trial, farthest.search.space.run.gait
        tried += len(farthest.search.trials)
        where = (
            f"the search came {farthest.share:.0%} of the way from an easy gait, to step "
            f"{gait.step_length:.3g} m, v0 {gait.switching_velocity:.3g} m/s, c_s {gait.c_s:.3g}, "
            f"c_y {gait.c_y:.3g}"
        )
        beyond = "" if farthest.why is None else str(farthest.why)
    name = "no_periodic_motion"
    if best is not None and best.whole:
        margins = best.margins()
        tightest = min(margins, key=lambda key: margins[key])
        limit = LIMITS[tightest]
        what, value, bound, unit = limit.what, best.values[tightest], limit.bound, limit.unit
        if not where or margins[tightest] < _TIGHT:
            name = tightest
        elif farthest is not None:
            what, value, bound, unit = "the last periodic step is found", farthest.share, 1.0, "1"
        reason = name if name not in LIMITS else limit.reason
    else:
        best = next((trial for trial in reversed(search.trials) if trial.why is not None), search.trials[-1])
        what, value, bound, unit, reason = "the formula has no solution", 0.0, 0.0, "1", name
        if best.why is not None:
            what, value, bound, unit = str(best.why), best.why.value, best.why.limit, best.why.unit
    found = _found(best.run, search.space) if best.run is not None else {}
    choice = {key: float(value) for key, value in found.items() if isinstance(value, float)}
    certificate = Certificate(
        name, what, float(value), float(bound), unit, tried, MappingProxyType(choice), where, beyond
    )
    return Untunable(
        f"no choice of timing, heights and angles lets this body walk the gait: {certificate}",
        certificate,
        reason=reason,
        way_out=way_out(name, search.space.run, search.space.fixed),
    )

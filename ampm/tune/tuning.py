"""Search for the values that a gait leaves open, on plan and inverse kinematics alone.

The paper fixes a gait by step, speed, c_s and c_y and leaves the rest to be "set manually": how much of the
step is single support, how far the ZMP rolls under the foot, how high the COM is, when and how far the feet
turn, how the trunk leans. Here these are unknowns of a nonlinear least-squares problem. Every limit of body
and floor has a normalised margin: 0 where the limit is met exactly, 1 at its target. The shortfall to 1 is a
residual, and so is, weakly, the distance to a closed-form guess, which makes the solution unique where no
limit binds. Plan, feet, the periodic step of the inverse kinematics on a coarse grid, and the joint torques
of that step under the planned ground force are evaluated: no simulation.

Strategies, in order: the values that there are, a preset's own or defaults, which stay if every limit is kept
with room to spare; the guess and least squares from there; from an easy neighbour, in steps towards the
gait; L_z held at zero where the feet would twist; the values that there are, if they keep the limits at all.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

from ampm.body.continuation import Continuation
from ampm.body.inverse_kinematics import Unreachable
from ampm.body.motion import PeriodicPosture
from ampm.exceptions import BodilyRefusal, InputError, RefusedGait
from ampm.parameters import GaitParameters, RunParameters
from ampm.planner.closed_form import LIPM
from ampm.planner.periodic import plan_gait
from ampm.planners import PeriodicPlanner
from ampm.tune.free_choices import FreeChoices
from ampm.tune.gait_limits import LIMITS, least, orbit_margins, plan_margins
from ampm.tune.refusal import NoFeasibleChoice, no_feasible_choice, way_out
from ampm.tune.search import ENOUGH, Approach, Candidate, ChoiceSearch, RoughOrbits
from ampm.walk import WalkPlan

if TYPE_CHECKING:
    from ampm.body.robot import Robot

    Report = Callable[[str], None]

_DROPS = (0.0, 0.012, 0.025, 0.04, 0.06)  # how much lower the guess's COM is tried [statures]
_BUDGET = 1800  # integrated steps of one search
_LONG_STEP = 0.1  # one that is taken back if limits stay broken where it leads
_SPARE = 0.4  # margin with which the values that there are stay
_GRID = 0.1  # margin that a coarse grid may be wrong by: 2 % of a torque limit
_EASY = 0.5  # margin at which a gait on the way is left for the next
_TOO_FAR = -0.5  # margin below which a continuation is stopped
_L_Z = "body.angular_momentum_z"


@dataclass(frozen=True)
class Tuned:
    """A run whose free choices are made.

    Attributes:
        run: complete; every value counts as given.
        plan: complete, with the periodic step on the fine grid.
        found: what was open, by namespaced key.
        margins: limit to value on the search's grid, in the unit of :data:`LIMITS`.
        tried: how many choices were tried.
    """

    run: RunParameters
    plan: WalkPlan
    found: Mapping[str, float | str]
    margins: Mapping[str, float]
    tried: int

    def worst(self) -> float:
        """Least normalised margin [1]."""
        return min(LIMITS[name].margin(value) for name, value in self.margins.items())


def tune(
    run: RunParameters,
    robot: Robot,
    *,
    progress: Callable[[str], None] | None = None,
) -> Tuned:
    """Find what a gait leaves open.

    Args:
        run: what is given of it stays (:attr:`ampm.parameters.RunParameters.given`).
        robot: the body.
        progress: called with a line of text now and then.

    Returns:
        The complete run, its plan and its motion.

    Raises:
        InputError: the gait is the plain inverted pendulum's.
        MathematicalRefusal: no choice gives the formula a solution.
        NoFeasibleChoice: every choice breaks a limit.
    """
    report = progress or (lambda text: None)
    if run.gait.planner == LIPM:  # its ZMP jumps, so no choice could keep it in a support that grows
        raise InputError(
            f"gait.planner = {LIPM!r} cannot be tuned; 'ampm validate' walks the preset ipm as it is, and "
            "its step length, speed and heights can be set.",
            key="gait.planner",
        )
    if not run.gait.c_y > 0.0:
        plan_gait(run.gait, run.body.mass)  # refuses it, with a better message than a failed search
    space = FreeChoices(run, run.given, robot.description)
    _check_pace(space)
    own = _own(space, robot)
    if own is not None and own.worst() >= _SPARE:
        return own
    try:
        found = _searched(space, robot, report)
    except RefusedGait as error:
        if own is not None and own.worst() >= -_GRID:
            return own
        if own is not None:
            error.add_note("as it is, the gait has a plan beyond these limits: --as-is walks it")
        raise
    return found if own is None or found.worst() >= own.worst() else own


def _check_pace(space: FreeChoices) -> None:
    """Refuse steps that are too short in time whatever is chosen, before a search finds that out.

    Raises:
        NoFeasibleChoice: they are.
    """
    limit, run = LIMITS["pace"], space.run
    try:
        duration = plan_gait(space.longest(), run.body.mass).constants.step_duration
    except (RefusedGait, InputError):
        return  # the COM hardly passes over the foot: no short step
    if duration >= limit.bound:
        return
    raise NoFeasibleChoice(
        f"no choice of timing, heights and angles lets this body walk the gait: {limit.what} is "
        f"{limit.quantity(duration, 4)} at best, and must be {limit.rule()}",
        broken="pace",
        tried=1,
        choice={},
        reason=limit.reason,
        value=duration,
        limit=limit.bound,
        unit=limit.unit,
        way_out=way_out("pace", run, space.fixed),
    )


def _searched(space: FreeChoices, robot: Robot, report: Report) -> Tuned:
    """The best choice of the first strategy that finds one.

    Raises:
        RefusedGait: there is none; of two refusals, the one that came nearer to its limit.
    """
    search = _begun(space, robot, report, _BUDGET)
    free = _L_Z not in space.fixed
    twists = free and search.near is not None and search.near.margins()["twist"] < ENOUGH

    def plain() -> Tuned:
        return _confirmed(search, _best(search))

    def balanced() -> Tuned:
        """With arms that balance the legs about the vertical, which takes from the feet's twisting moment."""
        zero = FreeChoices(space.run.replace({_L_Z: "zero"}), space.fixed, robot.description)
        here = _begun(zero, robot, report, _BUDGET - search.orbits.ik.integrations)
        return _confirmed(here, _best(here))

    first, second = (balanced, plain) if twists else (plain, balanced)
    try:
        found = first()
    except RefusedGait as error:
        if not twists and not (free and isinstance(error, NoFeasibleChoice) and error.broken == "twist"):
            raise
        search.orbits.budget = _BUDGET / 3
        try:
            return second()
        except RefusedGait as other:
            raise max(other, error, key=_nearness) from None
    if twists or not free or LIMITS["twist"].margin(found.margins["twist"]) >= ENOUGH:
        return found
    with contextlib.suppress(RefusedGait):
        return second()
    return found


def _nearness(error: RefusedGait) -> float:
    """Margin of the limit that a search could not meet [1]."""
    return error.margin if isinstance(error, NoFeasibleChoice) else -math.inf


def _begun(space: FreeChoices, robot: Robot, report: Report, budget: float) -> ChoiceSearch:
    """A search with the guess as its first choice, if that has a periodic step.

    Raises:
        MathematicalRefusal: there is no guess.
    """
    search = ChoiceSearch(space, space.guess(), RoughOrbits(robot, space.run, budget=budget), report)
    _first_orbit(search)
    return search


def _best(search: ChoiceSearch) -> Candidate:
    """The best choice of a search that has begun.

    Raises:
        NoFeasibleChoice: there is none.
    """
    best = None if search.near is None else _minimise(search, search.near)
    farthest: Approach | None = None
    for easy in search.space.easy():
        if best is not None and best.worst() >= 0.0:
            return best
        way = _approach(easy, search)
        if way is not None and (farthest is None or way.share > farthest.share):
            farthest = way
        best = search.best_with_orbit()
    if best is None or best.worst() < 0.0:
        raise no_feasible_choice(search, best, farthest)
    return best


def _approach(easy: GaitParameters, search: ChoiceSearch) -> Approach | None:
    """Continuation from an easy neighbour: tune it, move a little towards the gait, tune again, and so on.

    A long step to a place where limits stay broken is taken back. None if the easy neighbour has no periodic
    step.
    """
    space, first = search.space, search.space.between(easy, 0.0)
    try:
        here = search.elsewhere(first, first.guess())
    except RefusedGait:
        return None
    start = _first_orbit(here)
    if start is None:
        return None
    found = Approach(0.0, here, here.minimise(start, enough=_EASY))
    way, too_far = Continuation(shrink=0.5, grow=1.5), False
    while way.open and not too_far and search.orbits.ik.integrations < search.orbits.budget:
        there, local = way.ahead, search
        if there < 1.0:
            place, base = space.between(easy, there), search.base
            with contextlib.suppress(RefusedGait):
                base = place.guess()
            local = search.elsewhere(place, base)
        local.slopes = found.search.slopes
        candidate = _moved_on(local, found.candidate)
        search.report(f"{there:.0%} of the way: {candidate.why or 'done'}")
        if candidate.orbit is None:
            found.why = candidate.why or found.why
            way.tried(reached=False)
            continue
        best = _minimise(local, candidate, ENOUGH if there == 1.0 else _EASY)
        if best.worst() < 0.0 and way.step > _LONG_STEP:
            way.tried(reached=False)
            continue
        found = Approach(there, local, best)
        too_far = best.worst() < _TOO_FAR
        way.tried(reached=True)
    return found


def _moved_on(search: ChoiceSearch, last: Candidate) -> Candidate:
    """The last choice, at the next place of the continuation; its COM lowered if the legs do not reach."""
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
            if candidate.orbit is not None:
                break
            candidate = search.evaluate(search.space.lowered(x, drop), last, again=True)
    return candidate


def _first_orbit(search: ChoiceSearch) -> Candidate | None:
    """The guess, its COM lowered until there is a periodic step."""
    for drop in _DROPS if "height" in search.space.names else _DROPS[:1]:
        x = search.space.lowered(search.guess, drop) if drop else search.guess.copy()
        candidate = search.evaluate(x, None)
        if candidate.orbit is not None:
            search.near = candidate
            return candidate
    return None


def _minimise(search: ChoiceSearch, start: Candidate, enough: float = ENOUGH) -> Candidate:
    """Minimise with target margins; if a hard limit is still broken, go on with small margins."""
    best = search.minimise(start, enough=enough)
    if best.worst() >= 0.0:
        return best
    harder = search.minimise(best, wanted=0.15, pull=0.02, enough=0.1)
    return max(best, harder, key=Candidate.worst)


def _confirmed(search: ChoiceSearch, best: Candidate) -> Tuned:
    """The choice with its plan over all steps and its motion on the fine grid, which may refuse it."""
    space, run = search.space, best.run
    try:
        plan = PeriodicPlanner().plan(run, search.orbits.robot)
    except BodilyRefusal as error:
        tried = len(search.candidates)
        raise NoFeasibleChoice(
            f"the best choice just fails: {str(error).partition(';')[0]} ({tried} choices tried)",
            broken=error.reason,
            tried=tried,
            choice=space.found(run),
            reason=error.reason,
            value=error.value,
            limit=error.limit,
            unit=error.unit,
            way_out=error.way_out,
        ) from error
    return Tuned(run.as_is(), plan, space.found(run), best.values, len(search.candidates))


def _own(space: FreeChoices, robot: Robot) -> Tuned | None:
    """The gait with the values that it has, a preset's own or defaults, if the body accepts the plan."""
    run, orbits = space.run, RoughOrbits(robot, space.run)
    try:
        plan = PeriodicPlanner().plan(run, robot)
        orbit = orbits.solve(plan, run, motion=cast(PeriodicPosture, plan.posture).motion)
    except (RefusedGait, InputError, Unreachable):
        return None
    values = plan_margins(plan, run, space.description) | orbit_margins(orbit, plan, robot)
    return Tuned(run.as_is(), plan, space.found(run), least(values), 1)

"""Search for the values that a gait leaves open, on plan and inverse kinematics alone.

The paper fixes a gait by step, speed, c_s and c_y and leaves the rest to be "set manually": how much of the
step is single support, how far the ZMP rolls under the foot, how high the COM is, when and how far the feet
turn, how the trunk leans. Here these are unknowns of a nonlinear least-squares problem. Every limit of body
and floor has a normalised margin: 0 where the limit is met exactly, 1 at its target. The shortfall to 1 is a
residual, and so is, weakly, the distance to a closed-form guess, which makes the solution unique where no
limit binds. Plan, feet, the periodic step of the inverse kinematics on a coarse grid, and the joint torques
of that step under the planned ground force are evaluated: no simulation.

In order: the values that there are, a preset's own or defaults, which stay if every limit is kept with room
to spare; the guess and least squares from there, with L_z held at zero where the feet would twist the floor;
the values that there are, if they keep the limits at all; least squares from other starts.
"""

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ampm.body.feasibility import joint_groups
from ampm.body.inverse_kinematics import InverseKinematics, Unreachable
from ampm.body.limits import LIMITS
from ampm.body.return_map import Orbit
from ampm.body.robot import Robot
from ampm.exceptions import BodilyRefusal, InputError, RefusedGait
from ampm.parameters import RunParameters
from ampm.planner.closed_form import LIPM
from ampm.planner.periodic import plan_gait
from ampm.planner.support import StepPlan, plan_steps
from ampm.planners import PeriodicPlanner
from ampm.tune.free_choices import FreeChoices
from ampm.tune.gait_limits import least_margin, orbit_margins, plan_margins, step_torques, tightest
from ampm.tune.search import Candidate, ChoiceSearch, Effort, rough_orbit
from ampm.tune.ways_out import ways_out
from ampm.walk import WalkPlan

Report = Callable[[str], None]

_DROPS = (0.0, 0.012, 0.025, 0.04, 0.06)  # how much lower the guess's COM is tried [statures]
_SPARE = 0.4  # margin with which the values that there are stay
_HOPELESS = -1.0  # margin below which no search with small margins follows
_STARTS = 64  # number of starts spread over the ranges, where the search from the guess finds nothing
_FROM_STARTS = 80  # most choices of the search from the best of these starts
_TO_FINISH = 60  # most choices of the search that goes on from the nearest one
_FARTHEST = -10.0  # margin of the best start below which there is no such search
_FOR_WAYS_OUT = 40  # most choices of all searches for a way out
_JUST_ENOUGH = 0.1  # margin that is enough for a way out, and for the search that goes on
_GRID = 0.1  # largest error of a margin on the coarse grid: 2 % of a torque limit
_LOST = 0.4  # least share of a torque limit that dampers, springs and dry friction take to be told of [1]
_L_Z = "body.angular_momentum_z"
_PELVIS = {"body.pelvis_list", "body.pelvis_rotation"}  # choices of searches from other starts alone


@dataclass(frozen=True)
class Tuned:
    """A run whose free choices are made."""

    run: RunParameters  # complete; every value counts as set
    plan: WalkPlan  # complete, with the periodic step on the fine grid
    values: Mapping[str, float | str]  # what was open, by namespaced key
    margins: Mapping[str, float]  # limit to value on the search's grid, in the unit of `LIMITS`
    tried: int  # how many choices were tried

    def worst(self) -> float:
        """Least normalised margin [1]."""
        return least_margin(self.margins)


def tune(run: RunParameters, robot: Robot, *, progress: Report | None = None, advise: bool = True) -> Tuned:
    """Find what a gait leaves open.

    Args:
        run: what is set of it stays (:attr:`ampm.parameters.RunParameters.given`).
        robot: the body.
        progress: called with a line of text now and then.
        advise: whether a refusal tells ways out, for which gaits near by are searched for.

    Returns:
        The complete run, its plan and its motion.

    Raises:
        InputError: the gait is the plain inverted pendulum's.
        MathematicalRefusal: no choice gives the formula a solution.
        NoFeasibleChoice: every choice breaks a limit.
    """
    if run.gait.planner == LIPM:  # its ZMP jumps, so no choice could keep it in a support that grows
        raise InputError(
            f"gait.planner = {LIPM!r} cannot be tuned; 'ampm validate' walks the preset ipm as it is, and "
            "its step length, speed and heights can be set.",
            key="gait.planner",
        )
    report = progress or (lambda text: None)

    def accepts(changed: RunParameters, choices: int) -> tuple[bool, int]:
        try:
            return True, _tuned(changed, robot, report, Effort(choices, _JUST_ENOUGH)).tried
        except (RefusedGait, InputError) as error:
            return False, getattr(error, "tried", 1)

    try:
        return _tuned(run, robot, report, Effort(starts=_STARTS))
    except RefusedGait as error:
        with contextlib.suppress(RefusedGait, InputError):
            PeriodicPlanner().plan(run, robot)
            error.add_note("as it is, the gait has a plan beyond these limits: --as-is tries it; it may fall")
        if advise:
            error.way_out = ways_out(run, robot.description, accepts, _FOR_WAYS_OUT)
        raise


def _tuned(run: RunParameters, robot: Robot, report: Report, effort: Effort) -> Tuned:
    """A run whose choices are made by a search of some effort; raises as :func:`tune`."""
    if not run.gait.c_y > 0.0:
        plan_gait(run.gait, run.body.mass)  # refuses it, with a better message than a failed search
    space = FreeChoices(run, run.given, robot.description, _PELVIS)
    _check_pace(space)
    present = _present(space, robot)
    if present is None:
        return _searched(space, robot, report, effort)
    if present.worst() < _SPARE:
        with contextlib.suppress(RefusedGait):
            return max(_searched(space, robot, report, replace(effort, starts=0)), present, key=Tuned.worst)
    return present


def _check_pace(space: FreeChoices) -> None:
    """Refuse steps that are too short in time whatever is chosen, before a search finds that out.

    The error is a NoFeasibleChoice.
    """
    try:
        duration = plan_gait(space.longest(), space.run.body.mass).constants.step_duration
    except (RefusedGait, InputError):
        return  # the COM hardly passes over the foot: no short step
    if duration < LIMITS["pace"].bound:
        raise broken_limit("pace", {"pace": duration}, tried=1)


def _present(space: FreeChoices, robot: Robot) -> Tuned | None:
    """The gait with the values that it has, a preset's own or defaults, if they keep the limits so far."""
    run = space.run
    try:
        steps = plan_steps(run.gait, run.body.mass, run.foot, space.sole)
        values = tightest(plan_margins(steps, run, space.description))
        if least_margin(values) >= -_GRID:  # else there is no use in a periodic step
            orbit = rough_orbit(InverseKinematics(robot, run), steps, run)
            values |= tightest(orbit_margins(orbit, steps, robot))
        if not least_margin(values) >= -_GRID:
            return None
        plan = PeriodicPlanner().plan(run, robot)
    except (RefusedGait, InputError, Unreachable):
        return None
    return Tuned(run.as_is(), plan, space.values(run), values, 1)


def _searched(space: FreeChoices, robot: Robot, report: Report, effort: Effort) -> Tuned:
    """The best choice of the first search that finds one, with its plan over all steps and its motion.

    Raises MathematicalRefusal without a guess, NoFeasibleChoice if none finds one, or its motion is refused.
    """
    searches: list[ChoiceSearch] = []
    refusal = None
    for search, best in _searches(space, robot, report, effort):
        searches.append(search)
        if best.worst() < 0.0:
            continue
        try:
            plan = PeriodicPlanner().plan(best.run, robot)
        except BodilyRefusal as error:
            values, refusal = best.values, error
        else:
            found = search.space.values(best.run)
            return Tuned(best.run.as_is(), plan, found, best.values, len(search.candidates))
    tried = sum(len(search.candidates) for search in searches)
    if refusal is None:
        raise no_feasible_choice(max(searches, key=lambda search: search.best().worst()), tried)
    raise NoFeasibleChoice(
        f"the best choice fails: {refusal.args[0]} (choices tried: {tried})",
        tried=tried,
        values=values,
        **{name: getattr(refusal, name) for name in ("reason", "value", "limit", "unit", "way_out")},
    ) from refusal


def _searches(
    space: FreeChoices, robot: Robot, report: Report, effort: Effort
) -> Iterator[tuple[ChoiceSearch, Candidate]]:
    """Searches in turn, each with its best choice.

    The first begins with the guess. Where that would twist the feet and the body has arms, L_z is held at
    zero: the arms then balance the legs about the vertical, which takes from the feet's twisting moment.
    Where it finds nothing, another one begins with the best of starts that are spread over the ranges, with
    list and rotation of the pelvis free, too. Where the better of both comes near to its limits, it goes on,
    however far from the guess.
    """
    first, start = _begun(space, robot, report, effort)
    twist = start.margins().get("twist", math.inf)
    if robot.description.has_arms and _L_Z not in space.fixed and twist < Effort().enough:
        still = FreeChoices(space.run.replace({_L_Z: "zero"}), space.fixed, robot.description, _PELVIS)
        balanced = _begun(still, robot, report, effort)
        first, start = (first, start) if balanced[1].orbit is None else balanced
    yield first, _improved(first, start)
    if not effort.starts or not space.names:
        return
    wide = ChoiceSearch(FreeChoices(space.run, space.fixed, robot.description), robot, report, effort)
    start = wide.spread(effort.starts)
    more = _FROM_STARTS if start.worst() > _FARTHEST else 0
    wide.effort = replace(effort, choices=len(wide.candidates) + more)
    yield wide, _improved(wide, start)
    nearest = max(first, wide, key=lambda search: search.best().worst())
    best = nearest.best()
    if _HOPELESS < best.worst() < _JUST_ENOUGH:
        last = ChoiceSearch(nearest.space, robot, report, Effort(_TO_FINISH, _JUST_ENOUGH))
        last.minimise(best, wanted=0.15, pull=0.0)
        yield last, last.best()


def _begun(
    space: FreeChoices, robot: Robot, report: Report, effort: Effort
) -> tuple[ChoiceSearch, Candidate]:
    """A search and where it begins: the guess, the COM lowered until there is a periodic step."""
    search = ChoiceSearch(space, robot, report, effort)
    for drop in _DROPS if "height" in space.names else _DROPS[:1]:
        start = search.evaluate(space.lowered(search.guess, drop))
        if start.orbit is not None:
            break
    return search, start


def _improved(search: ChoiceSearch, best: Candidate) -> Candidate:
    """The best choice of a search that goes on from one with a periodic step; without, the one itself."""
    if best.orbit is not None:
        best = search.minimise(best)
        if best.worst() < 0.0:  # a hard limit is broken
            if search.best().worst() > _HOPELESS:  # go on with small margins
                search.minimise(best, wanted=0.15, pull=0.02, enough=0.1)
            best = search.best()
    return best


class NoFeasibleChoice(BodilyRefusal):
    """No choice was found; value and limit are those of the best that was tried.

    Attributes:
        tried: how many choices had been tried.
        values: of all limits for the best choice, by name in :data:`LIMITS`; none without a periodic step.
    """

    def __init__(self, why: str, *, tried: int, values: Mapping[str, float], **refusal: Any) -> None:
        super().__init__(why, **refusal)
        self.tried, self.values = tried, values


def broken_limit(name: str, values: Mapping[str, float], tried: int, cause: str = "") -> NoFeasibleChoice:
    """The refusal by one limit.

    Args:
        name: in :data:`LIMITS`.
        values: of all known limits for the best choice.
        tried: number of choices; 1 where the best choice of all is known.
        cause: clause on what breaks it.
    """
    limit, value = LIMITS[name], values[name]
    reached, rule = limit.in_words(value)
    return NoFeasibleChoice(
        f"{_none(tried)}: {limit.what} is {reached} at best and must be {rule}{cause}",
        tried=tried,
        values=values,
        reason=limit.reason,
        value=value,
        limit=limit.bound,
        unit=limit.unit,
    )


def no_feasible_choice(search: ChoiceSearch, tried: int) -> NoFeasibleChoice:
    """The limit that stayed broken in the best of all choices, or why none has a periodic step."""
    best = search.best()
    if best.orbit is not None and best.plan is not None:
        margins = best.margins()
        if any(margin < 0.0 for name, margin in margins.items() if name.endswith("_torque")):
            margins.pop("hip_time", None)  # which follows from too little torque
        name = min(margins, key=lambda name: margins[name])
        return broken_limit(name, best.values, tried, _cause(name, best.plan, best.orbit, search.robot))
    causes = [candidate.why for candidate in search.candidates if candidate.why is not None]
    why = max(causes, key=lambda cause: cause.time, default=None)  # of the choice that came farthest
    return NoFeasibleChoice(
        f"{_none(tried)}: {why or 'the formula has no solution'}",
        tried=tried,
        values=best.values,
        reason="no_periodic_motion",
        value=math.nan,
        limit=math.nan,
        unit="1",
    )


def _cause(name: str, plan: StepPlan, orbit: Orbit, robot: Robot) -> str:
    """A clause on what breaks a limit in a periodic step, and keys of the body that may mend it."""
    step, names, reason = orbit.trajectory, robot.joint_names, LIMITS[name].reason
    if reason == "torque_limits":
        torque, _ = step_torques(step, orbit.reference.time, plan, robot)
        damping, stiffness, spring, friction = robot.passive.T
        q, v, limit = step.q[:, 7:], step.v[:, 6:], robot.torque_limit
        lost = damping * v + stiffness * (q - spring) + friction * np.sign(v)
        share, alone, left = (np.abs(part / limit).max(axis=0) for part in (torque, lost, torque - lost))
        most = int(alone.argmax())
        if alone[most] > _LOST and left.max() <= 1.0:
            return (
                f"; dampers, springs and dry friction alone take {alone[most]:.2f} of the torque limit of "
                f"{names[most]}: if it is not so, correct [body.damping], [body.stiffness], [body.friction] "
                "or [body.effort]"
            )
        over = [f"{names[j]} {share[j]:.2f}" for j in np.argsort(-share)[:3] if share[j] > 1.0]
        return f"; torque over its limit: {', '.join(over)}" if over else ""
    if reason == "speed_limits":
        share = np.abs(step.v[:, 6:]).max(axis=0) / robot.speed_limit
        return f"; speed over its limit: {names[int(share.argmax())]} {share.max():.2f}"
    if reason == "self_collision":
        gaps = robot.step_gaps(step.q)
        return f"; they are {gaps.parts[int(gaps.distance.argmin())]}"
    if reason == "joint_limits":
        joints = robot.velocity_indices(joint_groups(robot.description)[name.partition("_")[0]]) - 6
        room = np.minimum(step.q[:, 7:] - robot.lower, robot.upper - step.q[:, 7:]).min(axis=0)
        nearest = int(joints[room[joints].argmin()])
        along, across, _ = np.abs(robot.rigid_body.tree["axis"][1 + nearest]).tolist()
        bends = name == "ankle" and across > along and not robot.description.sole.has_toes
        less = ": a sole that ends nearer to the ankle bends it less: lower front in [body.sole]" * bends
        return f"; the nearest is {names[nearest]}{less}"
    return ""


def _none(tried: int) -> str:
    """What was found of so many choices that were tried, in words."""
    choices = "of timing, heights and angles"
    if tried == 1:
        return f"no choice {choices} lets this body walk the gait"
    return f"found none in {tried} choices {choices} with which this body walks the gait"

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
the values that there are, if they keep the limits at all.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from ampm.body.inverse_kinematics import Unreachable
from ampm.body.limits import LIMITS
from ampm.body.robot import Robot
from ampm.exceptions import BodilyRefusal, InputError, RefusedGait
from ampm.parameters import RunParameters
from ampm.planner.closed_form import LIPM
from ampm.planner.periodic import plan_gait
from ampm.planners import PeriodicPlanner
from ampm.tune.free_choices import FreeChoices
from ampm.tune.gait_limits import least, orbit_margins, plan_margins
from ampm.tune.refusal import NoFeasibleChoice, broken_limit, no_feasible_choice
from ampm.tune.search import ChoiceSearch, Effort, RoughOrbits
from ampm.tune.ways_out import ways_out
from ampm.walk import WalkPlan

Report = Callable[[str], None]

_DROPS = (0.0, 0.012, 0.025, 0.04, 0.06)  # how much lower the guess's COM is tried [statures]
_SPARE = 0.4  # margin with which the values that there are stay
_HOPELESS = -1.0  # margin below which no search with small margins follows
_CHOICES = 110  # of the search and all searches for a way out
_OF_A_WAY_OUT = 0.1  # margin that is enough for a way out
_GRID = 0.1  # margin that a coarse grid may be wrong by: 2 % of a torque limit
_L_Z = "body.angular_momentum_z"


@dataclass(frozen=True)
class Tuned:
    """A run whose free choices are made.

    Attributes:
        run: complete; every value counts as set.
        plan: complete, with the periodic step on the fine grid.
        values: what was open, by namespaced key.
        margins: limit to value on the search's grid, in the unit of :data:`LIMITS`.
        tried: how many choices were tried.
    """

    run: RunParameters
    plan: WalkPlan
    values: Mapping[str, float | str]
    margins: Mapping[str, float]
    tried: int

    def margin(self, name: str) -> float:
        """Normalised margin of one limit [1]."""
        return LIMITS[name].margin(self.margins[name])

    def worst(self) -> float:
        """Least normalised margin [1]."""
        return min(map(self.margin, self.margins))


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
            return True, _tuned(changed, robot, report, Effort(choices, _OF_A_WAY_OUT)).tried
        except (RefusedGait, InputError) as error:
            return False, getattr(error, "tried", 1)

    try:
        return _tuned(run, robot, report, Effort())
    except RefusedGait as error:
        if advise:
            left = _CHOICES - getattr(error, "tried", 1)
            error.way_out = ways_out(run, robot.description, accepts, left)
        raise


def _tuned(run: RunParameters, robot: Robot, report: Report, effort: Effort) -> Tuned:
    """A run whose choices are made by a search of some effort.

    Raises:
        InputError, MathematicalRefusal, NoFeasibleChoice: as :func:`tune`.
    """
    if not run.gait.c_y > 0.0:
        plan_gait(run.gait, run.body.mass)  # refuses it, with a better message than a failed search
    space = FreeChoices(run, run.given, robot.description)
    _check_pace(space)
    present = _present(space, robot)
    if present is not None and present.worst() >= _SPARE:
        return present
    try:
        tuned = _searched(space, robot, report, effort)
    except RefusedGait as error:
        if present is None:
            raise
        if present.worst() >= -_GRID:
            return present
        error.add_note("as it is, the gait has a plan beyond these limits: --as-is walks it")
        raise
    return tuned if present is None or tuned.worst() >= present.worst() else present


def _check_pace(space: FreeChoices) -> None:
    """Refuse steps that are too short in time whatever is chosen, before a search finds that out.

    Raises:
        NoFeasibleChoice: they are.
    """
    try:
        duration = plan_gait(space.longest(), space.run.body.mass).constants.step_duration
    except (RefusedGait, InputError):
        return  # the COM hardly passes over the foot: no short step
    if duration < LIMITS["pace"].bound:
        raise broken_limit("pace", {"pace": duration}, tried=1)


def _present(space: FreeChoices, robot: Robot) -> Tuned | None:
    """The gait with the values that it has, a preset's own or defaults, if the body accepts the plan."""
    run = space.run
    try:
        plan = PeriodicPlanner().plan(run, robot)
        orbit = RoughOrbits(robot, run).solve(plan, run)
    except (RefusedGait, InputError, Unreachable):
        return None
    values = plan_margins(plan, run, space.description) | orbit_margins(orbit, plan, robot)
    return Tuned(run.as_is(), plan, space.values(run), least(values), 1)


def _searched(space: FreeChoices, robot: Robot, report: Report, effort: Effort) -> Tuned:
    """The best choice of a search; with L_z held at zero where the guess would twist the feet.

    The arms then balance the legs about the vertical, which takes from the feet's twisting moment.

    Raises:
        RefusedGait: there is none.
    """
    search = _begun(space, robot, report, effort)
    twist = search.candidates[-1].margins().get("twist", math.inf)
    if _L_Z not in space.fixed and twist < Effort().enough:
        still = FreeChoices(space.run.replace({_L_Z: "zero"}), space.fixed, robot.description)
        balanced = _begun(still, robot, report, effort)
        if balanced.candidates[-1].orbit is not None:
            search = balanced
    return _confirmed(search)


def _begun(space: FreeChoices, robot: Robot, report: Report, effort: Effort) -> ChoiceSearch:
    """A search with the guess as its first choice, the COM lowered until there is a periodic step.

    Raises:
        MathematicalRefusal: there is no guess.
    """
    search = ChoiceSearch(space, RoughOrbits(robot, space.run), report, effort)
    for drop in _DROPS if "height" in space.names else _DROPS[:1]:
        if search.evaluate(space.lowered(search.guess, drop)).orbit is not None:
            break
    return search


def _confirmed(search: ChoiceSearch) -> Tuned:
    """The best choice of a search that has begun, with its plan over all steps and its motion.

    Raises:
        NoFeasibleChoice: there is none, or the motion is refused.
    """
    space, best = search.space, search.candidates[-1]
    if best.orbit is not None:
        best = search.minimise(best)
    if best.worst() < 0.0 and best.orbit is not None:  # a hard limit is broken
        if search.best().worst() > _HOPELESS:  # go on with small margins
            search.minimise(best, wanted=0.15, pull=0.02, enough=0.1)
        best = search.best()
    if best.worst() < 0.0:
        raise no_feasible_choice(search)
    try:
        plan = PeriodicPlanner().plan(best.run, search.orbits.robot)
    except BodilyRefusal as error:
        tried = len(search.candidates)
        raise NoFeasibleChoice(
            f"the best choice just fails: {error.args[0]} ({tried} choices tried)",
            tried=tried,
            values=best.values,
            reason=error.reason,
            value=error.value,
            limit=error.limit,
            unit=error.unit,
        ) from error
    return Tuned(best.run.as_is(), plan, space.values(best.run), best.values, len(search.candidates))

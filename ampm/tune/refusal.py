"""Refusal of a gait that no choice makes walkable: the limit that stayed broken, and the best value."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ampm.body.limits import LIMITS
from ampm.body.robot import Robot
from ampm.body.step_kinematics import StepTrajectory
from ampm.exceptions import BodilyRefusal
from ampm.tune.search import ChoiceSearch

_LOST = 0.4  # least share of a torque limit that dampers, springs and dry friction take to be told of [1]


class NoFeasibleChoice(BodilyRefusal):
    """No choice was found; value and limit are those of the best that was tried.

    Attributes:
        tried: how many choices had been tried.
        values: of all limits for the best choice, by name in :data:`LIMITS`.
    """

    def __init__(self, why: str, *, tried: int, values: Mapping[str, float], **refusal: Any) -> None:
        super().__init__(why, **refusal)
        self.tried, self.values = tried, values


def broken_limit(name: str, values: Mapping[str, float], tried: int, keys: str = "") -> NoFeasibleChoice:
    """The refusal by one limit.

    Args:
        name: in :data:`LIMITS`.
        values: of all known limits for the best choice.
        tried: number of choices; 1 where the best choice of all is known.
        keys: clause on keys of the body's description that may mend it.
    """
    limit, value = LIMITS[name], values[name]
    reached, rule = limit.told(value)
    return NoFeasibleChoice(
        f"{_none(tried)}: {limit.what} is {reached} at best and must be {rule}{keys}",
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
    if best.orbit is not None:
        margins = best.margins()
        name = min(margins, key=lambda name: margins[name])
        keys = _keys_that_help(LIMITS[name].reason, search.orbits.robot, best.orbit.trajectory)
        return broken_limit(name, best.values, tried, keys)
    why = next((candidate.why for candidate in search.candidates if candidate.why is not None), None)
    return NoFeasibleChoice(
        f"{_none(tried)}: {why or 'the formula has no solution'}",
        tried=tried,
        values=best.values,
        reason="no_periodic_motion",
        value=0.0 if why is None else why.value,
        limit=0.0 if why is None else why.limit,
        unit="1" if why is None else why.unit,
    )


def _keys_that_help(reason: str, robot: Robot, step: StepTrajectory) -> str:
    """A clause on keys of the description that may mend a refusal, by its reason; empty if none may."""
    d = robot.description
    if reason == "self_collision" and d.has_arms and not (d.spread or d.rest):
        return "; arms that rest farther from the body may help: give [body.rest]"
    if reason == "torque_limits":
        damping, stiffness, spring, friction = robot.passive.T
        q, v = step.q[:, 7:], step.v[:, 6:]
        lost = np.abs(damping * v + stiffness * (q - spring) + friction * np.sign(v)) / robot.torque_limit
        joint = int(lost.max(axis=0).argmax())
        if (most := float(lost[:, joint].max())) > _LOST:
            return (
                f"; dampers, springs and dry friction alone take {most:.2f} of the torque limit of "
                f"{robot.joint_names[joint]}: correct them with [body.damping] and [body.friction], or "
                "[body.effort]"
            )
    return ""


def _none(tried: int) -> str:
    """What was found of so many choices that were tried, in words."""
    none = "no choice" if tried == 1 else f"none of {tried} choices"
    return f"{none} of timing, heights and angles lets this body walk the gait"

"""From a gait that names little to a complete run."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from ampm.exceptions import InputError
from ampm.tune.free_choices import FREE_KEYS, named_keys
from validation.progress import Progress
from validation.trial.plan import PlannedWalk, Request, make_body, motion_cache

if TYPE_CHECKING:
    from ampm.tune.tuning import Tuned


@dataclass(frozen=True)
class TunedWalk(PlannedWalk):
    """A walk whose free choices are made; its plan is the one that the search has confirmed.

    Attributes:
        tuned: choices and margins.
    """

    tuned: Tuned = field(kw_only=True)


def tune_walk(request: Request, progress: Progress | None = None) -> TunedWalk:
    """Make the free choices of a gait; what a preset, a file or a setting names stays as it is.

    Args:
        request: the gait; ``request.run`` knows which keys were named.
        progress: where to report stages.

    Raises:
        InputError: every free choice is named already.
        MathematicalRefusal, BodilyRefusal: no choice walks; :class:`ampm.tune.refusal.NoFeasibleChoice`,
            a BodilyRefusal, says which limit stayed broken.
    """
    from ampm.tune.tuning import tune  # here, not above: Pinocchio takes long to load

    if set(FREE_KEYS) <= named_keys(request.run):
        raise InputError(
            f"{request.name} names every free choice, so there is nothing to tune; leave out what is to be "
            "found, for example gait.com_height."
        )
    with (progress or Progress()).stage(f"{request.name}: free choices") as stage:
        body = make_body(request.run)
        tuned = tune(request.run, body.robot, progress=stage.note, cache=motion_cache())
    return TunedWalk(Request(request.name, tuned.run), tuned.plan, body, tuned=tuned)

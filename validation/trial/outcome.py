"""How a run ends: a name and a sentence."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum


class OutcomeName(StrEnum):
    """How a run ended."""

    COMPLETED = "completed"
    FELL = "fell"
    DIVERGED = "diverged"
    INFEASIBLE = "infeasible"
    CRASHED = "crashed"
    INTERRUPTED = "interrupted"


SENTENCES: Mapping[OutcomeName, str] = {
    OutcomeName.COMPLETED: "The walk lasted to its end.",
    OutcomeName.FELL: "The body fell.",
    OutcomeName.DIVERGED: "The numbers of the walk diverged.",
    OutcomeName.INFEASIBLE: "The controller's QP stayed unsolved.",
    OutcomeName.CRASHED: "A controller, planner, estimator or disturbance failed.",
    OutcomeName.INTERRUPTED: "The run was interrupted.",
}
"""Meaning of each name."""


@dataclass(frozen=True)
class Outcome:
    """How a run ended, when, and why."""

    name: OutcomeName  # the kind of end
    time: float  # simulated time at the end [s]
    cause: str  # the first cause, one sentence; empty if the run completed
    steps_completed: int  # whole steps walked, 0 or more

    def __post_init__(self) -> None:
        object.__setattr__(self, "name", OutcomeName(self.name))

    @property
    def summary(self) -> str:
        """Steps and name, for summaries."""
        return f"{self.steps_completed} step{'s' * (self.steps_completed != 1)}, {self.name}"

    @property
    def completed(self) -> bool:
        """Whether the whole plan was walked."""
        return self.name is OutcomeName.COMPLETED

    @property
    def ending(self) -> str:
        """How, when and why a walk ended before its plan did, a sentence; empty if it completed."""
        if self.completed:
            return ""
        when = f" at {self.time:.3f} s"
        when, cause = "" if when in self.cause else when, f": {self.cause.rstrip('.')}" if self.cause else ""
        return f"{SENTENCES[self.name][:-1]}{when}{cause}."

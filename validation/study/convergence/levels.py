"""Levels of the studies, one parameter at a time about the gait's own, and the walk of one level."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from ampm.exceptions import InputError
from ampm.parameters import RunParameters
from validation.judge.metrics import evaluate
from validation.run.walk import walk_planned
from validation.store.identity import parameter_values
from validation.study.row_file import Row
from validation.trial.engine import check_drake, drake_of
from validation.trial.plan import Request, plan_walk

LEVELS = 4
"""Levels of a numerical study by default: two triplets, the least that can confirm an order."""
OWN = "own"
"""Task of the walk at the gait's own values, which all studies share."""
_SHOWN = {"s": (1e3, " ms"), "m": (1e3, " mm")}


@dataclass(frozen=True)
class Study:
    """Levels of one parameter: a step or tolerance whose limit is zero, or a parameter of the model.

    Attributes:
        name: of the study.
        key: of the parameter.
        unit: SI unit of its values.
        title: as text.
        ratio: of neighbouring levels of a numerical study, 0 of a parameter of the model.
        factors: on the own value, of a parameter of the model, the own one among them.
        alternatives: values beside the own one, of a parameter that is no number.
        values: of the key. Those of a numerical study fall from the own value.
        own: index of the gait's own value.
    """

    name: str
    key: str
    unit: str
    title: str
    ratio: float = 0.0
    factors: tuple[float, ...] = ()
    alternatives: tuple[str, ...] = ()
    values: tuple[Any, ...] = ()
    own: int = 0

    @property
    def numerical(self) -> bool:
        """Whether its levels approach a limit."""
        return self.ratio > 0.0

    @property
    def shown(self) -> tuple[str, ...]:
        """The values as texts, with their unit."""
        if self.alternatives:
            return self.values
        factor, unit = _SHOWN.get(self.unit, (1.0, ""))
        return tuple(f"{factor * value:.4g}{unit}" for value in self.values)

    @property
    def tasks(self) -> tuple[str, ...]:
        """Task of each level."""
        names = [f"{self.name} {text}" for text in self.shown]
        names[self.own] = OWN
        return tuple(names)

    def applies(self, run: RunParameters) -> bool:
        """Whether the run has the parameter: DAQP has no tolerance, and MuJoCo none of Drake's contact."""
        if self.key.startswith("drake."):
            return run.simulation.engine == "drake"
        return self.name != "qp_tolerance" or run.solver.qp != "daqp"

    def of_run(self, run: RunParameters, levels: int) -> "Study":
        """The study with the values about a run's own; those that the model cannot have are left out."""
        own = parameter_values(run)[self.key]
        if self.numerical:  # rounded, so that a tenth of 5e-5 is written as 5e-6
            finer = (float(f"{own / self.ratio**level:.15g}") for level in range(1, levels))
            return replace(self, values=(own, *finer))
        if self.alternatives:
            wanted: tuple[Any, ...] = (own, *(name for name in self.alternatives if name != own))
        else:
            wanted = tuple(own * factor for factor in self.factors)
        values = tuple(value for value in wanted if _is_allowed(run, self.key, value))
        return replace(self, values=values, own=values.index(own))


def _is_allowed(run: RunParameters, key: str, value: Any) -> bool:
    """Whether the model can have a value, and its engine is installed."""
    try:
        if drake_of(run.replace({key: value})) is not None:
            check_drake()
    except InputError:
        return False
    return True


_ROOT = 0.5**0.5
STUDIES = (
    Study("time_step", "simulation.time_step", "s", "time step of the physics", 2.0),
    Study("ik_grid", "solver.ik_time_step", "s", "grid of the inverse kinematics", 2.0),
    Study("qp_tolerance", "solver.tolerance", "1", "tolerance of the controller's QP", 10.0),
    # The stiffness of MuJoCo's contact is proportional to the inverse square of the time constant.
    Study(
        "contact_stiffness",
        "contact.time_constant",
        "s",
        "contact half and twice as stiff",
        factors=(1.0 / _ROOT, 1.0, _ROOT),
    ),
    Study(
        "contact_depth",
        "contact.impedance_width",
        "m",
        "contact that hardens over twice and half the depth",
        factors=(2.0, 1.0, 0.5),
    ),
    Study(
        "contact_damping",
        "contact.damping_ratio",
        "1",
        "contact with half and twice the damping",
        factors=(0.5, 1.0, 2.0),
    ),
    Study(
        "contact_impedance",
        "contact.impedance_min",
        "1",
        "contact that is half and 1.5 times as hard at first touch",
        factors=(0.5, 1.0, 1.5),
    ),
    Study(
        "drake_stiffness",
        "drake.stiffness",
        "N/m",
        "Drake's contact half and twice as stiff",
        factors=(0.5, 1.0, 2.0),
    ),
    Study(
        "drake_dissipation",
        "drake.dissipation",
        "s/m",
        "Drake's contact with half and twice the dissipation",
        factors=(0.5, 1.0, 2.0),
    ),
    Study("engine", "simulation.engine", "1", "engine of the physics", alternatives=("mujoco", "drake")),
)
"""All studies, without values. Contact parameters and engine belong to the model: their values approach no
limit, so they give a spread, and no convergence. MuJoCo and Drake have contact parameters of their own.
Without Drake the study of the engine is left out."""


def studies(run: RunParameters, names: Sequence[str] = (), *, levels: int = LEVELS) -> list[Study]:
    """Studies of a run, in the order of :data:`STUDIES`.

    Args:
        run: the gait's own parameters.
        names: which, all by default.
        levels: of every numerical study, 3 at least.

    Raises:
        InputError: an unknown study, or too few or too many levels.
    """
    known = [study.name for study in STUDIES]
    for name in names:
        if name not in known:
            raise InputError(f"study {name!r} is unknown; use one of {', '.join(known)}.", value=name)
    if not 3 <= levels <= 6:
        raise InputError(
            f"--levels {levels}: an observed order takes 3 levels, a confirmed one 4, and beyond 6 a record "
            "does not fit into the memory; choose 3 ... 6."
        )
    chosen = [study for study in STUDIES if study.applies(run) and study.name in (names or known)]
    found = [study.of_run(run, levels) for study in chosen]
    return [study for study in found if len(study.values) > 1]


def runs_of(run: RunParameters, found: Sequence[Study]) -> dict[str, RunParameters]:
    """Complete parameters of every level, by task; one thing changes at a time."""
    runs = {OWN: run}
    for study in found:
        for task, value in zip(study.tasks, study.values, strict=True):
            runs.setdefault(task, run.replace({study.key: value}))
    return runs


def walk_level(request: Request, controller: Any = None, planner: Any = None, estimator: Any = None) -> Row:
    """Plan and walk one level, on a worker.

    Returns:
        ``outcome`` and ``cause``; ``values`` of all metrics in SI units; ``scales``, reference quantities of
        the walk.
    """
    planned = plan_walk(request, planner=planner)
    walk = walk_planned(planned, controller=controller, estimator=estimator).comparison
    end = walk.record.outcome
    return {
        "outcome": str(end.name),
        "cause": end.cause,
        "values": {name: metric.value for name, metric in evaluate(walk).items()},
        "scales": dict(walk.scales),
    }

"""Tolerance profiles: how far physics may be from the formula.

The limits and their reasons are listed in ``limits.csv`` for the default body. They were set before the runs
that they judge, except those on slip and the RMS limits of ``odometry``, which were entered after first
runs (up to 3.3 mm). Loosening one needs a line in the changelog.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Self

import numpy as np

from ampm.exceptions import InputError
from ampm.parameters import NO_PLAN, RunParameters
from ampm.planner.closed_form import LIPM
from ampm.section import unknown
from validation.judge.compare import SIGNALS
from validation.judge.metrics import FOOT_LENGTH, FOOT_MOMENTUM, METRICS, size_in_si
from validation.trial.disturbances import Disturbance, Push, pushes_of


@dataclass(frozen=True)
class Tolerance:
    """One limit and its reason."""

    limit: float  # largest value that passes, in `unit`
    unit: str  # the metric's, or one that grows with the body: `body weight`, `foot length`, `foot momentum`
    reason: str  # why this number, one or two sentences

    def limit_for(self, scales: Mapping[str, Any]) -> Any:
        """The limit in SI units, for one body or several; scales as :attr:`Comparison.scales`."""
        limit = self.limit * size_in_si(self.unit, scales)
        # The normalisation's rounding is undone.
        return np.round(limit, 12) if self.unit in (FOOT_LENGTH, FOOT_MOMENTUM) else limit


_NAMES: set[str] = set()  # of all profiles that were made


@dataclass(frozen=True)
class Profile:
    """A named set of tolerances, read from the registry of metrics."""

    name: str  # as given to `--profile`
    base: Self | None = None  # profile whose limit holds for a metric that names none for this one
    leaves_out: tuple[str, ...] = ()  # metrics that it does not judge

    def __post_init__(self) -> None:
        """Remember the name, for :func:`find_profile`; refuse a base that is no profile."""
        if not isinstance(self.base, Profile | None):
            raise InputError(f"profile {self.name!r} has the base {self.base!r}; give a Profile, or None.")
        _NAMES.add(self.name)

    @property
    def tolerances(self) -> Mapping[str, Tolerance]:
        """Limits of all judged metrics by name, in the order in which they are reported."""
        known = {} if self.base is None else {**self.base.tolerances}
        for name, metric in METRICS.items():
            if self.name in metric.tolerances:
                unit = metric.tolerance_unit or metric.unit
                known[name] = Tolerance(metric.tolerances[self.name] or 0.0, unit, metric.reason)  # no -0
        return {name: known[name] for name in METRICS if name in known and name not in self.leaves_out}

    def limits(self, scales: Mapping[str, Any]) -> Mapping[str, Any]:
        """Limits of all judged metrics in SI units, by name."""
        return MappingProxyType({name: item.limit_for(scales) for name, item in self.tolerances.items()})


# For every gait of the paper, induced angular momentum included (preset `momentum`: c_s 1.2, c_y 0.4). The
# trunk then swings to carry the momentum, and every change of contact disturbs more inertia: the limits are a
# quarter to a half above those of `strict`, those on single instants two and a half times.
DEFAULT = Profile("default")
# For walks without induced angular momentum (preset `normal`: c_s = c_y = 1).
STRICT = Profile("strict", DEFAULT)
# For plans whose acceleration jumps, with contacts that open at once (preset `ipm`): a torque is held
# for a tick and cannot jump within it, so the ZMP is on the wrong side of each jump for up to half a tick.
# That of `ipm` jumps by J = 0.24 m along x and 0.08 m along y twice in a step of D = 0.775 s. With torques
# held for T = 2 ms each jump comes up to T/2 early or late, an RMSE of J (T/2D)^1/2 = 8.6 and 2.9 mm.
JUMPS = Profile("jumps", DEFAULT)
_AT_ONCE = 0.002  # longest ramp of such contacts [s]
# For walks over footsteps: no motion is solved before them, so the angular momentum that keeps the trunk
# upright while legs and arms swing, 0.47 N m s for `normal`, is found while walking.
FOOTSTEPS = Profile("footsteps", DEFAULT)
# For walks whose state comes from an estimator without fixes of the position: the ZMP is judged from the
# standing foot and not in the world, which drifts.
_IN_THE_WORLD = tuple(f"zmp_{axis}_{statistic}" for axis in "xy" for statistic in ("rmse", "maximum"))
ODOMETRY = Profile("odometry", DEFAULT, leaves_out=_IN_THE_WORLD)
# Limits of ``odometry``, then those of ``footsteps``, then those of ``default``.
ODOMETRY_STEPS = Profile("odometry-footsteps", replace(ODOMETRY, base=FOOTSTEPS), _IN_THE_WORLD)
# For walks that something pushes: the errors of ZMP, force and angular momentum have to be within the limits
# again soon after the push, and no parts of the body may meet.
_ERRORS = tuple(f"{signal}_{statistic}" for signal in SIGNALS for statistic in ("rmse", "maximum"))
PUSHED = Profile("pushed", DEFAULT, leaves_out=(*_ERRORS, "slip_maximum"))
# For walks without a plan: mean velocity, slip, clearance, speed of the joints and the checks of the
# measurement; a walk may fly.
FREE = Profile("free", DEFAULT, leaves_out=(*_ERRORS, "plan_newton_residual", "unsupported_instants"))
PROFILES: Mapping[str, Profile] = MappingProxyType(
    {item.name: item for item in (DEFAULT, STRICT, JUMPS, FOOTSTEPS, ODOMETRY, ODOMETRY_STEPS, PUSHED, FREE)}
)


def own_profile(run: RunParameters, disturbances: Sequence[Disturbance] = ()) -> Profile:
    """Profile of a run, if none is given: by plan, footsteps, estimator and pushes.

    A :class:`Push` among the disturbances, which are beside those of the run, asks for ``pushed``.
    """
    if run.gait.planner == NO_PLAN:
        return FREE
    if any(isinstance(item, Push) for item in (*pushes_of(run.disturbance), *disturbances)):
        return PUSHED
    return unpushed_profile(run)


def unpushed_profile(run: RunParameters) -> Profile:
    """Profile of a walk with a plan that nothing pushes, see :func:`own_profile`."""
    if run.sensors.relative:
        return ODOMETRY_STEPS if run.footsteps else ODOMETRY
    if run.footsteps:
        return FOOTSTEPS
    return JUMPS if run.gait.planner == LIPM and run.controller.contact_ramp <= _AT_ONCE else DEFAULT


def find_profile(name: Profile | str) -> Profile:
    """The profile of a name; InputError if it, its metrics or a limit's are unknown, or it has our name."""
    if not isinstance(name, Profile) and str(name) not in PROFILES:
        raise unknown(str(name), PROFILES, "profile")
    found = name if isinstance(name, Profile) else PROFILES[name]
    if PROFILES.get(found.name, found) != found:
        raise InputError(f"profile '{found.name}' is built in; give yours another name.")
    if wrong := set(found.leaves_out) - METRICS.keys():
        raise unknown(min(wrong), METRICS, f"metric that profile '{found.name}' leaves out:")
    for metric in METRICS.values():
        if wrong := metric.tolerances.keys() - _NAMES - {found.name}:
            raise unknown(min(wrong), sorted(_NAMES), f"profile for a limit of '{metric.name}':")
    return found

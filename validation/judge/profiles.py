"""Tolerance profiles: how far physics may be from the formula, and why that far.

A tolerance is a statement about the testbed, made before a run and not fitted to one. Loosening one is a
change worth a line in the changelog.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

from ampm.exceptions import InputError

BODY_WEIGHT = "body weight"
"""Unit of limits on forces: they are judged in newton, as a share of the weight that was simulated."""


@dataclass(frozen=True)
class Tolerance:
    """One limit and its reason.

    Attributes:
        metric: name in :attr:`validation.judge.compare.Comparison.metrics`.
        limit: largest value that passes, in ``unit``.
        unit: ``m``, ``body weight``, ``N m s`` or ``1``.
        reason: why this number, one or two sentences.
    """

    metric: str
    limit: float
    unit: str
    reason: str


@dataclass(frozen=True)
class Profile:
    """A named set of tolerances.

    Attributes:
        name: as given to ``--profile``.
        description: what it is for, one sentence.
        tolerances: in the order in which they are reported.
    """

    name: str
    description: str
    tolerances: tuple[Tolerance, ...]

    def scaled(self, factor: float, name: str, description: str, *, also: Collection[str] = ()) -> Profile:
        """The same, with ``factor`` on what compares walk and plan, and on the metrics of ``also``."""
        limits = tuple(
            replace(
                item,
                limit=item.limit * factor,
                reason=f"{factor:g} times the limit of '{self.name}'. {item.reason}",
            )
            if item.metric in _GAIT_METRICS or item.metric in also
            else item
            for item in self.tolerances
        )
        return Profile(name, description, limits)


_ZMP = (
    "The ZMP is the most sensitive signal: at a COM height of 0.9 m, 1 mm is an error of 1 mm in the COM, of "
    "0.11 % of body weight in the horizontal force, or of 0.6 N m in the moment about the COM. "
)
_WHY: Mapping[str, str] = MappingProxyType(
    {
        "zmp_x_rmse": _ZMP + "This is about one hundredth of the foot's length.",
        "zmp_y_rmse": _ZMP
        + "Half of what is allowed along x: the sole is narrow and no foot rolls sideways.",
        "zmp_x_maximum": "For a few milliseconds after every change of contact the load moves between points "
        "that still sink in or rise; the peak is bounded so that it stays well inside the sole.",
        "zmp_y_maximum": "As for x; half of it, as the sole is half as wide as it is long.",
        "force_x_rmse": "Wider than the ZMP alone would ask (0.22 %): a horizontal force at the foot turns "
        "the body as much as it pushes it, so the ZMP stays where it is, and only here the error shows.",
        "force_y_rmse": "As for x; less, as the lateral force is the smaller one.",
        "force_z_rmse": "The plan holds the COM at constant height; what is left is the floor's compliance "
        "at heel strike and lift-off.",
        "angular_momentum_x_rmse": "L_x has no free constant. Small against the several N m s that c_y "
        "induces, or induced momentum could not be told from none.",
        "angular_momentum_y_rmse": "Constant of the periodic motion included, so that a drifting trunk "
        "shows. Same size as for L_x.",
    }
)
_GAIT_METRICS = frozenset(_WHY)

_INSTRUMENT = (
    Tolerance(
        "zmp_agreement_rmse",
        0.5e-3,
        "m",
        "The two measurements of the ZMP share no force and no acceleration. Their gap is the time step's: "
        "first order in dt, about 0.3 mm at 2 ms. A quarter of the ZMP tolerance, so that the instrument is "
        "finer than what it measures; one contact missing from the log makes it more than 5 mm.",
    ),
    Tolerance(
        "force_agreement_rmse",
        0.002,
        BODY_WEIGHT,
        "F = m (a + g) is exact but for the time step. Half of the smallest tolerance on a force, so that "
        "the instrument is finer than what it measures.",
    ),
    Tolerance(
        "impulse_residual",
        1e-3,
        "1",
        "Over a run the floor carries the weight, but for the momentum gained. Only the integrator's "
        "order separates the two sums; a force law with a wrong scale would show at once.",
    ),
    Tolerance(
        "standing_weight_error",
        1e-6,
        "1",
        "Standing still, the body presses with exactly its weight, once contacts and controller have come to "
        "rest. After a second and a half about 1e-8 of their motion is left.",
    ),
    Tolerance(
        "com_agreement_maximum",
        1e-9,
        "m",
        "MuJoCo and Pinocchio hold the same masses and see the same q: only rounding may differ.",
    ),
    Tolerance(
        "angular_momentum_agreement_maximum",
        1e-8,
        "N m s",
        "As for the COM; rounding grows with the momenta that are summed.",
    ),
)
_RUN = (
    Tolerance(
        "failed_qp",
        0.0,
        "1",
        "The controller's fallback exists to survive a bad tick, not to walk: one unsolved QP means that the "
        "figures are not those of the controller that is documented.",
    ),
    Tolerance(
        "unsupported_instants",
        0.0,
        "1",
        "A walk has no flight, and an instant without a ZMP would silently be missing from its error.",
    ),
)


def _gait(limits: Mapping[str, float]) -> tuple[Tolerance, ...]:
    def unit(metric: str) -> str:
        return "m" if metric[:3] == "zmp" else BODY_WEIGHT if metric[:5] == "force" else "N m s"

    return tuple(Tolerance(metric, limits[metric], unit(metric), _WHY[metric]) for metric in _WHY)


STRICT = Profile(
    "strict",
    "For walks without induced angular momentum (preset `normal`: c_s = c_y = 1).",
    _gait(
        {
            "zmp_x_rmse": 2.0e-3,
            "zmp_y_rmse": 1.0e-3,
            "zmp_x_maximum": 15e-3,
            "zmp_y_maximum": 8e-3,
            "force_x_rmse": 0.006,
            "force_y_rmse": 0.004,
            "force_z_rmse": 0.007,
            "angular_momentum_x_rmse": 0.10,
            "angular_momentum_y_rmse": 0.10,
        }
    )
    + _INSTRUMENT
    + _RUN,
)

DEFAULT = Profile(
    "default",
    "For every gait of the paper, induced angular momentum included (preset `momentum`: c_s 1.2, c_y 0.4)."
    " The trunk then swings to carry the momentum, and every change of contact disturbs more inertia: the "
    "limits are a quarter to a half above those of `strict`, those on single instants two and a half times.",
    _gait(
        {
            "zmp_x_rmse": 2.5e-3,
            "zmp_y_rmse": 1.5e-3,
            "zmp_x_maximum": 40e-3,
            "zmp_y_maximum": 20e-3,
            "force_x_rmse": 0.008,
            "force_y_rmse": 0.006,
            "force_z_rmse": 0.010,
            "angular_momentum_x_rmse": 0.15,
            "angular_momentum_y_rmse": 0.15,
        }
    )
    + _INSTRUMENT
    + _RUN,
)

WIDE = DEFAULT.scaled(
    2.0,
    "wide",
    "For gaits with much angular momentum or speed (presets `roll-0.1` and `pitch`) and for sweeps far from "
    "the presets (c_y 0.2 ... 1.2, c_s 0.8 ... 1.4): twice `default` on the walk, and on the gap between "
    "both measured ZMPs, which is first order in the time step and grows with the rates of change of force "
    "and moment; the rest of the instrument has to be as good as ever.",
    also=("zmp_agreement_rmse",),
)

PROFILES: Mapping[str, Profile] = MappingProxyType({item.name: item for item in (DEFAULT, STRICT, WIDE)})


OWN: Mapping[str, str] = MappingProxyType({"roll-0.1": "wide", "pitch": "wide"})
"""Presets that are judged by another profile than `default` unless one is asked for."""


def own_profile(gait: str) -> Profile:
    """What a gait is judged by if nothing else is asked for."""
    return PROFILES[OWN.get(gait, DEFAULT.name)]


def profile(name: str) -> Profile:
    """Look up a profile.

    Raises:
        InputError: there is none of this name.
    """
    try:
        return PROFILES[name]
    except KeyError:
        raise InputError(f"profile '{name}' is unknown; use one of {', '.join(PROFILES)}") from None

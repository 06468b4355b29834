"""Whether feet and ZMP of a plan agree with its contacts."""

import numpy as np

from ampm.geometry import polygon_margin
from ampm.planner.contacts import footprint
from ampm.planner.support import StepPlan

NEXT = 3
"""Phases of a plan made on the way that are checked, in 1 ms; later ones are checked when they come near."""
_OFF = 5e-3  # of a sole point on the floor from its footstep [m]
_OUTSIDE = 0.02  # of the ZMP from the support: a plan by optimisation may give way a little [m]
PUSHED_OUTSIDE = 0.1
"""The same of a plan made on the way: after a push its ZMP may not suffice to stay inside [m]."""
_POINTS = [0, 5, 1, 4, 2, 3]  # corners of a footprint in the order of a foot's sole points


def check_contacts(
    plan: StepPlan, after: float = 0.0, phases: int | None = None, outside: float = _OUTSIDE
) -> None:
    """Refuse a plan whose feet or ZMP contradict its contacts in the middle of a phase.

    Args:
        plan: centroidal motion, feet and contacts.
        after: what comes before is not checked [s].
        phases: how many are checked; all by default.
        outside: how far the ZMP may be outside the support [m].

    Raises:
        ValueError: they do.
    """
    ahead = [phase for phase in plan.contacts.phases if phase.start + phase.duration > after][:phases]
    times = np.array([0.5 * (max(phase.start, after) + phase.start + phase.duration) for phase in ahead])
    feet = plan.feet.sample(times)
    for row, phase in enumerate(ahead):
        for side, footstep, foot in zip(("left", "right"), (phase.left, phase.right), feet, strict=True):
            touching = foot.contact[row].repeat(2)
            if bool(footstep) != touching.any():
                ways = ("in the air", "on the floor")
                raise ValueError(
                    f"at {times[row]:.4g} s its contacts have the {side} foot {ways[bool(footstep)]}, and "
                    f"the path of the foot has it {ways[not footstep]}"
                )
            if footstep:
                corners = footprint(plan.feet.sole, footstep)[_POINTS]
                off = np.linalg.norm(foot.sole_points[row, :, :2] - corners, axis=1)[touching].max()
                if off > _OFF:
                    raise ValueError(
                        f"at {times[row]:.4g} s the path of its {side} foot is {off:.3g} m off the "
                        "footstep of its contacts"
                    )
    points = np.concatenate([foot.sole_points[:, :, :2] for foot in feet], axis=1)
    contact = np.concatenate([foot.contact.repeat(2, axis=1) for foot in feet], axis=1)
    margin = polygon_margin(points, contact, plan.sample(times).zmp)
    worst = int(margin.argmin())
    if margin[worst] < -outside:
        raise ValueError(
            f"at {times[worst]:.4g} s its ZMP is {-margin[worst]:.3g} m outside its support, more than the "
            f"{outside:g} m that are let pass; keep it in the soles that stand"
        )

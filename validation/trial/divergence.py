"""Why a simulation diverged: dampers and springs that are too stiff for inertia and time step."""

from dataclasses import replace

import mujoco
import numpy as np

from ampm.geometry import Array
from validation.trial.outcome import Outcome, OutcomeName

_FIRMEST = 2.0  # damping times step over inertia, and frequency times step, up to which a step is stable [1]


def explained(outcome: Outcome, model: mujoco.MjModel) -> Outcome:
    """An outcome, with the likely cause if the simulation of a model diverged."""
    if outcome.name is not OutcomeName.DIVERGED or not (cause := likely_cause(model)):
        return outcome
    return replace(outcome, cause=f"{outcome.cause}; {cause}")


def likely_cause(model: mujoco.MjModel) -> str:
    """Joints that an explicit step cannot integrate, and the line of a description that helps.

    Without contacts and with the angles at 0, a step from ``v`` to ``v - h M^-1 (D v + K q)`` is unstable if
    an eigenvalue of ``h M^-1 D`` or of ``h sqrt(M^-1 K)`` is over 2.

    Returns:
        Part of a sentence; empty if there are none.
    """
    data, mass, step = mujoco.MjData(model), np.empty((model.nv, model.nv)), float(model.opt.timestep)
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, mass)
    inverse = np.linalg.inv(mass)
    stiffness = np.zeros(model.nv)
    stiffness[model.jnt_dofadr] = model.jnt_stiffness
    damping = np.array(model.dof_damping)
    firm = _firm_joints(step * inverse * damping) | _firm_joints((step**2 * inverse) * stiffness / _FIRMEST)
    if not firm:
        return ""
    dofs = sorted(firm)
    names = [model.joint(int(model.dof_jntid[k])).name for k in dofs]
    inertia = min(1.0 / inverse[k, k] for k in dofs)
    needed = max(step * damping[k] + step**2 * stiffness[k] for k in dofs)
    return (
        f"dampers or springs of {', '.join(names)} are too stiff for their inertia of {inertia:.2g} kg m^2 "
        f"and the time step; add armature.'{'|'.join(names)}' = {needed:.1g} to the body's description, or "
        "lower damping or simulation.time_step"
    )


def _firm_joints(response: Array) -> set[int]:
    """Degrees of freedom that lead a mode whose eigenvalue is over the limit."""
    values, modes = np.linalg.eig(response)
    return {int(np.argmax(np.abs(modes[:, i]))) for i in np.flatnonzero(values.real > _FIRMEST)}

"""Why a simulation diverged: dampers that are too strong for inertia and time step."""

from dataclasses import replace

import mujoco
import numpy as np

from validation.trial.outcome import Outcome, OutcomeName


def explained(outcome: Outcome, model: mujoco.MjModel) -> Outcome:
    """An outcome, with joints whose dampers let the simulation of a model diverge, and the line that helps.

    A step from ``v`` to ``v - h M^-1 D v`` is unstable if an eigenvalue of ``h M^-1 D`` is over 2.
    """
    if outcome.name is not OutcomeName.DIVERGED:
        return outcome
    data, mass = mujoco.MjData(model), np.empty((model.nv, model.nv))
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, mass)
    inverse, damping = np.linalg.inv(mass), np.array(model.opt.timestep * model.dof_damping)
    values, modes = np.linalg.eig(inverse * damping)
    firm = sorted({int(np.abs(mode).argmax()) for mode in modes.T[values.real > 2.0]})
    if not firm:
        return outcome
    names = [model.joint(int(model.dof_jntid[k])).name for k in firm]
    return replace(
        outcome,
        cause=f"{outcome.cause}; the dampers of {', '.join(names)} are too strong for their inertia of "
        f"{1.0 / inverse[firm, firm].max():.2g} kg m^2 and the time step: add armature.'{'|'.join(names)}' = "
        f"{damping[firm].max():.1g} to the body's description, or lower damping or simulation.time_step",
    )

"""Engines: what turns state and torques into the next state and the forces of the floor.

The body is always a compiled MuJoCo model, and MuJoCo's data hold state, torques, pushes, kinematics, sensors
and contacts. An engine replaces the calls that step them; all that reads them is the same for every engine.
"""

from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from typing import NamedTuple

import mujoco
import numpy as np

from ampm.exceptions import InputError
from ampm.parameters import RunParameters, field_of
from ampm.physics_parameters import ContactParameters


class Engine(NamedTuple):
    """Steps the data of a model.

    Attributes:
        step1: kinematics, sensors and contacts of the state, as ``mj_step1``; the control tick acts after it.
        step2: from state, ``ctrl`` and ``xfrc_applied`` to the next state, as ``mj_step2``. ``contact`` and
            ``efc_force`` then hold the forces of this step; kinematics stay as they were.
    """

    step1: Callable[[], None]
    step2: Callable[[], None]


_SHARED = {"friction", "acceleration"}  # keys of contact that Drake has, too, with acceleration full
_ONLY_MUJOCO = (
    *(f"contact.{name}" for name in ContactParameters.model_fields if name not in _SHARED),
    "simulation.integrator",
    "disturbance.softness_factor",
)


def check_drake(run: RunParameters | None = None, model: mujoco.MjModel | None = None) -> None:
    """Refuse a key of MuJoCo alone, dry friction in a joint, and Drake where it is not installed.

    Only what is given of run and model is checked; raises :class:`InputError`.
    """
    for key in _ONLY_MUJOCO:
        if run and run.value(key) != (default := field_of(key).default):
            rule = f"is of MuJoCo alone, and simulation.engine = drake needs its default, {default}"
            raise run.refusal(key, rule, "set the keys of drake instead, or walk with --engine mujoco")
    refused = ""
    if find_spec("pydrake") is None:
        refused = (
            "simulation.engine = drake needs Drake, which is not installed; run pip install -e '.[drake]' in "
            "the checkout, or walk with --engine mujoco."
        )
    elif model is not None and model.dof_frictionloss.any():
        joint = model.joint(int(model.dof_jntid[np.flatnonzero(model.dof_frictionloss)[0]])).name
        refused = (
            f"the joint {joint} has dry friction, which Drake does not have; walk this body with "
            "--engine mujoco, or without friction in its description."
        )
    if refused:
        raise InputError(refused, key="simulation.engine", value="drake")


def make_engine(model: mujoco.MjModel, data: mujoco.MjData, run: RunParameters) -> Engine:
    """The engine that steps these data as a run says: Drake, which counts all of a contact, or MuJoCo."""
    if run.simulation.engine == "drake":
        check_drake(model=model)
        from validation.trial.drake import DrakeEngine  # imported here: an extra, and slow to load

        stepped = DrakeEngine(model, data, run.drake)
        return Engine(stepped.step1, stepped.step2)
    engine = Engine(partial(mujoco.mj_step1, model, data), partial(mujoco.mj_step2, model, data))
    return _with_full_contacts(engine, model, data) if run.contact.acceleration == "full" else engine


def _with_full_contacts(engine: Engine, model: mujoco.MjModel, data: mujoco.MjData) -> Engine:
    """MuJoCo with contacts that count the part ``dJ/dt v`` of a point's acceleration ``J dv/dt + dJ/dt v``.

    MuJoCo lets ``J dv/dt`` alone follow the reference acceleration of a contact, so the rest is taken off it.
    """
    rate = np.empty((3, model.nv))

    def step1() -> None:
        engine.step1()
        contact, reference = data.contact, data.efc_aref
        frames = contact.frame.reshape(-1, 3, 3)
        for geoms, first, place, frame in zip(
            contact.geom, contact.efc_address, contact.pos, frames, strict=True
        ):
            for side, segment in zip((-1.0, 1.0), model.geom_bodyid[geoms], strict=True):
                if segment and first >= 0:
                    mujoco.mj_jacDot(model, data, rate, None, place, segment)
                    reference[first : first + 3] -= side * (frame @ (rate @ data.qvel))

    return engine._replace(step1=step1)

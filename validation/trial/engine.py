"""Engines: what turns state and torques into the next state and the forces of the floor.

The body is always a compiled MuJoCo model, and MuJoCo's data hold state, torques, pushes, kinematics, sensors
and contacts. An engine replaces the calls that step them; all that reads them is the same for every engine.
"""

from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from ampm.compiled import bound, compiled, refer
from ampm.exceptions import InputError
from ampm.geometry import Array
from ampm.parameters import RunParameters, field_of
from ampm.physics_parameters import ContactParameters
from ampm.vectors import ZERO, cross, dot, minus, plus, times, vector


class Engine(NamedTuple):
    """Steps the data of a model."""

    # kinematics, sensors and contacts of the state, as `mj_step1`; the control tick acts after it
    step1: Callable[[], None]
    # from state, `ctrl` and `xfrc_applied` to the next state, as `mj_step2`; `contact` and `efc_force` then
    # hold the forces of this step, and kinematics stay as they were
    step2: Callable[[], None]


ONLY_MUJOCO = (
    *(f"contact.{name}" for name in ContactParameters.model_fields if name != "friction"),
    "simulation.integrator",
    "disturbance.softness_factor",
    "disturbance.joint_friction",
)


def check_drake(run: RunParameters | None = None, model: mujoco.MjModel | None = None) -> None:
    """Refuse a key of MuJoCo alone, dry friction in a joint, and Drake where it is not installed.

    Only what is given of run and model is checked; raises :class:`InputError`.
    """
    for key in ONLY_MUJOCO:
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


def all_rows(data: mujoco.MjData, present: NDArray[Any]) -> NDArray[Any]:
    """View of a column of MuJoCo's contacts that holds for the whole walk.

    MuJoCo's own views have one row per present contact, so they would have to be taken at every step.
    Contacts lie at the beginning of the simulation's arena; this view has as many rows as it can hold.
    """
    shape = (data.narena // present.strides[0], *present.shape[1:])
    return np.lib.stride_tricks.as_strided(present, shape, present.strides, writeable=False)


class _Motion(NamedTuple):
    """What ``dJ/dt v`` of contacts follows from: views of MuJoCo's model and data, by its names."""

    geom: NDArray[np.int32]  # both of each contact
    efc_address: NDArray[np.int32]
    pos: Array
    frame: Array
    geom_bodyid: NDArray[np.int32]
    body_rootid: NDArray[np.int32]
    last: NDArray[np.int32]  # coordinate nearest to each segment that moves it, -1 for none
    dof_parentid: NDArray[np.int32]
    qvel: Array
    cdof_dot: Array
    cvel: Array
    subtree_com: Array


def _with_full_contacts(engine: Engine, model: mujoco.MjModel, data: mujoco.MjData) -> Engine:
    """MuJoCo with contacts that count the part ``dJ/dt v`` of a point's acceleration ``J dv/dt + dJ/dt v``.

    MuJoCo lets ``J dv/dt`` alone follow the reference acceleration of a contact, so the rest is taken off it.
    """
    last = np.full(model.nbody, -1, dtype=np.int32)
    for segment in range(1, model.nbody):
        count = model.body_dofnum[segment]
        first, above = model.body_dofadr[segment], last[model.body_parentid[segment]]
        last[segment] = first + count - 1 if count else above
    contacts = ("geom", "efc_address", "pos", "frame")
    views = {name: all_rows(data, getattr(data.contact, name)) for name in contacts}
    views |= {name: getattr(model, name) for name in ("geom_bodyid", "body_rootid", "dof_parentid")}
    views |= {name: getattr(data, name) for name in ("qvel", "cdof_dot", "cvel", "subtree_com")}
    take_off = bound(_take_off, (refer(_Motion(last=last, **views)),), 0, data.efc_aref)

    def step1() -> None:
        engine.step1()
        take_off(data.ncon, data.efc_aref)

    return engine._replace(step1=step1)


@compiled
def _take_off(motion: _Motion, contacts: int, reference: Array) -> None:
    """Take ``dJ/dt v`` of the contacts off the reference accelerations of their rows [m/s^2]."""
    for i in range(contacts):
        first = motion.efc_address[i]
        if first < 0:
            continue
        for side in range(2):
            segment = motion.geom_bodyid[motion.geom[i, side]]
            linear, angular = ZERO, ZERO  # of the segment, at rates that stay
            j = motion.last[segment]
            while j >= 0:
                angular = plus(angular, times(motion.qvel[j], vector(motion.cdof_dot[j, :3])))
                linear = plus(linear, times(motion.qvel[j], vector(motion.cdof_dot[j, 3:])))
                j = motion.dof_parentid[j]
            arm = minus(vector(motion.pos[i]), vector(motion.subtree_com[motion.body_rootid[segment]]))
            turning = vector(motion.cvel[segment, :3])
            speed = plus(vector(motion.cvel[segment, 3:]), cross(turning, arm))
            part = plus(linear, plus(cross(angular, arm), cross(turning, speed)))
            sign = 1.0 if side else -1.0
            for axis in range(3):
                along = vector(motion.frame[i, 3 * axis : 3 * axis + 3])
                reference[first + axis] -= sign * dot(along, part)

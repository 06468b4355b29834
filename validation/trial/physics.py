"""The simulated body: the only module of a walk that owns ``MjData``."""

import contextlib
from collections.abc import Iterator
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from ampm.geometry import Array
from ampm.parameters import RunParameters
from validation.trial.coordinates import to_mujoco
from validation.trial.engine import all_rows, make_engine
from validation.trial.plan import Body

_BAD_STATE = slice(int(mujoco.mjtWarning.mjWARN_BADQPOS), int(mujoco.mjtWarning.mjWARN_BADQACC) + 1)


@contextlib.contextmanager
def quiet_mujoco() -> Iterator[None]:
    """Keep MuJoCo from printing and from writing MUJOCO_LOG.TXT into the working folder."""
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(None)


class BodyState(NamedTuple):
    """The body that is simulated, as views of MuJoCo's data, with all rows that contacts may take."""

    qpos: Array  # shape (nq,)
    qvel: Array  # shape (nv,)
    ctrl: Array  # torques, shape (nu,) [N m]
    com: Array  # of a sensor, shape (3,) [m]
    angular_momentum: Array  # about it, of a sensor, shape (3,) [N m s]
    root_rotation: Array  # axes of the root to world, shape (3, 3)
    trunk: Array  # its long axis in world, shape (3,)
    site_place: Array  # shape (sites, 3) [m]
    site_rotation: Array  # shape (sites, 9)
    sites: NDArray[np.intp]  # numbers of the sole points and, last, of the two soles
    # both geoms. MuJoCo sorts them by type: a floor that is a plane comes first, a box last
    contact_geom: NDArray[np.int32]
    # of the first force, along the normal, -1 for none: two along the tangents follow
    contact_address: NDArray[np.int32]
    contact_frame: Array  # normal and tangents
    contact_place: Array  # [m]
    contact_distance: Array  # negative where they overlap [m]
    # sole point of every geom, -1 for none: a sphere, with one contact at most
    point_of_geom: NDArray[np.intp]
    warnings: NDArray[np.int32]  # counts of states that MuJoCo could not step
    q: Array  # Pinocchio configuration, written by `sense`, shape (nq,)
    v: Array  # its velocity, shape (nv,)
    torque_limit: Array  # shape (nu,) [N m]
    scale: float  # stature of the body over 1.70 m [1]
    time_step: float  # [s]


class Physics:
    """One simulation of a body in its world: model, data, and the quantities read at every step.

    Raises :class:`InputError` if the engine cannot step the body.
    """

    def __init__(self, body: Body, run: RunParameters) -> None:
        self.model = model = body.model.compile()
        self.data = data = mujoco.MjData(model)
        self.engine = make_engine(model, data, run)
        self.robot = robot = body.robot
        self.time_step = float(model.opt.timestep)
        self.substeps = run.count("controller.frequency")
        description = robot.description
        self.point_sites = names = tuple(site for _, _, site in description.sole_points())
        soles = [leg.sole_frame for leg in description.legs]
        sites = np.array([model.site(name).id for name in (*names, *soles)], dtype=np.intp)
        point_of_geom = np.full(model.ngeom, -1, dtype=np.intp)
        point_of_geom[[model.geom(name).id for name in names]] = np.arange(len(names))
        contact, (left, right) = data.contact, sites[-2:]
        self.soles = data.site_xpos[left : right + 1 : right - left]
        self.body = BodyState(
            qpos=data.qpos,
            qvel=data.qvel,
            ctrl=data.ctrl,
            com=data.sensor("com").data,
            angular_momentum=data.sensor("angular_momentum").data,
            root_rotation=self._axes(description.root_segment),
            trunk=self._axes(description.trunk_segment)[:, 2],
            site_place=data.site_xpos,
            site_rotation=data.site_xmat,
            sites=sites,
            contact_geom=all_rows(data, contact.geom),
            contact_address=all_rows(data, contact.efc_address),
            contact_frame=all_rows(data, contact.frame),
            contact_place=all_rows(data, contact.pos),
            contact_distance=all_rows(data, contact.dist),
            point_of_geom=point_of_geom,
            warnings=data.warning.number[_BAD_STATE],
            q=np.zeros(robot.nq),
            v=np.zeros(robot.nv),
            torque_limit=robot.torque_limit.copy(),
            scale=description.scale,
            time_step=self.time_step,
        )

    def _axes(self, segment: str) -> Array:
        """Axes of a segment to world; a view of shape (3, 3)."""
        return np.asarray(self.data.xmat[self.model.body(segment).id].reshape(3, 3))

    def place(self, q: NDArray[np.float64], v: NDArray[np.float64]) -> None:
        """Set the state from Pinocchio's coordinates."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:], self.data.qvel[:] = to_mujoco(q, v)


def firm_dampers(model: mujoco.MjModel) -> str:
    """Joints whose dampers let the simulation of a model diverge, and the line that helps; empty if none do.

    A step from ``v`` to ``v - h M^-1 D v`` is unstable if an eigenvalue of ``h M^-1 D`` is over 2.
    """
    data, mass = mujoco.MjData(model), np.empty((model.nv, model.nv))
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, mass)
    inverse, damping = np.linalg.inv(mass), np.array(model.opt.timestep * model.dof_damping)
    values, modes = np.linalg.eig(inverse * damping)
    firm = sorted({int(np.abs(mode).argmax()) for mode in modes.T[values.real > 2.0]})
    if not firm:
        return ""
    names = [model.joint(int(model.dof_jntid[k])).name for k in firm]
    return (
        f"the dampers of {', '.join(names)} are too strong for their inertia of "
        f"{1.0 / inverse[firm, firm].max():.2g} kg m^2 and the time step: add '{'|'.join(names)}' = "
        f"{damping[firm].max():.1g} to [body.armature] of its description, or lower "
        "damping or simulation.time_step"
    )

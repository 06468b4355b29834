"""Drake steps the body: its dynamics, contact and integrator, on a plant built from the compiled model.

MuJoCo lends numbers and the kinematics of the sites. Drake's state is set from MuJoCo's data before every
step, so a step depends on state, torques and pushes alone, and is repeated without a warm start.

Drake's own reader of MJCF is not used: in a stack of hinges it puts all but the last one at the parent's
origin.
"""

import logging
from typing import Any

import mujoco
import numpy as np
from pydrake import geometry
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform
from pydrake.multibody import tree
from pydrake.multibody.plant import AddMultibodyPlant, CoulombFriction, MultibodyPlantConfig
from pydrake.systems.framework import DiagramBuilder

from ampm.geometry import Array
from ampm.physics_parameters import DrakeParameters
from validation.trial.bridge import passive_joints, rotation

# It warns of contact between rigid and soft bodies, which does not occur here.
logging.getLogger("drake").addFilter(lambda record: "half spaces" not in record.getMessage())

_RIGID = 1e25  # stiffness of the floor [N/m]: that of a contact is the sole point's; infinity gives NaN
_LARGEST = 1e10  # largest number in a state that MuJoCo steps
_ZERO = np.zeros(3)
_BAD_ACCELERATION = int(mujoco.mjtWarning.mjWARN_BADQACC)


def _pose(position: Any, quaternion: Any) -> RigidTransform:
    """A pose from MuJoCo's numbers; the quaternion has w first."""
    return RigidTransform(Quaternion(quaternion / np.linalg.norm(quaternion)), position)


class _Plant:
    """A compiled model as Drake's plant: a floating tree of hinges, each with a motor.

    Its sole points touch planes and boxes by a ``contact``; None is for a body in the air.

    Attributes:
        segments: Drake's body of every segment.
        geoms: MuJoCo's geom of every shape that touches others.
        quaternion: places of the root's quaternion in Drake's state. ``position``, ``spin``, ``velocity``,
            ``angles`` and ``rates`` are those of MuJoCo's other coordinates.
    """

    def __init__(self, model: mujoco.MjModel, contact: DrakeParameters | None) -> None:
        self.model = model
        builder = DiagramBuilder()
        config = MultibodyPlantConfig(
            time_step=float(model.opt.timestep),
            use_sampled_output_ports=False,  # contacts are those of the step that begins, not of the last one
            contact_model="point",
            discrete_contact_approximation=contact.approximation if contact else "lagged",
        )
        self.plant, scene = AddMultibodyPlant(config, builder)
        self.plant.mutable_gravity_field().set_gravity_vector(model.opt.gravity)
        self.segments: dict[int, Any] = {0: self.plant.world_body()}
        self._joints: list[Any] = []
        self._add_segments()
        self._add_motors()
        self.geoms: dict[Any, int] = {}
        if contact:
            self._add_floor_and_points(contact)
            points = [added for added, g in self.geoms.items() if model.geom_bodyid[g]]
            apart = geometry.CollisionFilterDeclaration().ExcludeWithin(geometry.GeometrySet(points))
            scene.collision_filter_manager().Apply(apart)
        self.plant.Finalize()
        self._diagram = builder.Build()
        self._root_context = self._diagram.CreateDefaultContext()
        self.context = self.plant.GetMyMutableContextFromRoot(self._root_context)
        root, *hinges = self._joints
        nq = self.plant.num_positions()
        q, v = root.position_start(), nq + root.velocity_start()
        self.quaternion, self.position = slice(q, q + 4), slice(q + 4, q + 7)
        self.spin, self.velocity = slice(v, v + 3), slice(v + 3, v + 6)
        self.angles = np.array([hinge.position_start() for hinge in hinges], dtype=np.intp)
        self.rates = nq + np.array([hinge.velocity_start() for hinge in hinges], dtype=np.intp)
        self._state, self._forces = np.zeros((2, nq + self.plant.num_velocities()))
        self._next = self.plant.AllocateDiscreteVariables()

    def _add_segments(self) -> None:
        """One rigid body for each of MuJoCo's, with the joints that it hangs on."""
        model, plant = self.model, self.plant
        instance, massless = plant.AddModelInstance("body"), tree.SpatialInertia.Zero()
        for b in range(1, model.nbody):
            parent = self.segments[int(model.body_parentid[b])]
            segment = plant.AddRigidBody(f"segment {b}", instance, self._inertia(b))
            self.segments[b] = segment
            place = _pose(model.body_pos[b], model.body_quat[b])
            ends = parent.body_frame(), segment.body_frame()
            first, count = int(model.body_jntadr[b]), int(model.body_jntnum[b])
            for j in range(first, first + count):
                if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE:
                    self._joints.append(plant.AddJoint(tree.QuaternionFloatingJoint(f"joint {j}", *ends)))
                    continue
                # Between the hinges of a stack are bodies without mass.
                last = j == first + count - 1
                child = segment if last else plant.AddRigidBody(f"stack {j}", instance, massless)
                self._add_hinge(j, parent, child, place)
                parent, place = child, RigidTransform()
            if not count:
                plant.WeldFrames(*ends, place)

    def _inertia(self, b: int) -> tree.SpatialInertia:
        """Mass and inertia of a segment."""
        model, mass = self.model, float(self.model.body_mass[b])
        if not mass:
            return tree.SpatialInertia.Zero()
        turn = _pose(np.zeros(3), model.body_iquat[b]).rotation().matrix()
        about_com = turn @ np.diag(model.body_inertia[b]) @ turn.T
        moments, products = np.diag(about_com), about_com[[0, 0, 1], [1, 2, 2]]
        inertia = tree.RotationalInertia(*moments, *products)
        return tree.SpatialInertia.MakeFromCentralInertia(mass, model.body_ipos[b], inertia)

    def _add_hinge(self, j: int, parent: Any, child: Any, place: RigidTransform) -> None:
        """A hinge between two bodies; ``place`` is the child's in the axes of the parent at angle zero.

        Drake's damper is implicit, so it takes the place of MuJoCo's where that is, too. Else, and for
        springs, the passive forces of the state act.
        """
        model, plant, anchor = self.model, self.plant, RigidTransform(self.model.jnt_pos[j])
        above = tree.FixedOffsetFrame(f"above {j}", parent.body_frame(), place @ anchor)
        below = tree.FixedOffsetFrame(f"below {j}", child.body_frame(), anchor)
        frames = plant.AddFrame(above), plant.AddFrame(below)
        low, high = model.jnt_range[j] if model.jnt_limited[j] else (-np.inf, np.inf)
        damping = float(model.dof_damping[model.jnt_dofadr[j]]) if passive_joints(model).implicit else 0.0
        hinge = tree.RevoluteJoint(f"joint {j}", *frames, model.jnt_axis[j], low, high, damping)
        self._joints.append(plant.AddJoint(hinge))

    def _add_motors(self) -> None:
        """A motor for every actuator, with the joint's armature as its rotor's inertia."""
        model = self.model
        for a in range(model.nu):
            joint = int(model.actuator_trnid[a, 0])
            motor = self.plant.AddJointActuator(f"motor {a}", self._joints[joint])
            motor.set_default_rotor_inertia(float(model.dof_armature[model.jnt_dofadr[joint]]))
            motor.set_default_gear_ratio(1.0)

    def _add_floor_and_points(self, contact: DrakeParameters) -> None:
        """Planes and boxes of the world, and the spheres under the soles."""
        model = self.model
        for g in range(model.ngeom):
            segment, size = int(model.geom_bodyid[g]), model.geom_size[g]
            if segment and model.geom_conaffinity[g] & 1:
                self._add_shape(g, geometry.Sphere(size[0]), contact.stiffness, contact.dissipation)
            elif not segment and model.geom_contype[g] & 1:
                plane = model.geom_type[g] == mujoco.mjtGeom.mjGEOM_PLANE
                self._add_shape(g, geometry.HalfSpace() if plane else geometry.Box(*2.0 * size), _RIGID, 0.0)

    def _add_shape(self, g: int, shape: Any, stiffness: float, dissipation: float) -> None:
        """A shape that touches others in the place of MuJoCo's."""
        model, material = self.model, geometry.ProximityProperties()
        friction = float(model.geom_friction[g, 0])
        geometry.AddContactMaterial(dissipation, stiffness, CoulombFriction(friction, friction), material)
        segment = self.segments[int(model.geom_bodyid[g])]
        place = _pose(model.geom_pos[g], model.geom_quat[g])
        added = self.plant.RegisterCollisionGeometry(segment, place, shape, f"geom {g}", material)
        self.geoms[added] = g

    def place(self, data: mujoco.MjData) -> None:
        """Set the state."""
        x = self._state
        x[self.quaternion], x[self.position] = data.qpos[3:7], data.qpos[:3]
        x[self.spin], x[self.velocity] = rotation(data.qpos[3:7]) @ data.qvel[3:6], data.qvel[:3]
        x[self.angles], x[self.rates] = data.qpos[7:], data.qvel[6:]
        self.plant.SetPositionsAndVelocities(self.context, x)

    def act(self, data: mujoco.MjData, force: Array) -> None:
        """Set the motors' torques, and the generalised force of all else in MuJoCo's coordinates, (nv,)."""
        plant, forces = self.plant, self._forces
        forces[self.spin], forces[self.velocity] = rotation(data.qpos[3:7]) @ force[3:6], force[:3]
        forces[self.rates] = force[6:]
        plant.get_actuation_input_port().FixValue(self.context, data.ctrl)
        generalized = forces[plant.num_positions() :]
        plant.get_applied_generalized_force_input_port().FixValue(self.context, generalized)

    def contacts(self) -> dict[frozenset[int], tuple[int, Array, Array, float]]:
        """Contacts of the step that begins, by their two geoms.

        Each has the second geom, the force on it in world [N], its place [m], and the depth [m].
        """
        results = self.plant.get_contact_results_output_port().Eval(self.context)
        found = {}
        for i in range(results.num_point_pair_contacts()):
            info = results.point_pair_contact_info(i)
            pair = info.point_pair()
            a, b = self.geoms[pair.id_A], self.geoms[pair.id_B]
            found[frozenset((a, b))] = b, info.contact_force(), info.contact_point(), pair.depth
        return found

    def next_state(self) -> Array:
        """State after the step."""
        self.plant.CalcForcedDiscreteVariableUpdate(self.context, self._next)
        return np.asarray(self._next.value())


class DrakeEngine:
    """Steps MuJoCo's data by Drake, see :class:`validation.trial.engine.Engine`.

    Drake's solver stops at a relative residual of 1e-6, and its velocities do not quite follow from its
    forces. So its forces act on the same plant without contact, which gives the next state.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, contact: DrakeParameters) -> None:
        self.model, self.data = model, data
        self._on_floor, self._in_air = _Plant(model, contact), _Plant(model, None)
        self._passive = data.qfrc_spring if passive_joints(model).implicit else data.qfrc_passive
        self._com = data.sensor("com").data
        self._angular_momentum = data.sensor("angular_momentum").data

    def step1(self) -> None:
        """MuJoCo's kinematics and contacts; COM and angular momentum are Drake's."""
        mujoco.mj_step1(self.model, self.data)
        for each in (self._on_floor, self._in_air):
            each.place(self.data)
        plant, context = self._in_air.plant, self._in_air.context
        com = plant.CalcCenterOfMassPositionInWorld(context)
        self._com[:] = com
        self._angular_momentum[:] = plant.CalcSpatialMomentumInWorldAboutPoint(context, com).rotational()

    def step2(self) -> None:
        """Drake's step. One that Drake cannot make counts as a bad acceleration, which ends the walk."""
        data, plant = self.data, self._in_air
        force = self._passive.copy()
        for b in np.flatnonzero(data.xfrc_applied.any(axis=1)).tolist():
            push, moment = data.xfrc_applied[b, :3], data.xfrc_applied[b, 3:]
            mujoco.mj_applyFT(self.model, data, push, moment, data.xipos[b], b, force)
        try:
            self._on_floor.act(data, force)
            self._keep(self._on_floor.contacts(), force)
            plant.act(data, force)
            x = plant.next_state()
        except RuntimeError:  # of Drake's solver
            x = np.array([np.nan])
        if not np.abs(x).max() < _LARGEST:  # NaN, too
            data.warning.number[_BAD_ACCELERATION] += 1
            return
        quaternion = x[plant.quaternion] / np.linalg.norm(x[plant.quaternion])
        data.qpos[:3], data.qpos[3:7], data.qpos[7:] = x[plant.position], quaternion, x[plant.angles]
        data.qvel[:3], data.qvel[6:] = x[plant.velocity], x[plant.rates]
        data.qvel[3:6] = rotation(quaternion).T @ x[plant.spin]
        data.time += self.model.opt.timestep

    def _keep(self, found: dict[frozenset[int], tuple[int, Array, Array, float]], force: Array) -> None:
        """Write contacts into MuJoCo's, in the axes of their frames; add them to the generalised force."""
        data, contact, efc_force = self.data, self.data.contact, self.data.efc_force
        efc_force[:] = 0.0
        for i, ((first, second), row) in enumerate(zip(contact.geom, contact.efc_address, strict=True)):
            pair = frozenset((int(first), int(second)))
            if pair not in found or row < 0:
                continue
            on, push, place, depth = found.pop(pair)
            push = push if on == second else -push
            efc_force[row : row + 3] = contact.frame[i].reshape(3, 3) @ push
            contact.pos[i], contact.dist[i] = place, -depth
            for geom, on_geom in ((first, -push), (second, push)):
                b = int(self.model.geom_bodyid[geom])
                mujoco.mj_applyFT(self.model, data, on_geom, _ZERO, place, b, force)
        if found:
            names = ", ".join(sorted({self.model.geom(g).name for pair in found for g in pair}))
            raise ValueError(f"Drake has a contact that MuJoCo does not have, of {names}")

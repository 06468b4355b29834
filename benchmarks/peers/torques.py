"""Torques of recorded ticks by another inverse dynamics; a script that runs in a library's own environment.

``python torques.py NAME IN OUT``. Every tick gets the recorded state, the wanted COM acceleration and rate of
angular momentum, planned feet and posture, and the feet in contact.
"""

import sys
import tempfile
import time
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

MOMENTUM, SWING, POSTURE, FORCE = 1e4, 1e2, 1.0, 1e-5
"""Weights: COM and angular momentum, swinging feet, hinges and trunk, contact forces."""

_PASSES = 3
_FEET = ("left", "right")


class Dynamics:
    """One library.

    Args:
        given: body, gains and ticks, see :func:`benchmarks.peers.dynamics.record`.
    """

    package = ""

    def __init__(self, given: Any) -> None:
        self.given = given
        self.hinges, self.soles = ([str(name) for name in given[key]] for key in ("hinges", "soles"))
        self.contact = [False, False]

    def place(self, model: Any) -> None:
        """Where the recorded coordinates are in those of a model."""
        order = [model.joints[model.getJointId(name)].idx_v for name in self.hinges]
        self.v_places = np.array([*range(6), *order])
        self.q_places = np.array([*range(7), *(index + 1 for index in order)])

    def tick(self, k: int) -> Any:
        """Torques of tick k; accelerations and torques in the library's own order."""
        raise NotImplementedError

    def own(self, values: Any, places: Any) -> Any:
        """Recorded coordinates in the library's order."""
        out = np.empty(len(values))
        out[places] = values
        return out


class Tsid(Dynamics):
    package = "tsid"

    def __init__(self, given: Any) -> None:
        import pinocchio as pin
        import tsid

        super().__init__(given)
        if not hasattr(tsid, "RobotWrapper"):  # the wheel of 1.7.1 has its package one folder too deep
            sys.path.insert(0, next(iter(tsid.__path__)))
            import tsid_pywrap as tsid
        self.tsid = tsid
        model = pin.buildModelFromXML(str(given["urdf"]), pin.JointModelFreeFlyer())
        self.place(model)
        self.frames = [model.getFrameId(name) for name in self.soles]
        self.robot = robot = tsid.RobotWrapper(model, tsid.FLOATING_BASE_SYSTEM, False)
        q, v = self.own(given["q"][0], self.q_places), self.own(given["v"][0], self.v_places)
        self.work = work = tsid.InverseDynamicsFormulationAccForce("walk", robot, False)
        work.computeProblemData(0.0, q, v)
        friction, weight, gains = float(given["friction"]), float(given["weight"]), given["gains"]
        up = np.array([0.0, 0.0, 1.0])
        self.contacts, self.feet = [], []
        for i, name in enumerate(self.soles):
            corners = np.ascontiguousarray(given["corners"][i].T)
            contact = tsid.Contact6d(f"{name}_contact", robot, name, corners, up, friction, 1.0, 2.0 * weight)
            contact.setKp(np.zeros(6))
            contact.setKd(gains[2] * np.ones(6))
            foot = tsid.TaskSE3Equality(f"{name}_task", robot, name)
            foot.setKp(gains[0] * np.ones(6))
            foot.setKd(gains[1] * np.ones(6))
            work.addMotionTask(foot, SWING, 1, 0.0)
            self.contacts.append(contact)
            self.feet.append(foot)
        self.com, self.momentum = tsid.TaskComEquality("com", robot), tsid.TaskAMEquality("momentum", robot)
        self.posture = tsid.TaskJointPosture("posture", robot)
        for task, size, stiff, damped in (
            (self.com, 3, 0.0, 0.0),
            (self.momentum, 3, 0.0, 0.0),
            (self.posture, len(self.hinges), gains[3], gains[4]),
        ):
            task.setKp(stiff * np.ones(size))
            task.setKd(damped * np.ones(size))
        work.addMotionTask(self.com, MOMENTUM, 1, 0.0)
        work.addMotionTask(self.momentum, MOMENTUM, 1, 0.0)
        work.addMotionTask(self.posture, POSTURE, 1, 0.0)
        self.limits = limits = tsid.TaskActuationBounds("torques", robot)  # it must live as long as the rest
        most = self.own(given["torque_limit"], self.v_places[6:] - 6)
        limits.setBounds(-most, most)
        work.addActuationTask(limits, 1.0, 0, 0.0)
        self.solver = tsid.SolverHQuadProgFast("qp")
        self.resized = (0, 0, 0)

    def sample(self, *parts: Any) -> Any:
        sample = self.tsid.TrajectorySample(len(parts[0]), len(parts[1]))
        sample.value(parts[0])
        sample.derivative(parts[1])
        sample.second_derivative(parts[2])
        return sample

    def tick(self, k: int) -> Any:
        given, work = self.given, self.work
        q, v = self.own(given["q"][k], self.q_places), self.own(given["v"][k], self.v_places)
        for i, contact in enumerate(self.contacts):
            stands = bool(given["contact"][k, i])
            if stands and not self.contact[i]:
                contact.setReference(self.robot.framePosition(work.data(), self.frames[i]))
                work.addRigidContact(contact, FORCE)
            elif self.contact[i] and not stands:
                work.removeRigidContact(contact.name, 0.0)
            self.contact[i] = stands
            if not stands:
                pose = np.concatenate([given["place"][k, i], given["turn"][k, i].T.ravel()])
                rates = given["foot_v"][k, i], given["foot_a"][k, i]
                self.feet[i].setReference(self.sample(pose, *rates))
            work.updateTaskWeight(self.feet[i].name, 0.0 if stands else SWING)
        zero = np.zeros(3)
        self.com.setReference(self.sample(given["com"][k], zero, given["com_a"][k]))
        self.momentum.setReference(self.sample(zero, given["moment"][k], zero))
        hinges = self.v_places[6:] - 6
        parts = [self.own(given[key][k], hinges) for key in ("posture_q", "posture_v", "posture_a")]
        self.posture.setReference(self.sample(*parts))
        data = work.computeProblemData(0.0, q, v)
        size = work.nVar, work.nEq, work.nIn
        if size != self.resized:
            self.solver.resize(*size)
            self.resized = size
        found = self.solver.solve(data)
        if found.status != 0:
            raise RuntimeError(f"tick {k}: its QP ends with status {found.status}")
        return work.getAccelerations(found), work.getActuatorForces(found)


class Placo(Dynamics):
    package = "placo"

    def __init__(self, given: Any) -> None:
        import placo

        super().__init__(given)
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "robot.urdf"
            file.write_text(str(given["urdf"]), encoding="utf-8")
            self.robot = placo.RobotWrapper(str(file), placo.Flags.ignore_collisions)
        self.place(self.robot.model)
        for name, limit in zip(self.hinges, given["torque_limit"], strict=True):
            self.robot.set_torque_limit(name, float(limit))
        self.solver = solver = placo.DynamicsSolver(self.robot)
        solver.dt = float(given["time_step"])
        solver.enable_torque_limits(True)
        gains = given["gains"]
        self.feet, self.contacts = [], []
        for i, name in enumerate(self.soles):
            foot = solver.add_frame_task(f"{name}_centre", np.eye(4))
            contact = solver.add_planar_contact(foot)
            contact.length, contact.width = map(float, np.ptp(given["corners"][i], axis=0)[:2])
            contact.mu, contact.weight_forces = float(given["friction"]), FORCE
            contact.weight_moments = contact.weight_tangentials = FORCE
            contact.active = False
            foot.configure(name, "soft", SWING, SWING)
            self.feet.append(foot)
            self.contacts.append(contact)
        self.com, self.joints = solver.add_com_task(np.zeros(3)), solver.add_joints_task()
        self.com.configure("com", "soft", MOMENTUM)
        self.joints.configure("posture", "soft", POSTURE)
        self.trunk = solver.add_orientation_task(str(given["trunk_frame"]), np.eye(3))
        self.trunk.configure("trunk", "soft", POSTURE)
        self.com.kp = self.com.kd = 0.0
        for task in (self.joints, self.trunk):
            task.kp, task.kd = float(gains[3]), float(gains[4])

    def tick(self, k: int) -> Any:
        given, state = self.given, self.robot.state
        state.q, state.qd = self.own(given["q"][k], self.q_places), self.own(given["v"][k], self.v_places)
        self.robot.update_kinematics()
        gains = given["gains"].tolist()
        for i, (foot, contact) in enumerate(zip(self.feet, self.contacts, strict=True)):
            stands = bool(given["contact"][k, i])
            if stands != self.contact[i] or k == 0:
                contact.active = self.contact[i] = stands
                foot.configure(self.soles[i], "hard" if stands else "soft", SWING, SWING)
            turn = given["turn"][k, i]
            place, turning = foot.position(), foot.orientation()
            rates, accelerations = (given[key][k, i] * (not stands) for key in ("foot_v", "foot_a"))
            place.target_world = given["place"][k, i] + turn @ given["corners"][i].mean(axis=0)
            place.dtarget_world, place.ddtarget_world = rates[:3], accelerations[:3]
            turning.R_world_frame = turn
            turning.omega_world, turning.domega_world = rates[3:], accelerations[3:]
            for task in (place, turning):
                task.kp, task.kd = (0.0, gains[2]) if stands else (gains[0], gains[1])
        self.com.target_world, self.com.ddtarget_world = given["com"][k], given["com_a"][k]
        self.trunk.R_world_frame = given["trunk"][k]
        self.trunk.omega_world, self.trunk.domega_world = given["trunk_v"][k], given["trunk_a"][k]
        for name, *values in zip(
            self.hinges, given["posture_q"][k], given["posture_v"][k], given["posture_a"][k], strict=True
        ):
            self.joints.set_joint(name, *map(float, values))
        found = self.solver.solve(False)
        if not found.success:
            raise RuntimeError(f"tick {k}: its QP has no solution")
        return found.qdd, found.tau[6:]


LIBRARIES: dict[str, type[Dynamics]] = {"TSID": Tsid, "placo": Placo}


def solve(name: str, given: Any, passes: int = _PASSES) -> dict[str, Any]:
    """Accelerations (T, nv), torques (T, nu) and least times (T,) [s] of the ticks."""
    count = len(given["q"])
    seconds = np.full(count, np.inf)
    acceleration, torque = np.empty_like(given["v"]), np.empty((count, len(given["torque_limit"])))
    for _ in range(passes):
        library = LIBRARIES[name](given)
        for k in range(count):
            start = time.perf_counter()
            qdd, tau = library.tick(k)
            seconds[k] = min(seconds[k], time.perf_counter() - start)
            acceleration[k] = np.asarray(qdd)[library.v_places]
            torque[k] = np.asarray(tau)[library.v_places[6:] - 6]
    found = {"acceleration": acceleration, "torque": torque, "seconds": seconds}
    package = LIBRARIES[name].package
    return found | {"version": f"{package} {metadata.version(package)}"}


if __name__ == "__main__":
    asked, source, target = sys.argv[1:]
    with np.load(source) as data:
        arrays = {name: data[name] for name in data.files}
    np.savez(target, **solve(asked, arrays))

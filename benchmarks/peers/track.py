"""Follow a plan by differential inverse kinematics; a script that runs in a library's own environment.

``python track.py NAME IN OUT``. Every tick solves for one velocity, towards the targets at its end.
"""

import sys
import tempfile
import time
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

TASK, TRUNK, POSTURE = 1.0, 0.1, 1e-3
"""Costs: feet and COM, orientation of the trunk, hinges."""

_PASSES = 3


class Follower:
    """One library.

    Args:
        given: model, names and first configuration, see :func:`benchmarks.peers.body.references`.
    """

    package = ""

    def __init__(self, given: Any) -> None:
        self.given, self.step = given, float(given["time_step"])
        self.soles, self.trunk = [str(name) for name in given["soles"]], str(given["trunk_frame"])
        self.hinges = [str(name) for name in given["hinges"]]

    def tick(self, k: int) -> Any:
        """Solve for the targets of tick k, and move."""
        raise NotImplementedError

    def q(self) -> Any:
        """The configuration: root position and quaternion x y z w, then the hinges in the given order."""
        raise NotImplementedError


class Mink(Follower):
    package = "mink"

    def __init__(self, given: Any) -> None:
        import mink
        import mujoco

        super().__init__(given)
        self.mink, model = mink, mujoco.MjModel.from_xml_string(str(given["mjcf"]))
        q = given["q"]
        self.places = np.array([model.jnt_qposadr[model.joint(name).id] for name in self.hinges])
        qpos = np.zeros(model.nq)
        qpos[:3], qpos[3:7], qpos[self.places] = q[:3], q[[6, 3, 4, 5]], q[7:]
        self.configuration = mink.Configuration(model, q=qpos)
        self.feet = [mink.FrameTask(name, "site", TASK, TASK) for name in self.soles]
        self.chest, self.com = mink.FrameTask(self.trunk, "body", 0.0, TRUNK), mink.ComTask(TASK)
        posture = mink.PostureTask(model, POSTURE)
        posture.set_target_from_configuration(self.configuration)
        self.tasks = [*self.feet, self.chest, self.com, posture]

    def tick(self, k: int) -> None:
        SE3, SO3 = self.mink.SE3, self.mink.SO3
        for i, foot in enumerate(self.feet):
            turn = SO3.from_matrix(self.given["turn"][k, i])
            foot.set_target(SE3.from_rotation_and_translation(turn, self.given["place"][k, i]))
        self.chest.set_target(SE3.from_rotation(SO3.from_matrix(self.given["trunk"][k])))
        self.com.set_target(self.given["com"][k])
        v = self.mink.solve_ik(self.configuration, self.tasks, self.step, "daqp", damping=1e-9)
        self.configuration.integrate_inplace(v, self.step)

    def q(self) -> Any:
        qpos = self.configuration.q
        return np.concatenate([qpos[:3], qpos[[4, 5, 6, 3]], qpos[self.places]])


class Pink(Follower):
    package = "pin-pink"

    def __init__(self, given: Any) -> None:
        import pink
        import pinocchio as pin

        super().__init__(given)
        self.pink, self.pin = pink, pin
        model = pin.buildModelFromXML(str(given["urdf"]), pin.JointModelFreeFlyer())
        self.places = np.array([model.joints[model.getJointId(name)].idx_q for name in self.hinges])
        q = pin.neutral(model)
        q[:7], q[self.places] = given["q"][:7], given["q"][7:]
        self.configuration = pink.Configuration(model, model.createData(), q)
        self.feet = [pink.tasks.FrameTask(name, TASK, TASK) for name in self.soles]
        self.chest, self.com = pink.tasks.FrameTask(self.trunk, 0.0, TRUNK), pink.tasks.ComTask(TASK)
        posture = pink.tasks.PostureTask(POSTURE)
        posture.set_target(q)
        self.tasks = [*self.feet, self.chest, self.com, posture]

    def tick(self, k: int) -> None:
        SE3 = self.pin.SE3
        for i, foot in enumerate(self.feet):
            foot.set_target(SE3(self.given["turn"][k, i], self.given["place"][k, i]))
        self.chest.set_target(SE3(self.given["trunk"][k], np.zeros(3)))
        self.com.set_target(self.given["com"][k])
        v = self.pink.solve_ik(self.configuration, self.tasks, self.step, "daqp", damping=1e-9)
        self.configuration.integrate_inplace(v, self.step)

    def q(self) -> Any:
        q = self.configuration.q
        return np.concatenate([q[:7], q[self.places]])


class Placo(Follower):
    package = "placo"

    def __init__(self, given: Any) -> None:
        import placo

        super().__init__(given)
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "robot.urdf"
            file.write_text(str(given["urdf"]), encoding="utf-8")
            self.robot = placo.RobotWrapper(str(file), placo.Flags.ignore_collisions)
        self.robot.set_T_world_fbase(_pose(_rotation(given["q"][3:7]), given["q"][:3]))
        hinges = dict(zip(self.hinges, map(float, given["q"][7:]), strict=True))
        for name, value in hinges.items():
            self.robot.set_joint(name, value)
        self.robot.update_kinematics()
        self.solver = placo.KinematicsSolver(self.robot)
        self.solver.dt = self.step
        self.solver.enable_joint_limits(True)
        self.feet = [self.solver.add_frame_task(name, np.eye(4)) for name in self.soles]
        self.com = self.solver.add_com_task(np.zeros(3))
        self.chest = self.solver.add_orientation_task(self.trunk, np.eye(3))
        joints = self.solver.add_joints_task()
        joints.set_joints(hinges)
        for name, foot in zip(self.soles, self.feet, strict=True):
            foot.configure(name, "soft", TASK**2, TASK**2)
        self.com.configure("com", "soft", TASK**2)
        self.chest.configure("trunk", "soft", TRUNK**2)
        joints.configure("posture", "soft", POSTURE**2)
        self.solver.add_regularization_task(1e-9)

    def tick(self, k: int) -> None:
        for i, foot in enumerate(self.feet):
            foot.T_world_frame = _pose(self.given["turn"][k, i], self.given["place"][k, i])
        self.com.target_world, self.chest.R_world_frame = self.given["com"][k], self.given["trunk"][k]
        self.robot.update_kinematics()
        self.solver.solve(True)

    def q(self) -> Any:
        hinges = [self.robot.get_joint(name) for name in self.hinges]
        return np.concatenate([self.robot.state.q[:7], hinges])


def _pose(turn: Any, place: Any) -> Any:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, place
    return pose


def _rotation(quaternion: Any) -> Any:
    x, y, z, w = quaternion
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + 2.0 * (w * cross + cross @ cross)


FOLLOWERS: dict[str, type[Follower]] = {"mink": Mink, "pink": Pink, "placo IK": Placo}


def follow(name: str, given: Any, passes: int = _PASSES) -> dict[str, Any]:
    """Configurations after every tick, shape (T, nq), and their least times, shape (T,) [s]."""
    count = len(given["com"])
    seconds, q = np.full(count, np.inf), np.zeros((count, len(given["q"])))
    for _ in range(passes):
        follower = FOLLOWERS[name](given)
        for k in range(count):
            start = time.perf_counter()
            follower.tick(k)
            seconds[k] = min(seconds[k], time.perf_counter() - start)
            q[k] = follower.q()
    package = FOLLOWERS[name].package
    return {"q": q, "seconds": seconds, "version": f"{package} {metadata.version(package)}"}


if __name__ == "__main__":
    asked, source, target = sys.argv[1:]
    with np.load(source) as data:
        arrays = {name: data[name] for name in data.files}
    np.savez(target, **follow(asked, arrays))

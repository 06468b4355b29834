"""A policy without a plan: train a rhythm of eight numbers on the G1, and try it at its velocity. Takes 40 s.

Afterwards the trial from the command line, in this folder:

    ampm validate --planner none --command 0.15,0,0 --body g1 --controller 07_policy:Stepping --out runs/policy
"""

from pathlib import Path

import numpy as np
import pinocchio as pin
from matplotlib.figure import Figure

import ampm
import validation as val
from validation.trial.plan import load_request, plan_walk
from validation.trial.simulate import simulate

FILE = Path(__file__).with_name("policy.txt")
SIDES = {"left": 0.0, "right": np.pi}  # of the rhythm [rad]
JOINTS = ("hip_pitch", "hip_roll", "knee", "ankle_pitch", "ankle_roll")


class Policy:
    """A template: joint targets about the standing posture, held by springs and dampers."""

    RATE = 50.0  # of the policy [1/s]; that of the torques is controller.frequency

    def __init__(self, robot, run):
        """Once a walk: the body and the parameters of the run."""
        self.limit, self.command, self.names = robot.torque_limit, run.command, robot.joint_names
        frequency, model = run.controller.frequency, robot.model
        inertia = pin.crba(model, model.createData(), pin.neutral(model)).diagonal()[6:]
        self.stiffness = np.minimum(2.0 * self.limit, 0.2 * frequency**2 * inertia)  # [N m/rad]
        self.damping = np.minimum(0.1 * self.stiffness, 0.5 * frequency * inertia)  # [N m s/rad]
        self.ticks, self.tick, self.action = round(frequency / self.RATE), 0, np.zeros(robot.nu)

    def observe(self, state):
        """Root's rates and gravity in its axes, command, joints, their rates, last action: (9 + 3 nu,)."""
        down = -pin.Quaternion(state.q[3:7]).toRotationMatrix()[2]
        command = self.command.at(state.time)
        joints = state.q[7:] - self.standing
        return np.concatenate([state.v[3:6], down, command, joints, state.v[6:], self.action])

    def act(self, observation):
        """Joint targets, from the standing posture on, shape (nu,) [rad]: a network would be called here."""
        raise NotImplementedError

    def update(self, state, touch, reference):
        """One tick of the torques: measured state, contact of the soles, and the standing body."""
        if self.tick == 0:
            self.standing = reference.q[7:].copy()
        if self.tick % self.ticks == 0:
            self.action = self.act(self.observe(state))
        self.tick += 1
        error = self.standing + self.action - state.q[7:]
        torque = self.stiffness * error - self.damping * state.v[6:]
        return ampm.ControlOutput(np.clip(torque, -self.limit, self.limit))


class Stepping(Policy):
    """Steps to a rhythm once it is asked to move; ankles and steps answer to the tilt of the pelvis."""

    numbers = None  # frequency [Hz], sway, lift, stride [rad s/m], lean [rad], and gains of the feedback

    def __init__(self, robot, run):
        """With the numbers of the file, unless a subclass has its own."""
        super().__init__(robot, run)
        self.legs = [[self.names.index(f"{side}_{name}_joint") for name in JOINTS] for side in SIDES]
        self.numbers = np.loadtxt(FILE) if self.numbers is None else self.numbers
        self.phase = self.amplitude = 0.0

    def act(self, observation):
        """Targets of both legs."""
        frequency, sway, lift, stride, lean, tilt, rate, place = self.numbers
        gyro, down, command = observation[:3], observation[3:6], observation[6:9]
        pitch, roll = down[0] - lean, -down[1]
        if command.any():
            self.amplitude = min(self.amplitude + 1.0 / self.RATE, 1.0)
            self.phase += 2.0 * np.pi * frequency / self.RATE
        targets = np.zeros(len(self.names))
        for leg, begin in zip(self.legs, SIDES.values(), strict=True):
            sine, cosine = np.sin(self.phase + begin), np.cos(self.phase + begin)
            up = lift * max(sine, 0.0)
            ahead = place * pitch * max(sine, 0.0) - stride * command[0] * cosine
            aside = sway * np.sin(self.phase)
            targets[leg] = self.amplitude * np.array([-up - ahead, aside, 2.0 * up, ahead - up, -aside])
            targets[leg[3:]] += tilt * np.array([pitch, 0.5 * roll]) + rate * np.array([gyro[1], gyro[0]])
        return targets


def train(run, mean, generations=4, tries=12, best=4):
    """Improve the numbers by the cross-entropy method: how long it stays up, and how fast it walks."""
    planned, spread, random = plan_walk(load_request(run)), 0.3 * np.abs(mean), np.random.default_rng(1)
    for generation in range(generations):
        drawn = [mean, *(mean + spread * random.normal(size=(tries, len(mean))))]
        scores = []
        for numbers in drawn:
            record = simulate(planned, controller=type("Drawn", (Stepping,), {"numbers": numbers}))
            wanted = run.command.vx * (run.command.duration - run.command.settling)
            far = record.com[-1, :2] - record.com[0, :2] - (wanted, 0.0)
            scores.append(record.outcome.time - 3.0 * np.linalg.norm(far))
        chosen = np.array(drawn)[np.argsort(scores)[-best:]]
        mean, spread = chosen.mean(axis=0), chosen.std(axis=0)
        print(f"generation {generation + 1}: {max(scores):.2f} of {run.command.duration:g}")
    return chosen[-1]


if __name__ == "__main__":
    pass

"""Train a policy of twelve numbers on the G1 without any plan, and try it at a velocity. Takes half a minute.

Afterwards the trial from the command line, in this folder:

    ampm validate --planner none --command 0.15,0,0 --body g1 --controller 07_policy:Stepping
"""

from functools import partial

import numpy as np
import pinocchio as pin
from matplotlib.figure import Figure

import ampm
import validation as val
from validation.trial.plan import load_request, plan_walk
from validation.trial.simulate import simulate

FILE = "policy.txt"
JOINTS = ("hip_pitch", "hip_roll", "knee", "ankle_pitch", "ankle_roll")
GUESS = [1.5, 0.05, 0.6, 0.25, 0.4, 0.02, 0.2, 0.1, 2.2, 0.2, 1.1, 0.1]  # see Stepping.act


class Policy:
    """A template: joint targets about the standing posture, held by springs and dampers."""

    RATE = 50.0  # of the policy, at most that of the torques, controller.frequency [1/s]

    def __init__(self, robot, run):
        """Once a walk: the body and the parameters of the run."""
        self.limit, self.command, self.names = robot.torque_limit, run.command, robot.joint_names
        frequency = run.controller.frequency
        inertia = 1.0 / pin.computeMinverse(robot.model, robot.data, pin.neutral(robot.model)).diagonal()[6:]
        self.stiffness = np.minimum(2.0 * self.limit, 0.2 * frequency**2 * inertia)  # [N m/rad]
        self.damping = np.minimum(0.1 * self.stiffness, 0.5 * frequency * inertia)  # [N m s/rad]
        self.RATE = min(self.RATE, frequency)
        self.ticks, self.tick, self.action = round(frequency / self.RATE), 0, np.zeros(robot.nu)

    def observe(self, state):
        """Root's rates and gravity in its axes, command, joints, their rates, last action: (9 + 3 nu,)."""
        down = -pin.Quaternion(state.q[3:7]).toRotationMatrix()[2]
        joints, command = state.q[7:] - self.standing, self.command.at(state.time)
        return np.concatenate([state.v[3:6], down, command, joints, state.v[6:], self.action])

    def act(self, observation):
        """Joint targets from the standing posture on, shape (nu,) [rad]. Call your network here."""
        return np.zeros(len(self.names))

    def update(self, state, touch, reference):
        """One tick of the torques: measured state, contact of the soles, and the standing body."""
        if self.tick == 0:
            self.standing = reference.q[7:].copy()
        if self.tick % self.ticks == 0:
            self.action = self.act(self.observe(state))
        self.tick += 1
        torque = self.stiffness * (self.standing + self.action - state.q[7:]) - self.damping * state.v[6:]
        return ampm.ControlOutput(np.clip(torque, -self.limit, self.limit))


class Stepping(Policy):
    """Steps in a rhythm once it is asked to move; ankles and steps answer to the tilt of the pelvis."""

    def __init__(self, robot, run, numbers=None):
        """Once a walk, with the numbers of the file if none are given."""
        super().__init__(robot, run)
        joints = [f"{foot}_{name}_joint" for foot in ("left", "right") for name in JOINTS]
        self.legs = np.reshape([self.names.index(name) for name in joints], (2, -1))
        self.numbers = np.loadtxt(FILE) if numbers is None else numbers
        self.phase = self.size = 0.0

    def act(self, observation):
        """Targets of both legs; the rest keeps its posture."""
        frequency, sway, lead, lift, stride, lean, place, placed, *gains = self.numbers
        roll_rate, pitch_rate, _, pitch, right, _, *command = observation[:9]
        pitch, roll, asked = pitch - lean, -right, float(any(command))
        self.size = min(self.size + asked / self.RATE, 1.0)
        self.phase += asked * 2.0 * np.pi * frequency / self.RATE
        aside = sway * np.sin(self.phase + lead)
        targets = np.zeros(len(self.names))
        for leg, phase in zip(self.legs, (self.phase, self.phase + np.pi), strict=True):
            swing = max(np.sin(phase), 0.0)
            up, ahead = lift * swing, (place * pitch + placed * pitch_rate) * swing
            ahead -= stride * command[0] * np.cos(phase)
            targets[leg] = self.size * np.array([-up - ahead, aside, 2.0 * up, ahead - up, -aside])
            targets[leg[3]] += gains[0] * pitch + gains[1] * pitch_rate
            targets[leg[4]] += gains[2] * roll + gains[3] * roll_rate
        return targets


def train(run, generations=4, tries=14, best=4):
    """The numbers that stay up longest and come nearest, by the cross-entropy method."""
    planned, random = plan_walk(load_request(run)), np.random.default_rng(1)
    mean, spread = np.array(GUESS), 0.25 * np.array(GUESS)
    wanted = run.command.vx * (run.command.duration - run.command.settling), 0.0
    found = dict[float, np.ndarray]()
    for generation in range(generations):
        for numbers in mean + spread * random.normal(size=(tries, len(mean))):
            record = simulate(planned, controller=partial(Stepping, numbers=numbers))
            off = np.linalg.norm(record.com[-1, :2] - record.com[0, :2] - wanted)
            found[record.outcome.time - 2.0 * float(off)] = numbers
        chosen = [found[score] for score in sorted(found)[-best:]]
        mean, spread = np.mean(chosen, axis=0), np.std(chosen, axis=0) + 0.02 * np.abs(mean)
        print(f"generation {generation + 1}: score {max(found):.2f} of {run.command.duration:g}", flush=True)
    return chosen[-1]


if __name__ == "__main__":
    free, command, quick = {"planner": "none"}, {"vx": 0.15}, {"time_step": 0.002}
    run = ampm.load_run(gait=free, command=command, body={"source": "g1"}, simulation=quick)
    np.savetxt(FILE, train(run))
    trial = val.walk(run, controller=Stepping)
    print(f"{trial}\nforward: {trial.comparison.costs['velocity']['measured'][0]:.2f} m/s")
    axes = (figure := Figure(figsize=(8.0, 4.0), layout="constrained")).subplots()
    axes.plot(trial.measured.time, trial.measured.com[:, :2], label=["forward", "to the left"])
    axes.plot([1.0, 10.0], [0.0, 9.0 * run.command.vx], "k:", label="forward, asked for")
    axes.legend()
    axes.set(xlabel="time [s]", ylabel="way of the COM [m]")
    figure.savefig("policy.png", dpi=100)

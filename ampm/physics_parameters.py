"""Parameters of physics and numerical solvers: contact, engine, disturbances, time steps, tolerances."""

from typing import Literal

from ampm.section import Real, Section, Whole, parameter


class ContactParameters(Section, section="contact"):
    """Contact of the sole points with the floor (MuJoCo's soft contact model)."""

    time_constant: Real = parameter(0.015, "time constant of a contact", "s", gt=0, le=1)
    damping_ratio: Real = parameter(1.0, "damping ratio of a contact", gt=0, le=10)
    impedance_min: Real = parameter(0.6, "constraint impedance at zero penetration", gt=0, lt=1)
    impedance_max: Real = parameter(0.95, "constraint impedance at full penetration", gt=0, lt=1)
    impedance_width: Real = parameter(0.001, "penetration over which the impedance rises", "m", gt=0, le=0.1)
    friction: Real = parameter(0.8, "sliding friction of soles and floor", gt=0, le=10)
    impratio: Real = parameter(10.0, "ratio of frictional to normal impedance", gt=0, le=1000)
    acceleration: Literal["partial", "full"] = parameter(
        "full",
        "acceleration of sole points that contacts count: full, or partial as in MuJoCo",
    )


class DrakeParameters(Section, section="drake"):
    """Contact of the sole points with the floor if Drake steps the physics: Hunt and Crossley's springs.

    The force on a point at depth x is stiffness x (1 + dissipation dx/dt). With the defaults, heels and balls
    of the human have the mean stiffness and the time constant of MuJoCo's contact.
    """

    stiffness: Real = parameter(1.5e5, "stiffness of a sole point", "N/m", ge=1e3, le=1e8)
    dissipation: Real = parameter(20.0, "dissipation of a sole point", "s/m", ge=0, le=1e3)
    approximation: Literal["lagged", "similar"] = parameter("lagged", "Drake's contact approximation")


class SimulationParameters(Section, section="simulation"):
    """The physics engine."""

    engine: Literal["mujoco", "drake"] = parameter(
        "mujoco", "engine of the physics: mujoco, or drake, which the extra 'drake' installs"
    )
    time_step: Real = parameter(0.0005, "time step of the physics", "s", gt=0, le=0.05)
    integrator: Literal["Euler", "implicitfast"] = parameter("Euler", "integrator of the physics")
    start_depth: Real = parameter(
        0.001, "depth at which the soles start under the floor, to carry weight", "m", ge=0, le=0.01
    )


class SolverParameters(Section, section="solver"):
    """Numerical solvers and grids."""

    tolerance: Real = parameter(5e-5, "tolerance of the controller's QP, forces over weight", gt=0, le=1e-2)
    max_iterations: Whole = parameter(4000, "iterations after which a QP is unsolved", ge=10, le=100_000)
    ik_time_step: Real = parameter(0.002, "largest step of the inverse kinematics' grid", "s", gt=0, le=0.05)


class DisturbanceParameters(Section, section="disturbance"):
    """Differences of the simulated world and body from those that planner and controller know.

    Plan and controller are made from ``RunParameters.undisturbed``, so they get no information on it. All
    keys combine; with their defaults nothing is disturbed.
    """

    seed: Whole = parameter(0, "seed of all random numbers below", ge=0, le=2**31 - 1)
    start_velocity: Real = parameter(
        0.0, "standard deviation of the root's velocity at the start, each axis", "m/s", ge=0, le=1
    )
    push_segment: str = parameter(
        "chest", "segment that is pushed at its centre of mass; com: that of the body", min_length=1
    )
    push_x: Real = parameter(0.0, "force of the push along x", "N", ge=-1e5, le=1e5)
    push_y: Real = parameter(0.0, "force of the push along y", "N", ge=-1e5, le=1e5)
    push_z: Real = parameter(0.0, "force of the push along z", "N", ge=-1e5, le=1e5)
    push_at: Real = parameter(1.0, "time at which the push begins", "s", ge=0, le=1e5)
    push_duration: Real = parameter(0.1, "duration of the push", "s", gt=0, le=1e5)
    floor_height: Real = parameter(0.0, "height of the floor; the body starts on it", "m", ge=-0.5, le=0.5)
    step_height: Real = parameter(0.0, "height of one footstep's floor over the rest", "m", ge=-0.5, le=0.5)
    step_number: Whole = parameter(4, "number of that footstep; a walk starts from 1 and 2", ge=3, le=10_000)
    slope_along: Real = parameter(
        0.0, "slope of the floor along the walk after footstep 2; positive: front up", "rad", ge=-0.3, le=0.3
    )
    slope_across: Real = parameter(
        0.0, "slope of the floor across the walk after footstep 2; positive: left up", "rad", ge=-0.3, le=0.3
    )
    friction_factor: Real = parameter(1.0, "floor's friction divided by contact.friction", gt=0, le=100)
    softness_factor: Real = parameter(1.0, "time constant divided by contact.time_constant", ge=1, le=100)
    mass_segment: str = parameter(
        "all", "segments of mass_change, separated by commas, or all; chest: the trunk", min_length=1
    )
    mass_change: Real = parameter(0.0, "relative change of their mass and inertia", ge=-0.9, le=10)
    joint_damping: Real = parameter(0.0, "further damping of every joint", "N m s/rad", ge=0, le=1e3)
    joint_friction: Real = parameter(0.0, "further dry friction of every joint", "N m", ge=0, le=1e3)
    actuation_delay: Real = parameter(
        0.0, "delay of the torques, in whole ticks of the controller", "s", ge=0, le=0.2
    )
    torque_bias: Real = parameter(
        0.0, "constant error of every motor's torque; its signs are random", "N m", ge=0, le=1e3
    )

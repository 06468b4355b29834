"""Parameters of the physics and of numerical solvers: contact, engine, time steps, tolerances."""

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
        "partial",
        "acceleration of sole points that contacts count: partial as in MuJoCo, or full",
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

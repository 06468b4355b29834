"""Parameters of the controller."""

from typing import Any, Literal

from ampm.section import Open, Options, Real, Section, options_of, parameter


def _stiffness(default: float, description: str) -> Any:
    """A gain from a position to an acceleration."""
    return parameter(default, description, "1/s^2", ge=0, le=1e5)


def _damping(default: float, description: str) -> Any:
    """A gain from a velocity to an acceleration."""
    return parameter(default, description, "1/s", ge=0, le=1e4)


class ControllerParameters(Section, section="controller"):
    """The torque-level tracking controller; another one reads what it needs of these."""

    name: str = parameter("ampm", "controller: ampm, an installed one, or MODULE:CLASS", min_length=1)
    options: Options = options_of("controller", "controller.name")
    frequency: Real = parameter(500.0, "control ticks per second", "Hz", ge=20, le=10_000)
    hold: Literal["first-order", "zero-order"] = parameter(
        "first-order",
        "torque between two ticks: first-order goes on with the slope of the last tick, zero-order is held",
    )
    stabilizer: Literal["fixed", "stepping"] = parameter(
        "fixed",
        "what keeps the body up: fixed keeps the plan's footsteps and times, stepping changes them if needed",
    )
    friction: Real = parameter(0.75, "friction that the controller allows itself", gt=0, le=10)
    com_stiffness: Real = _stiffness(60.0, "feedback from COM position to its acceleration")
    com_damping: Real = _damping(15.0, "feedback from COM velocity to its acceleration")
    momentum_gain: Real = _damping(15.0, "feedback from angular momentum to its rate")
    trunk_gain: Real = parameter(
        3.0, "slow feedback from trunk tilt to the commanded angular momentum", "N m s/rad", ge=0, le=1e3
    )
    trunk_integral: Real = parameter(
        0.33, "gain on the integral of the trunk's mean tilt, for a constant posture", "1/s", ge=0, le=10
    )
    posture_stiffness: Real = _stiffness(900.0, "feedback from posture to its acceleration")
    posture_damping: Real = _damping(60.0, "feedback from posture rate to its acceleration")
    swing_stiffness: Open = _stiffness(400.0, "feedback from the swing foot's pose to its acceleration")
    swing_damping: Open = _damping(40.0, "feedback from the swing foot's velocity to its acceleration")
    stance_damping: Real = _damping(50.0, "feedback from the stance foot's velocity to its acceleration")
    stance_yield: Real = parameter(
        0.3, "share by which a stance foot's vertical, roll and pitch acceleration may yield", ge=0, le=1
    )
    roll_stiffness: Real = _stiffness(1500.0, "feedback from the pose of a rolling foot to its rotation")
    roll_damping: Real = _damping(80.0, "feedback from the rate of a rolling foot to its rotation")
    touchdown_damping: Real = _damping(200.0, "how fast a late foot takes up the touch-down velocity")
    contact_ramp: Open = parameter(
        0.04, "time in which a point's force limit opens at touch-down, closes at lift-off", "s", gt=0, le=1
    )
    force_smoothing: Real = parameter(
        0.015, "time in which the forces of the sole's points adapt to another distribution", "s", ge=0, le=1
    )
    landing_share: Real = parameter(
        0.6, "share of a landing foot's sensed force that is its least force in the QP", ge=0, le=1
    )
    landing_force: Real = parameter(
        0.006, "least force of a sole point that lands, as share of the weight", ge=0, le=0.1
    )
    landing_compensation: Real = parameter(
        0.3, "share of a landing foot's force error that the other foot compensates", ge=0, le=1
    )
    landing_yield: Real = parameter(
        0.5, "share by which a landing foot's vertical acceleration may yield to the floor", ge=0, le=1
    )
    touchdown_lead: Real = parameter(
        0.0, "time before its planned contact from which a foot is let down", "s", ge=0, le=0.2
    )
    touchdown_window: Real = parameter(
        0.04, "time before its planned contact from which a touch counts as contact", "s", ge=0, le=0.5
    )
    sink_compensation: Real = parameter(
        0.55, "share of a landed heel's sinking by which the ball is raised as it comes down", ge=0, le=1
    )
    touchdown_velocity: Real = parameter(0.05, "speed of a late foot towards the floor", "m/s", ge=0, le=2)
    touchdown_rate: Real = parameter(1.0, "rate of a late sole's turn to the floor", "rad/s", ge=0, le=20)
    unsolved_limit: Real = parameter(
        0.05, "time for which the QP may stay unsolved before the run ends as infeasible", "s", gt=0, le=10
    )

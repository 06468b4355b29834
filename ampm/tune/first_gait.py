"""What a gait is about, by formula, for a body of any size; the rest is found."""

import math
import statistics

from ampm.controller_parameters import ControllerParameters
from ampm.description import BodyDescription
from ampm.parameters import GRAVITY, HUMAN, RunParameters

EASY_KEYS = ("gait.step_length", "gait.switching_velocity", "gait.c_s", "gait.c_y")
"""What a gait is about."""
_STEP = 0.3  # length of a step over the height of the hips [1]
_PACE = 0.15  # speed at the switch over the square root of g times the height of the hips [1]
_SHORT = 0.6  # height of hips below which steps take no less time, as feet land no faster [m]
_SWING = 0.188  # most speed at the switch, over hip height times the speed limit of most joints of a leg [1]
_QUICKER = math.sqrt(2.0)  # steps of half the duration where only the trunk sways: it tilts a quarter as much
_C_Y = 0.8  # of other bodies than the human: the trunk then rolls a little towards the standing foot
_C_S_WITHOUT_ARMS = 0.8  # the trunk alone balances the swing of the legs, and pitches less for a smaller c_s
_SOFT = 0.4  # velocity and rate at which a foot closes in on the floor, over those of a human's [1]
_SLOW = 0.25  # how fast it takes them up, over the same [1]
_TAKEN = 0.15  # share of a landing foot's sensed force that the QP takes as given: rotors make it a bounce
_YIELD_IN_DRAKE = 0.2  # of stance_yield; the human's share of the landing force suits Drake's spring, too
_FELT = {"stance_yield": 0.6, "force_smoothing": 0.0, "sink_compensation": 0.7}
"""Of robots with exact sensors: their small soles turn as the floor yields, and load crosses in few ticks."""
_HIPS = 0.90  # height of the human's hips, with which the rate of the swing foot's feedback was chosen [m]


def easy_gait(run: RunParameters, description: BodyDescription) -> dict[str, float]:
    """Step [m], speed at the switch [m/s] and force line of an easy gait of a body, by key."""
    hips, limits = description.hip_height, dict(description.speed_limits)
    speed = _PACE * math.sqrt(GRAVITY * hips) * min(1.0, math.sqrt(hips / _SHORT))
    if speeds := [limits[joint] for joint in description.left_leg.joints if joint in limits]:
        speed = min(speed, _SWING * statistics.median_low(speeds) * hips)
    step, c_s = _STEP * hips, 1.0 if description.has_arms else _C_S_WITHOUT_ARMS
    c_y = 1.0 if run.body.source == HUMAN else _C_Y
    if description.upright:
        step, speed, c_y = step / _QUICKER, speed * _QUICKER, description.upright.c_y
    return dict(zip(EASY_KEYS, (step, speed, c_s, c_y), strict=True))


def first_gait(run: RunParameters, description: BodyDescription) -> RunParameters:
    """The run of another body than the human with its mass and height, and a gait of its size.

    Values that are set stay; those of :data:`ampm.parameters.OPEN_KEYS` stay open. What it returns is
    returned unchanged. Raises InputError if mass or height are set, and not those of the body described.
    """
    for key, value in (("body.mass", description.mass), ("body.height", description.height)):
        if key in run.given and run.value(key) != value:
            rule = f"is not that of the body {run.body.source}, {value:.6g}"
            raise run.refusal(key, rule, "leave it out, as it follows from the body's model")
    hips, usual = description.hip_height, ControllerParameters()
    sized = {
        **easy_gait(run, description),
        # Angular momentum of a tilting trunk, as m h^2 of a human of 60 kg and 1.70 m.
        "controller.trunk_gain": usual.trunk_gain * description.mass / 60.0 * description.scale**2,
        # Rotors make the feet of robots heavy: they land softly. Late feet of upright legs have a long arm.
        "controller.touchdown_velocity": (1.0 if description.upright else _SOFT) * usual.touchdown_velocity,
        "controller.touchdown_rate": _SOFT * usual.touchdown_rate,
        "controller.touchdown_damping": _SLOW * usual.touchdown_damping,
        # The swing of a short leg is quick.
        "controller.swing_stiffness": usual.swing_stiffness * _HIPS / hips,
        "controller.swing_damping": usual.swing_damping * math.sqrt(_HIPS / hips),
        **({f"controller.{key}": gain for key, gain in _FELT.items()} if run.sensors.perfect else {}),
    }
    in_drake = run.simulation.engine == "drake"
    sized["controller.landing_share"] = usual.landing_share if in_drake else _TAKEN
    if in_drake and run.sensors.perfect:
        sized["controller.stance_yield"] = _YIELD_IN_DRAKE
    free = {key: value for key, value in sized.items() if key not in run.given}
    body = {"body.mass": description.mass, "body.height": description.height}
    return run.replace(free | body).giving(run.given)

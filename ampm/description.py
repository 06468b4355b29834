"""Description of a body for the rest of the code: its joints, soles and segments by role.

The model's builder fills one :class:`BodyDescription`; nothing else in the project names a joint.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

SOLE_POINT_GROUPS = ("heel", "ball", "tip")
"""Contact groups of one sole, back to front. A sole has two points in each, left then right; one without toes
has no tip."""

_STATURE = 1.70  # of the human for whom lengths of the controller were chosen [m]


@dataclass(frozen=True)
class SoleGeometry:
    """Outline of one sole in the foot's sole frame: x forward, y left, z up, origin on the sole; in m.

    The origin is the foot's *reference point*, from which the planner measures x in single support.
    The toe axis lies in the sole plane, on the line of the ball points. The ball of a foot without toes is
    its front edge, and ``tip_x`` is ``ball_x``.
    """

    heel_x: float  # of the two heel points, negative
    ball_x: float  # of the two ball points and of the toe axis
    tip_x: float  # of the two toe-tip points
    heel_half_width: float  # half the distance of the heel points
    ball_half_width: float
    tip_half_width: float
    ankle_x: float  # of the ankle's flexion axis
    ankle_height: float  # of that axis over the sole

    @property
    def has_toes(self) -> bool:
        """Whether the foot has a toe joint."""
        return self.tip_x > self.ball_x

    @property
    def length(self) -> float:
        """Length of the sole, heel to tip [m]."""
        return self.tip_x - self.heel_x

    @property
    def half_width(self) -> float:
        """Largest half width of the sole [m]."""
        return max(self.heel_half_width, self.ball_half_width, self.tip_half_width)


@dataclass(frozen=True)
class LegDescription:
    """Names of one leg's joints, segments and frames, hip to toe; a foot without toes has none of the toe."""

    hip: tuple[str, ...]  # joints, chain order
    knee: str  # flexion
    ankle: tuple[str, ...]  # joints, chain order
    foot_segment: str  # carries heel and ball
    sole_frame: str  # site at the foot's reference point, fixed to the foot segment
    sole_points: tuple[str, ...]  # sites: heel left/right, ball left/right and, with toes, tip left/right
    toe: str | None = None  # extension, the hinge between the foot's two segments
    toe_segment: str | None = None  # carries the toe tip
    straight_knee: float = 0.0  # angle [rad]
    knee_sign: float = 1.0  # 1 if the knee's angle grows in flexion, else -1

    @property
    def joints(self) -> tuple[str, ...]:
        """All joints of the leg in chain order."""
        return (*self.hip, self.knee, *self.ankle, *self.toes)

    @property
    def toes(self) -> tuple[str, ...]:
        """The toe joint, if there is one."""
        return () if self.toe is None else (self.toe,)


@dataclass(frozen=True)
class Passive:
    """Torque of a hinge without its motor: ``-damping v - stiffness (q - spring) - friction sign(v)``."""

    joint: str
    damping: float  # [N m s/rad]
    stiffness: float  # [N m/rad]
    spring: float  # angle at which the spring is at rest [rad]
    friction: float  # dry [N m]


class UprightLegs(NamedTuple):
    """How legs stay upright, as soles roll if they lean: the trunk sways above hips that do not move."""

    width: float  # distance of the soles' reference points [m]
    c_y: float  # force line with which nothing but the trunk sways [1]


@dataclass(frozen=True)
class BodyDescription:
    """Roles of a body's joints, segments and frames.

    With the root's frame along the world's axes the body faces +x, upright; so do the trunk's frame and those
    of the soles in the neutral posture. Heights are over the sole, of the body that stands straight.
    """

    height: float  # stature [m]; of another body than a human that of a human whose COM stands as high
    mass: float  # total [kg]
    root_segment: str  # that the free joint moves (pelvis)
    trunk_segment: str  # whose pitch is the trunk's lean (thorax)
    left_leg: LegDescription
    right_leg: LegDescription
    trunk: tuple[str, ...]  # joints between pelvis and thorax, chain order
    left_arm: tuple[str, ...]  # joints, chain order
    right_arm: tuple[str, ...]
    head: tuple[str, ...]  # joints that are of no other group
    sole: SoleGeometry  # the same for both feet
    hip_height: float  # of the hip centres [m]
    hip_half_width: float  # half the distance of the hip centres [m]
    leg_length: float  # hip centre to ankle with a straight knee [m]
    com_over_hip: float  # height of the COM over the hip centres [m]
    mirror: tuple[tuple[str, str, float], ...]  # (joint, its image in the sagittal plane, sign), every hinge
    torque_limits: tuple[tuple[str, float], ...]  # (joint, largest torque [N m]), in actuator order
    spread: tuple[tuple[str, float], ...] = ()  # (joint, sign) that body.arm_abduction turns at rest
    rest: tuple[tuple[str, float], ...] = ()  # (joint, angle [rad]) of those that do not rest at 0
    upright: UprightLegs | None = None  # if the ankles do not roll
    speed_limits: tuple[tuple[str, float], ...] = ()  # (joint, largest speed [rad/s]), where there is a limit
    passive: tuple[Passive, ...] = ()  # of the hinges that have passive torques

    @property
    def legs(self) -> tuple[LegDescription, LegDescription]:
        """Left leg, right leg."""
        return (self.left_leg, self.right_leg)

    @property
    def scale(self) -> float:
        """Size of the body, of which a stature of 1.70 m is one [1]."""
        return self.height / _STATURE

    @property
    def arms(self) -> tuple[str, ...]:
        """Joints of both arms, left first, and of the head."""
        return (*self.left_arm, *self.right_arm, *self.head)

    @property
    def has_arms(self) -> bool:
        """Whether arms can balance the swing of the legs."""
        return bool(self.left_arm)

    def sole_points(self) -> Iterator[tuple[int, str, str]]:
        """Yield (foot index, group, site name) of all sole points: left foot first, heel, ball, tip."""
        for foot, leg in enumerate(self.legs):
            for index, site in enumerate(leg.sole_points):
                yield foot, SOLE_POINT_GROUPS[index // 2], site

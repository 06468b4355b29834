"""Description of a body for the rest of the code: its joints, soles and segments by role.

The model's builder fills one :class:`BodyDescription`; nothing else in the project names a joint.
"""

from collections.abc import Iterator
from dataclasses import dataclass

SOLE_POINT_GROUPS = ("heel", "ball", "tip")
"""Contact groups of one sole, back to front. A sole has two points in each, left then right; one without toes
has no tip."""

_STATURE = 1.70  # of the human for whom lengths of the controller were chosen [m]


@dataclass(frozen=True)
class SoleGeometry:
    """Outline of one sole in the foot's sole frame: x forward, y left, z up, origin on the sole.

    The origin is the foot's *reference point*, from which the planner measures x in single support.
    The toe axis lies in the sole plane, on the line of the ball points. The ball of a foot without toes is
    its front edge, and ``tip_x`` is ``ball_x``.

    Attributes:
        heel_x: x of the two heel points [m], negative.
        ball_x: x of the two ball points and of the toe axis [m].
        tip_x: x of the two toe-tip points [m].
        heel_half_width: half the distance of the heel points [m].
        ball_half_width: half the distance of the ball points [m].
        tip_half_width: half the distance of the tip points [m].
        ankle_x: x of the ankle's flexion axis [m].
        ankle_height: height of the ankle's flexion axis over the sole [m].
    """

    heel_x: float
    ball_x: float
    tip_x: float
    heel_half_width: float
    ball_half_width: float
    tip_half_width: float
    ankle_x: float
    ankle_height: float

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
    """Names of one leg's joints, segments and frames, hip to toe.

    Attributes:
        hip: hip joints in chain order.
        knee: knee flexion.
        ankle: ankle joints in chain order.
        toe: toe extension, the hinge between the foot's two segments; None of a foot without toes.
        foot_segment: segment that carries heel and ball.
        toe_segment: segment that carries the toe tip; None of a foot without toes.
        sole_frame: site at the foot's reference point, fixed to the foot segment.
        sole_points: sites: heel left/right, ball left/right and, with toes, tip left/right.
        straight_knee: angle of the straight knee [rad].
        knee_sign: 1 if the knee's angle grows in flexion, else -1.
    """

    hip: tuple[str, ...]
    knee: str
    ankle: tuple[str, ...]
    toe: str | None
    foot_segment: str
    toe_segment: str | None
    sole_frame: str
    sole_points: tuple[str, ...]
    straight_knee: float = 0.0
    knee_sign: float = 1.0

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
    """Torque that a hinge has without its motor: ``-damping v - stiffness (q - spring) - friction sign(v)``.

    Attributes:
        joint: its name.
        damping: [N m s/rad].
        stiffness: [N m/rad].
        spring: angle at which the spring is at rest [rad].
        friction: dry friction [N m].
    """

    joint: str
    damping: float
    stiffness: float
    spring: float
    friction: float


@dataclass(frozen=True)
class BodyDescription:
    """Roles of a body's joints, segments and frames.

    With the root's frame along the world's axes the body faces +x, upright; so do the trunk's frame and those
    of the soles in the neutral posture.

    Attributes:
        height: stature [m]; of another body than a human that of a human whose COM stands as high.
        mass: total mass [kg].
        root_segment: the segment that the free joint moves (pelvis).
        trunk_segment: segment whose pitch is the trunk's lean (thorax).
        trunk_frame: frame of the trunk: the segment itself, or a site on it.
        left_leg, right_leg: the legs.
        waist: joints between pelvis and abdomen, chain order.
        chest: joints between abdomen and thorax, chain order.
        left_arm, right_arm: joints of the arms, chain order.
        head: joints that are of no other group.
        sole: outline of one sole, the same for both feet.
        hip_height: height of the hip centres over the sole when standing straight [m].
        hip_half_width: half the distance of the hip centres [m].
        leg_length: hip centre to ankle with a straight knee [m].
        com_over_hip: height of the COM over the hip centres when standing straight [m].
        mirror: (joint, mirrored joint, sign) for every hinge: reflection in the sagittal plane.
        torque_limits: (joint, largest torque [N m]) for every actuated hinge, in actuator order.
        spread: (joint, sign) of the hinges that ``body.arm_abduction`` turns at rest.
        rest: (joint, angle [rad]) at rest, of those that do not rest at 0, inside of their limits.
        speed_limits: (joint, largest speed [rad/s]) of the hinges that have a limit.
        passive: of the hinges that have passive torques.
    """

    height: float
    mass: float
    root_segment: str
    trunk_segment: str
    trunk_frame: str
    left_leg: LegDescription
    right_leg: LegDescription
    waist: tuple[str, ...]
    chest: tuple[str, ...]
    left_arm: tuple[str, ...]
    right_arm: tuple[str, ...]
    head: tuple[str, ...]
    sole: SoleGeometry
    hip_height: float
    hip_half_width: float
    leg_length: float
    com_over_hip: float
    mirror: tuple[tuple[str, str, float], ...]
    torque_limits: tuple[tuple[str, float], ...]
    spread: tuple[tuple[str, float], ...] = ()
    rest: tuple[tuple[str, float], ...] = ()
    speed_limits: tuple[tuple[str, float], ...] = ()
    passive: tuple[Passive, ...] = ()

    @property
    def legs(self) -> tuple[LegDescription, LegDescription]:
        """Left leg, right leg."""
        return (self.left_leg, self.right_leg)

    @property
    def scale(self) -> float:
        """Size of the body, of which a stature of 1.70 m is one [1]."""
        return self.height / _STATURE

    @property
    def trunk(self) -> tuple[str, ...]:
        """Waist and chest joints."""
        return (*self.waist, *self.chest)

    @property
    def arms(self) -> tuple[str, ...]:
        """Joints of both arms, left first, and of the head."""
        return (*self.left_arm, *self.right_arm, *self.head)

    def sole_points(self) -> Iterator[tuple[int, str, str]]:
        """Yield (foot index, group, site name) of all sole points: left foot first, heel, ball, tip."""
        for foot, leg in enumerate(self.legs):
            for index, site in enumerate(leg.sole_points):
                yield foot, SOLE_POINT_GROUPS[index // 2], site

"""A body that passes through itself is found: before it walks, and in the walk."""

import mujoco
import numpy as np
import pytest
from scipy.optimize import lsq_linear

from ampm.body.limits import CLEARANCE
from ampm.body.robot import Gaps, Robot
from tests.saved_run import make_run
from tests.solved import COARSE, body_of, motion_of, walk_of
from tests.test_body_files import read
from validation.show.report import render
from validation.store.saved import load_saved_run
from validation.trial.shapes import REACH, Shapes, least_distances

LIMB = """<body name="{name}" pos="0 {y} 0">
  <joint name="{name}_x" axis="1 0 0"/><joint name="{name}_y" axis="0 1 0"/>
  <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
  <geom type="capsule" fromto="0 0 0 0 0 -.3" size="{radius}" contype="0" conaffinity="0"/>
</body>"""
RADII = {"one": 0.03, "two": 0.02}
XML = f"""<mujoco><worldbody><body name="middle"><freejoint/>
  <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
  {"".join(LIMB.format(name=name, y=0.12 * i, radius=RADII[name]) for i, name in enumerate(RADII))}
</body></worldbody></mujoco>"""


def between_segments(a, b):
    """Least distance of two segments, each given by both ends, shape (2, 3)."""
    columns = np.column_stack([a[1] - a[0], b[0] - b[1]])
    best = lsq_linear(columns, b[0] - a[0], bounds=(0.0, 1.0), tol=1e-14)
    return np.linalg.norm(columns @ best.x - (b[0] - a[0]))


def bent(only_legs=False, **angles):
    """The closest parts of the default human, or of its legs, some of whose joints are bent."""
    model = body_of().compile()
    q = model.qpos0.copy()
    for joint, angle in angles.items():
        q[model.joint(joint).qposadr[0]] = angle
    return Shapes(model, only_legs=only_legs).recorded_gaps(q)


def test_the_distance_of_two_capsules_is_that_of_their_axes_less_the_radii():
    model = mujoco.MjModel.from_xml_string(XML)
    data, shapes = mujoco.MjData(model), Shapes(model)
    near = 0
    for angles in np.random.default_rng(0).uniform(-0.6, 0.6, (40, 4)):
        data.qpos[:] = [0.3, -0.2, 1.0, 1.0, 0.0, 0.0, 0.0, *angles]
        gaps = shapes.recorded_gaps(data.qpos)
        mujoco.mj_kinematics(model, data)
        axes = [
            data.body(name).xpos + np.outer([0.0, -0.3], data.body(name).xmat.reshape(3, 3)[:, 2])
            for name in RADII
        ]
        distance = between_segments(*axes) - sum(RADII.values())
        assert gaps.distance[0] == pytest.approx(min(distance, REACH), abs=1e-6)
        if 0.0 < distance < REACH:
            near += 1
            assert gaps.parts == ("one and two",)
            assert np.linalg.norm(np.diff(gaps.points[0], axis=0)) == pytest.approx(distance, abs=1e-5)
    assert near > 5


def test_no_shapes_are_nearer_than_by_their_boxes():
    model = body_of().compile()
    data, shapes = mujoco.MjData(model), Shapes(model)
    for angles in np.random.default_rng(0).uniform(-0.6, 0.6, (5, model.nq - 7)):
        data.qpos[7:] = angles
        mujoco.mj_kinematics(model, data)
        least = least_distances(*shapes.boxes, data.geom_xpos, data.geom_xmat.reshape(-1, 3, 3))
        exact = [mujoco.mj_geomDistance(model, data, *pair, 2.0, None) for pair in shapes.boxes[-1].tolist()]
        assert (least < np.array(exact) + 1e-6).all()


@pytest.mark.parametrize(
    ("angles", "parts"),
    [
        ({"left_shoulder_roll": -0.15}, "left hand and left thigh"),
        ({"left_hip_roll": -0.2}, "left shank and right shank"),
        ({"left_shoulder_yaw": -1.2, "left_elbow_pitch": -1.6}, "abdomen and left forearm"),
    ],
)
def test_arms_legs_and_trunk_are_watched(angles, parts):
    gaps = bent(**angles)
    assert gaps.parts == (parts,)
    assert gaps.distance[0] < 0.0
    assert bent(left_shoulder_roll=0.1, right_shoulder_roll=-0.1).distance[0] > CLEARANCE


def test_the_torso_of_a_body_without_arms_is_no_limb():
    """A small body was refused, as its chest comes near its thighs."""
    body = read()
    assert len(Shapes(body.compile(), body.description.trunk_segment)) < len(Shapes(body.compile()))


def test_of_the_legs_alone_a_hand_on_a_thigh_is_not_seen():
    assert bent(only_legs=True).distance[0] > 0.0
    assert bent(only_legs=True, left_hip_roll=-0.3, right_hip_roll=0.3).distance[0] < 0.0
    assert bent(left_shoulder_roll=-0.3).distance[0] < 0.0 < bent(True, left_shoulder_roll=-0.3).distance[0]


def test_a_walk_that_passes_through_itself_fails(tmp_path):
    saved = load_saved_run(make_run(tmp_path / "run", steps=2, angles={"left_shoulder_roll": -0.15}))
    clearance, judged = saved.summary["margins"]["clearance"], saved.summary["metrics"]["clearance_shortfall"]
    assert clearance["where"] == "left hand and left thigh"
    assert judged["value"] == pytest.approx(CLEARANCE - clearance["value"])
    assert judged["pass"] is False
    assert clearance["where"] in render(saved)


def test_a_part_of_one_side_counts_in_both_steps():
    plain = walk_of().robot
    right = plain.velocity_indices(("right_elbow_pitch",))[0] + 1

    def uneven(q):  # the right arm alone is near to something, where it is bent
        return Gaps(0.5 - q[:, right], ("right",) * len(q), np.zeros((len(q), 2, 3)))

    motion = motion_of(COARSE)
    gaps = Robot(plain.model, plain.description, uneven).step_gaps(motion.q)
    two_steps = np.maximum(motion.q[:, right], plain.mirror_q(motion.q)[:, right])
    np.testing.assert_array_equal(gaps.distance, 0.5 - two_steps)
    assert (motion.q[:, right] < two_steps).any()

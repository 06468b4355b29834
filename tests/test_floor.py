"""The controller that keeps to the plan's footsteps, on a floor that is not the plan's."""

import math

import pytest

import ampm
import validation as val

SLOPE = math.radians(2.0)


@pytest.mark.parametrize(
    "disturbance",
    [
        {"slope_along": SLOPE},
        {"slope_along": -SLOPE},
        {"slope_across": SLOPE},
        {"step_height": -0.01},
        {"softness_factor": 4.0},
    ],
    ids=str,
)
def test_an_unknown_floor_is_walked(disturbance):
    run = ampm.load_run("normal", gait={"steps": 8}, simulation={"time_step": 2e-3}, disturbance=disturbance)
    assert val.walk(run.as_is()).record.outcome.name == "completed"

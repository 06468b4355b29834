"""Gate of the controller beside this file: pytest -n 4."""

import pytest
from controller import Stepped

SHORT = {"steps": 4}


@pytest.mark.parametrize("controller", ["ampm", Stepped])
@pytest.mark.parametrize("gait", ["normal", "momentum"])
def test_walks_within_the_tolerances(walked, assert_within, gait, controller):
    walked(gait, controller=controller, gait=SHORT)
    assert_within("default")


def test_spares_its_motors(walked):
    trial = walked("normal", controller=Stepped, gait=SHORT)
    assert trial.metrics["margin_torque"].value < 0.9  # of a motor's limit

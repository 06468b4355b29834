"""The still body: it weighs m g, and an instrument that is off does not find it."""

from dataclasses import replace

import pinocchio as pin
import pytest

from ampm.exceptions import BodilyRefusal
from ampm.parameters import RunParameters
from models.human import build
from validation.measure.measure import measure, standing_check
from validation.measure.standing import SETTLE, stand, weigh
from validation.trial.bridge import pinocchio_model, to_pinocchio
from validation.trial.record import SimulationRecord
from validation.trial.shapes import make_robot

RUN = RunParameters()


@pytest.fixture(scope="module")
def record() -> SimulationRecord:
    return stand(RUN, build(RUN.body, RUN.contact, RUN.simulation))


def model_of(run: RunParameters) -> pin.Model:
    return pinocchio_model(build(run.body, run.contact, run.simulation).compile())


def test_a_still_body_presses_with_its_weight_under_its_com(record: SimulationRecord) -> None:
    check = standing_check(measure(record, model_of(RUN), to_pinocchio), settle=SETTLE)
    assert check.still
    assert check.relative_error < 1e-7
    assert abs(check.zmp_error).max() < 1e-5
    assert record.outcome.completed
    assert (record.qp_status == 0).all()


def test_a_force_law_with_a_wrong_scale_shows(record: SimulationRecord) -> None:
    scaled = replace(record, point_force=1.001 * record.point_force)
    check = standing_check(measure(scaled, model_of(RUN), to_pinocchio), settle=SETTLE)
    assert check.relative_error == pytest.approx(0.001, rel=1e-3)


def test_a_com_that_is_too_high_is_refused() -> None:
    run = RUN.replace({"gait.com_height": 1.2})
    with pytest.raises(BodilyRefusal, match=r"1\.2 m; lower gait\.com_height"):
        stand(run, build(run.body, run.contact, run.simulation))


def test_the_run_s_own_gains_do_not_decide_what_a_body_weighs() -> None:
    slack = RUN.replace({"controller.com_damping": 3.0, "controller.posture_damping": 10.0})
    model = build(RUN.body, RUN.contact, RUN.simulation)
    robot = make_robot(model.compile(), model.description)
    assert weigh(slack, model, robot).relative_error == weigh(RUN, model, robot).relative_error < 1e-7

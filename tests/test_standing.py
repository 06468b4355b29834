"""The still body: it presses with its weight under its COM, and an instrument that is off shows."""

from dataclasses import replace

import numpy as np
import pytest

from ampm.run_file import load_run
from validation.measure.measure import measure
from validation.trial.bridge import to_pinocchio
from validation.trial.plan import Request, plan_walk
from validation.trial.simulate import simulate

RUN = load_run(gait={"planner": "none"}, command={"duration": 2.0})


def test_a_still_body_presses_with_its_weight_under_its_com():
    planned = plan_walk(Request("standing", RUN))
    model = planned.body.robot.model
    record = simulate(planned)
    measured = measure(record, model, to_pinocchio)
    rest = measured.time >= 1.5
    force = measured.force[rest].mean(axis=0)
    np.testing.assert_allclose(force, [0.0, 0.0, measured.weight], rtol=0.0, atol=1e-7 * measured.weight)
    zmp, com = measured.zmp[rest].mean(axis=0), measured.com[rest].mean(axis=0)
    np.testing.assert_allclose(zmp, com[:2], rtol=0.0, atol=1e-5)
    assert record.outcome.completed
    assert (record.qp_status == 0).all()
    scaled = measure(replace(record, point_force=1.001 * record.point_force), model, to_pinocchio)
    residual = scaled.self_checks.impulse_residual - measured.self_checks.impulse_residual
    assert residual == pytest.approx(0.001, rel=1e-3)

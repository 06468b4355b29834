"""Plans from samples of COM and ZMP, against the closed form that wrote them."""

import numpy as np
import pytest

import ampm
from ampm.exceptions import InputError
from ampm.planner.sampled import sampled_contacts, sampled_plan

RATE = 1000


def samples(name, steps, rate=RATE):
    plan = ampm.plan(ampm.load_run(name, gait={"steps": steps}))
    return plan, np.unique(np.minimum(np.arange(plan.duration * rate + 1) / rate, plan.duration))


def table_plan(plan, times, **changed):
    s = plan.sample(times)
    contacts = sampled_contacts(times, s.stance_name, s.left_placement, s.right_placement)
    given = {
        "time": times, "com": s.com[:, :2], "zmp": s.zmp, "contacts": contacts, "mass": plan.mass,
        "com_height": plan.com_height, "acceleration": s.com_acceleration[:, :2],
        "angular_momentum": s.angular_momentum[0],
    }  # fmt: skip
    return sampled_plan(**{**given, **changed})


@pytest.mark.parametrize("name", ["normal", "momentum"])
def test_a_table_gives_back_the_plan_that_wrote_it(name):
    plan, times = samples(name, 4)
    sampled, between = table_plan(plan, times), np.linspace(0.0, plan.duration, 3001)
    a, b = plan.sample(between), sampled.sample(between)
    for field, tolerance in (
        ("com", 1e-8), ("com_velocity", 1e-5), ("com_acceleration", 2e-2), ("zmp", 1e-3), ("force", 1.0),
        ("moment", 0.2), ("angular_momentum", 1e-3),
    ):  # fmt: skip
        np.testing.assert_allclose(getattr(b, field), getattr(a, field), atol=tolerance, err_msg=field)
    for field in ("l_s", "inverse_a_s", "a_d", "c_d", "single_support_duration", "beta", "mean_velocity"):
        expected = getattr(plan.constants, field)
        assert getattr(sampled.constants, field) == pytest.approx(expected, rel=0.02, abs=1e-3), field
    assert sampled.contacts.steps == plan.contacts.steps
    placed = [step.position for step in plan.contacts.footsteps]
    np.testing.assert_allclose(
        [step.position for step in sampled.contacts.footsteps], placed, rtol=0.0, atol=1e-12
    )
    assert sampled.residuals().largest == 0.0  # one phase


def test_without_accelerations_the_force_passes_through_the_com():
    plan, times = samples("momentum", 2)
    sample = table_plan(plan, times, acceleration=None).sample(times)
    assert not sample.moment.any()
    expected = 9.81 / plan.com_height * (sample.com[:, :2] - sample.zmp)
    np.testing.assert_allclose(sample.com_acceleration[:, :2], expected, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"zmp": lambda times: np.zeros((3, 2))}, "shape"),
        ({"com": lambda times: np.full((len(times), 2), np.nan)}, "no numbers"),
        ({"time": lambda times: times + 0.1}, "ascend from 0"),
        ({"time": lambda times: 0.9 * times}, "ascend from 0"),
    ],
)
def test_tables_that_make_no_plan(changed, words):
    plan, times = samples("normal", 1, 100)
    with pytest.raises(InputError, match=words):
        table_plan(plan, times, **{name: value(times) for name, value in changed.items()})

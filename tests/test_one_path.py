"""One way through a tick: whoever controls the body, and whatever disturbs it."""

import numpy as np
import pytest

from ampm.control.controller import TrackingController
from ampm.control.joint_pd import JointPD
from tests.records import first_difference
from tests.solved import simulated
from validation.trial.simulate import ClosedLoop


class Ours(TrackingController):
    """Our controller by an ``update`` of its own."""

    def update(self, state, touch, reference):
        return super().update(state, touch, reference)


@pytest.mark.parametrize(
    ("settings", "options", "kind"),
    [
        ((), {}, TrackingController),
        ((), {"controller": Ours}, Ours),
        ((), {"controller": JointPD}, JointPD),
        (("disturbance.actuation_delay=0.002",), {}, TrackingController),
        (("sensors.estimator=kalman",), {}, TrackingController),
        (("disturbance.step_height=0.002", "disturbance.step_number=3"), {}, TrackingController),
        (("controller.stabilizer=stepping",), {}, TrackingController),
    ],
    ids=["ours", "a subclass", "a user's", "faults", "sensors", "stones", "stepping"],
)
def test_every_tick_is_one_call_of_update_in_the_loops_tick(monkeypatch, settings, options, kind):
    ticks, updates, read, update = [], [], ClosedLoop.read, kind.update

    def counted(self):
        assert type(self.controller) is kind
        ticks.append(self.done)
        return read(self)

    def counted_update(self, state, touch, reference):
        updates.append(state.time)
        return update(self, state, touch, reference)

    monkeypatch.setattr(ClosedLoop, "read", counted)
    monkeypatch.setattr(kind, "update", counted_update)
    record = simulated(*settings, steps=1, **options)
    assert ticks == list(range(0, record.steps, record.substeps))
    np.testing.assert_array_equal(updates, record.tick_time)


def test_a_subclass_walks_to_the_same_bits():
    one, other = (simulated(controller=controller) for controller in (None, Ours))
    assert one.outcome.completed
    assert first_difference(one, other) is None

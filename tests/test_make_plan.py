"""Plans of samples by ampm.make_plan, before and during a walk, and whether a plan obeys Newton's law.

Some have a COM that rises and sinks.
"""

import numpy as np
import pytest

import ampm
import validation as val
from ampm.planner.newton import check_newton
from ampm.planner.table import plan_table, sample_times
from tests import properties, test_footsteps
from tests.solved import COARSE, planned_walk, walk_of

in_turn = ampm.Contacts.in_turn
NOW = 0.8
"""A time in the second step's single support [s]."""


@pytest.fixture
def walk():
    return planned_walk()


def samples_of(plan, begin=0.0, rate=200.0):
    """Arguments of make_plan that give a plan from an instant on."""
    times = np.append(np.arange(begin, plan.duration - 1e-3, 1.0 / rate), plan.duration)
    at = plan.sample(times)
    names = {"com": at.com, "zmp": at.zmp, "com_acceleration": at.com_acceleration[:, :2]}
    return {"times": times, "contacts": plan.contacts, **{name: np.array(v) for name, v in names.items()}}


def made(samples, **more):
    return ampm.make_plan(walk_of(COARSE).run, walk_of(COARSE).robot, **(samples | more))


def later(contacts, by):
    """The same contacts with all switches after NOW later by some time [s]."""
    switches = np.where(contacts.switches > NOW, contacts.switches + by, contacts.switches)
    return ampm.Contacts.in_turn(contacts.footsteps, switches)


def changed(statement):
    """Samples from NOW on, changed by a statement on their names."""
    samples = samples_of(planned_walk(), NOW) | {"after": planned_walk()}
    exec(statement, globals(), samples)
    return made(samples)


def test_contacts_in_turn_are_those_of_the_plans(walk):
    found = ampm.Contacts.in_turn(walk.contacts.footsteps, walk.contacts.switches)
    assert found.phases == walk.contacts.phases


def test_samples_and_their_table_make_the_same_plan(walk):
    table = plan_table(walk, sample_times(walk.duration, 200.0))
    of_table = ampm.TablePlanner(table).plan(walk_of(COARSE).run, walk_of(COARSE).robot)
    vectors = {
        name: np.column_stack([table[f"{name}_{axis}"] for axis in axes])
        for name, axes in (("com", "xyz"), ("zmp", "xy"), ("com_acceleration", "xy"))
    }
    found = made({"times": table["time"], "contacts": of_table.contacts, **vectors})
    times = np.linspace(0.0, found.duration, 301)
    for name, values in vars(found.sample(times)).items():
        np.testing.assert_array_equal(values, getattr(of_table.sample(times), name), err_msg=name)
    np.testing.assert_array_equal(found.posture.sample(times).q, of_table.posture.sample(times).q)


def test_a_plan_begins_on_the_way_with_a_com_that_jumped(walk):
    samples = samples_of(walk, NOW)
    samples["com"] = samples["com"] + [0.03, -0.01, 0.0]
    del samples["zmp"]
    moved = list(walk.contacts.footsteps)
    x, y, z = moved[3].position
    moved[3] = moved[3]._replace(position=(x + 0.05, y, z))
    contacts = later(ampm.Contacts.in_turn(moved, walk.contacts.switches), -0.05)
    found = made(samples, contacts=contacts, after=walk)
    old, new = walk.sample(NOW), found.sample(NOW)
    np.testing.assert_allclose(new.com - old.com, [[0.03, -0.01, 0.0]], atol=1e-12)
    np.testing.assert_allclose(new.angular_momentum, old.angular_momentum, atol=1e-12)
    for now, before in zip(found.feet.sample([NOW]), walk.feet.sample([NOW]), strict=True):
        np.testing.assert_allclose(now.position, before.position, atol=1e-12)
        np.testing.assert_allclose(now.velocity, before.velocity, atol=1e-9)
    landing = contacts.switches[3]
    foot = found.feet.sample([landing + 0.05])[contacts.footsteps[3].foot == "right"]
    assert foot.position[0, 0] == pytest.approx(x + 0.05, abs=1e-3)
    state, at = found.posture.sample([NOW, landing]).q, walk.posture.sample([NOW, landing + 0.05]).q
    np.testing.assert_allclose(state, at, atol=1e-12)
    for time in (0.5 * (NOW + landing), landing + 0.03):  # before the landing all goes faster
        before, now, after = found.posture.sample(time + np.array([-1e-4, 0.0, 1e-4])).q
        rate, bend = (after - before) / 2e-4, (after + before - 2.0 * now) / 1e-8
        state = found.posture.sample(time)
        np.testing.assert_allclose(rate[7:], state.v[0, 6:], atol=1e-2)
        np.testing.assert_allclose(bend[7:], state.acceleration[0, 6:], atol=1.0)


@pytest.mark.parametrize(("now", "by"), [(0, 0), (0.62, -0.03), (0.64, -0.03), (0.67, 0.1), (2.1, 0)])
def test_feet_go_on_from_where_they_are_also_on_a_heel(walk, now, by):
    if now > 2.0:  # over footsteps, while the other heel rises
        walk = made(samples_of(test_footsteps.plan(test_footsteps.WALKS["straight"])))
    samples, switches = samples_of(walk, now, 2000.0), np.array(walk.contacts.switches)
    samples["zmp"][0] -= [0.003, 0.0]  # a jump
    switches[2] += by
    found = made(samples, contacts=in_turn(walk.contacts.footsteps, switches), after=walk)
    for here, before in zip(*(one.feet.sample([0, 0.3, now or NOW]) for one in (found, walk)), strict=True):
        np.testing.assert_allclose(here.position, before.position, atol=1e-12)
    properties.assert_feet_stand(found)


def test_what_is_left_out_follows_from_the_rest(walk):
    samples = samples_of(walk, NOW)
    rate, moment = walk.gravity / walk.com_height, walk.sample(samples["times"]).moment
    arm = moment[:, ::-1] * [-1.0, 1.0] / walk.weight
    com, zmp, acceleration = samples["com"][:, :2], samples["zmp"], samples.pop("com_acceleration")
    kept = {"times": samples["times"], "contacts": walk.contacts, "com": com, "after": walk}
    for given, name, expected in (
        ({"zmp": zmp, "moment": moment}, "com_acceleration", rate * (com - zmp + arm)),
        ({"zmp": zmp, "com_acceleration": acceleration}, "moment", moment),
        ({"com_acceleration": acceleration, "moment": moment}, "zmp", zmp),
        ({"zmp": zmp, "moment": moment, "com_acceleration": acceleration}, "moment", moment),
    ):
        found = getattr(made(kept | given).sample(samples["times"]), name)[:, :2]
        np.testing.assert_allclose(found, expected, atol=1e-9, err_msg=name)


def test_arrays_are_copied_and_read_only(walk):
    samples = samples_of(walk, NOW)
    found = made(samples, after=walk)
    before = found.sample(NOW + 0.1)
    for name in ("times", "com", "zmp", "com_acceleration"):
        samples[name] += 1.0
    np.testing.assert_array_equal(found.sample(NOW + 0.1).com, before.com)
    with pytest.raises(ValueError, match="read-only"):
        found.phases[0].x.zmp[0] = 0.0


STEPS = [ampm.Footstep("right" if k % 2 else "left", (0.3 * k, 0.1 * (-1.0) ** k, 0.0)) for k in range(4)]
TIMES = [0.0, 0.5, 0.6, 1.1, 1.2]


class Moved:
    """A law with something added to a quantity."""

    def __init__(self, law, name, by):
        self.law, self.name, self.by = law, name, by

    def evaluate(self, time):
        state = self.law.evaluate(time)
        return state._replace(**{self.name: getattr(state, self.name) + self.by * np.ones_like(time)})


RISE = 0.005
"""Amplitude of the height [m]: once up and down a step, highest in mid-stance."""


class Bounce:
    """The AMPM's COM across the floor, over a height that varies; the ZMP follows by Newton's law."""

    plans_footsteps = False

    def __init__(self, rise=RISE, **changed):
        self.rise, self.changed = rise, changed

    def plan(self, run, robot):
        base = ampm.plan(run)
        single, period = base.constants.single_support_duration, base.constants.step_duration
        times = np.linspace(0.0, base.duration, int(200 * base.duration) + 1)
        sample, omega = base.sample(times), 2.0 * np.pi / period
        high = run.gait.com_height + self.rise * (np.cos(omega * (times - 0.5 * single)) - 1.0)
        motion = {"com": np.column_stack([sample.com[:, :2], high])}
        motion |= {"com_acceleration": sample.com_acceleration[:, :2]}
        return ampm.make_plan(run, robot, times=times, contacts=base.contacts, **motion | self.changed)


def test_force_and_zmp_follow_the_height():
    bouncing = plan()
    times = np.linspace(0.05, bouncing.duration - 0.05, 501)
    sample, omega = bouncing.sample(times), 2.0 * np.pi / bouncing.constants.step_duration
    assert np.ptp(sample.force[:, 2]) == pytest.approx(2.0 * RISE * omega**2 * bouncing.mass, rel=0.01)
    line = sample.com[:, :2] - sample.com[:, 2:] * sample.force[:, :2] / sample.force[:, 2:]
    np.testing.assert_allclose(sample.zmp, line, atol=1e-12)  # the force passes through the COM
    assert check_newton(bouncing) < 1e-4


class Careless(Bounce):
    """Changes its robot, which is its own."""

    def plan(self, run, robot):
        plan = super().plan(run, robot)
        robot.model.gravity.linear = np.zeros(3)
        robot.gaps.__self__.boxes[0][:] = 0.0
        return plan


def test_a_walk_with_a_varying_height_is_met():
    run = ampm.load_run("normal", gait={"steps": 3}, simulation={"time_step": 0.002}).as_is()
    trial = val.walk(run, planner=Careless())
    assert trial.run.gait.planner == f"{__name__}:Careless"
    assert type(trial.plan.posture).__name__ == "PeriodicPosture"
    assert trial.verdict.passed, trial.verdict.reason
    assert trial.summary["margins"]["clearance"]["value"] < 0.05
    assert np.ptp(trial.measured.com[:, 2]) == pytest.approx(2.0 * RISE, rel=0.1)


def plan(slope=0.0, **changed):
    """Plan of the walk that all tests share."""
    return Bounce(**changed).plan(walk_of(COARSE).run.replace({"gait.slope": slope}), walk_of(COARSE).robot)

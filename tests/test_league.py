"""Planners and tasks of the league: planners held to the formulas of their sources, tasks complete."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import ampm
from ampm.planner import routes
from ampm.planner.newton import check_newton
from examples.planners.alip import Alip, wanted_step
from examples.planners.centroidal import MOST_MOMENT, Centroidal
from examples.planners.hlip import Deadbeat, Lqr, deadbeat, regulator, step_to_step
from examples.planners.pendulum import GRAVITY
from examples.planners.stiffness import Stiffness
from examples.planners.vhip import HIGH, LOW, K, Vhip, feedback
from tests.solved import COARSE, walk_of
from tests.test_negative_controls import script
from validation.study.sweep.design import load_sweep

LEAGUE = Path(__file__).parents[1] / "examples/league"
PENDULA = [(3.3, 0.5, 0.1), (3.3, 0.35, 0.0), (4.0, 0.6, 0.2)]
"""w [1/s], durations of single and double support [s]."""
OFF = np.array([[0.02, -0.01], [0.05, 0.08]])
"""A deviation of the COM and its velocity [m, m/s]."""
NOW = 0.8
"""In the second single support [s]."""


def planned(kind, **changes):
    run = walk_of(COARSE).run.replace({}, **changes)
    planner = kind()
    return planner, planner.plan(run, walk_of(COARSE).robot)


def replanned(planner, plan, velocity):
    """The plan after a change of the velocity [m/s]."""
    reference = plan.table(np.array([NOW]))
    state = ampm.State(NOW, reference.q[0].copy(), reference.v[0].copy())
    state.v[:3] += velocity
    return planner.replan(NOW, state, None, plan)


def over(**last):
    """Footsteps, the last of which has more than the others."""
    *others, end = routes.straight(4, 0.3, 0.2)
    return [*others, end._replace(**last)]


def fallen(w, duration, position, velocity):
    """Position and velocity of a pendulum after some time."""
    rate, start = np.array([[0.0, 1.0], [w * w, 0.0]]), [position, velocity]
    return solve_ivp(lambda t, s: rate @ s, (0.0, duration), start, rtol=1e-11, atol=1e-13).y[:, -1]


@pytest.mark.parametrize(("w", "single", "double"), PENDULA)
def test_hlip_has_the_steps_of_its_pendulum_and_needs_two_its_regulator_more(w, single, double):
    A, B = step_to_step(w, single, double)
    state, step = np.array([0.03, -0.4]), 0.2
    end = fallen(w, single, state[0] + double * state[1] - step, state[1])
    np.testing.assert_allclose(A @ state + B * step, end, atol=1e-9)
    closed = A + np.outer(B, deadbeat(w, single, double))
    np.testing.assert_allclose(closed @ closed, 0.0, atol=1e-10)
    softer = A + np.outer(B, regulator(w, single, double))
    assert 1e-3 < np.abs(np.linalg.eigvals(softer)).max() < 1.0


@pytest.mark.parametrize(("w", "duration", "_"), PENDULA)
def test_the_step_of_alip_brings_the_momentum_about_the_contact_to_zero(w, duration, _):
    x, speed = 0.04, 0.3  # the momentum about the contact, over m H
    step = wanted_step(w, duration, x, speed)
    assert fallen(w, duration, x - step, speed)[1] == pytest.approx(0.0, abs=1e-9)
    assert step == pytest.approx(deadbeat(w, duration, 0.0) @ [x, speed])  # the same without double support


@pytest.mark.parametrize("off", [[0.004, -0.003, 0.0], [0.0, 0.0, 0.004], [0.002, 0.003, -0.004]])
def test_the_dcm_of_the_vhip_returns_at_its_pole(off):
    w, height, wide = 3.3, 0.9, np.array([9.0, 9.0])

    def rate(t, state):
        com, velocity = state.reshape(2, 3)
        error = com + velocity / w - [0.0, 0.0, height]
        zmp, share = feedback(w, height, error, velocity, np.zeros(2), -wide, wide)
        force = w * w * (1.0 + share) * (com - np.append(zmp, 0.0)) - [0.0, 0.0, w * w * height]
        return np.append(velocity, force)

    start = np.append(np.array([0.0, 0.0, height]) + off, np.zeros(3))
    com, velocity = solve_ivp(rate, (0.0, 0.3), start, rtol=1e-9, atol=1e-11).y[:, -1].reshape(2, 3)
    left = com + velocity / w - [0.0, 0.0, height]
    np.testing.assert_allclose(left, np.exp((1.0 - K) * w * 0.3) * np.array(off), atol=6e-5)


def test_the_vhip_uses_its_height_where_the_sole_does_not_suffice():
    """A push forward over a ZMP at its limit: the plan goes on with a COM that leaves its height."""
    planner, plan = planned(Vhip)
    run, robot = walk_of(COARSE).run, walk_of(COARSE).robot
    pushed = replanned(planner, plan, [0.2, 0.0, 0.0])
    times = np.linspace(NOW, plan.duration, 1001)
    height = pushed.sample(times).com[:, 2] - run.gait.com_height
    assert 2 * LOW < height.min() < -0.005
    assert height.max() < 2 * HIGH
    assert abs(height[-1]) < 2e-3
    assert check_newton(pushed) < 2e-4
    force = pushed.sample(times).force
    assert force[:, 2].min() > 0.3 * robot.mass * GRAVITY


@pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")  # of OSQP
def test_in_a_piece_springs_at_the_contacts_move_the_body_as_planned():
    """Forces and moments as ``Centroid::CalcEndWrench`` of the source has them, integrated."""
    planner, plan = planned(Stiffness)
    pushed = replanned(planner, plan, [0.2, -0.1, 0.0])
    piece = ((planner.times > NOW) & ((planner.weights > 0).sum(axis=1) == 2)).argmax()
    span, share = planner.times[piece : piece + 2], planner.weights[piece]
    first, last = map(pushed.sample, span)
    places = planner.places + planner.moved
    centres = np.column_stack([places + first.zmp[0] - share @ places, planner.heights])
    cmp = first.moment[0, ::-1] / plan.weight * [1.0, -1.0]
    assert np.abs(cmp).max() > 0.002

    def rate(t, state):
        com, velocity, _ = state.reshape(3, 3)
        forces = plan.mass * planner.w**2 * share[:, None] * (com - centres - np.append(cmp, 0.0))
        fall, turn = np.array([0.0, 0.0, GRAVITY]), np.cross(centres - com, forces).sum(axis=0)
        return np.concatenate([velocity, forces.sum(axis=0) / plan.mass - fall, turn])

    start = np.concatenate([first.com[0], first.com_velocity[0], *first.angular_momentum, [0.0]])
    found = solve_ivp(rate, span, start, rtol=1e-10, atol=1e-12).y[:, -1]
    np.testing.assert_allclose(found[:3], last.com[0], atol=1e-7)
    np.testing.assert_allclose(found[6:8], last.angular_momentum[0], atol=1e-4)


@pytest.mark.parametrize("kind", [Alip, Deadbeat, Lqr, Centroidal, Stiffness])
@pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")  # of OSQP
def test_a_deviation_ends_over_the_moved_footsteps(kind):
    planner, plan = planned(kind)
    times, moves, zmp, moment = planner.deviate(NOW, OFF, np.array([-1.0, 1.5]))
    assert (times[0], times[-1]) == (NOW, plan.duration)
    np.testing.assert_allclose(moves[0, 0], OFF[0], atol=1e-9)
    np.testing.assert_allclose(moves[1, 0], OFF[1], atol=0.02)  # what cannot be bounded is taken from it
    assert np.abs(planner.moved).max() > 0.02
    np.testing.assert_allclose(moves[0, -1], planner.moved[-1], atol=1e-3)
    np.testing.assert_allclose(zmp[-1], planner.moved[-1], atol=1e-6)
    if kind in (Alip, Centroidal, Stiffness):
        np.testing.assert_allclose(np.trapezoid(moment, times, axis=0), [1.0, -1.5], rtol=0.02)
    if kind in (Centroidal, Stiffness):
        assert np.abs(moment).max() <= MOST_MOMENT * 1.01


@pytest.mark.parametrize("name", ["league", "league-quick"])
def test_all_tasks_of_the_human_have_its_body_and_its_controller(name):
    try:
        definition, normal = load_sweep(LEAGUE / f"{name}.toml"), ampm.load_run("normal")
    except ampm.InputError as error:  # the G1 is in a package
        pytest.skip(str(error))
    tasks = {path.name for path in LEAGUE.glob("*.toml")} - {"league.toml", "league-quick.toml"}
    assert set(definition.gaits) - {"normal"} <= tasks
    if name == "league":
        assert set(definition.gaits) == tasks | {"normal"}
    for gait, run in zip(definition.gaits, definition.shared, strict=True):
        if gait != "g1.toml":
            assert run.controller == normal.controller
            assert (run.body.source, run.body.height, run.body.mass) == ("human", 1.7, 60.0)


def test_the_page_shows_the_data():
    league = script("league")
    page, rows = league.PAGE.read_text(encoding="utf-8"), league.read_rows("league")
    for pushed in league.TABLES.values():
        assert league.overview(rows, pushed=pushed).markdown() in page

"""Other libraries at the same work: the set of QPs is the recorded one, and the comparison runs."""

import re
import tomllib

import numpy as np
import pinocchio as pin
import pytest

from benchmarks import cli
from benchmarks.peers import body, compare, dynamics, environments, plans, qpset
from benchmarks.peers.solve import PARTS, time_solver
from validation.cli.options import Status
from validation.progress import Progress
from validation.trial.plan import load_request, plan_walk

EXACT = ("None/cold", "None/warm")


@pytest.fixture(scope="module")
def problems():
    return qpset.load_set()


def some(problems, every):
    """Some of the problems, with both sequences."""
    count = len(problems["q"])
    return {name: a[::every] if len(a) == count else a for name, a in problems.items()}


def test_the_set_is_the_recorded_one(problems, tmp_path):
    again = qpset.record_set(Progress(), gaits=("normal",), ticks=20)
    for name in ("P", "q", "A", "l", "u", "time", "x", "y"):
        np.testing.assert_allclose(again[name], problems[name][:20], rtol=1e-6, atol=1e-9, err_msg=name)
    assert again["weight"] == problems["weight"][0]
    qpset.save_set(tmp_path / "a.npz", again)
    qpset.save_set(tmp_path / "b.npz", again)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_the_set_has_its_documented_form(problems):
    table = qpset.__doc__.partition("every QP:")[2]
    named = re.findall(r"\w+", " ".join(line.strip().partition("  ")[0] for line in table.splitlines()))
    assert sorted(named) == sorted(problems)
    assert qpset.FILE.stat().st_size < 2e6
    rows, gradient, *_ = qpset.accuracy(problems, problems["x"], problems["y"])
    assert max(rows.max(), gradient.max()) < 1e-12
    same = problems["l"] == problems["u"]
    switches = [(same[1:] != same[:-1])[problems["sequence"][1:] == s].any(axis=1).sum() for s in (0, 1)]
    assert min(switches) >= 4
    assert np.linalg.eigvalsh(problems["P"]).min() > 0.1
    half = problems["sequence"] == 1
    assert problems["time"][half][-1] == pytest.approx((qpset.TICKS - 1) / 500.0)


def test_tsid_is_that_of_the_extra():
    project = tomllib.loads((environments.ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert list(environments.PEERS["TSID"].requirements) == project["optional-dependencies"]["tsid"]


def test_errors_are_in_newton_and_metres(problems):
    moved = problems["x"].copy()
    moved[:, 0] += 0.01  # a normal force at the left heel
    _, _, force, zmp = qpset.accuracy(problems, moved, problems["y"])
    np.testing.assert_allclose(force, 0.01 * problems["weight"][problems["sequence"]])
    assert 1e-5 < zmp.min() < zmp.max() < 0.01  # one per cent of the weight, at most a metre away
    assert np.isinf(qpset.accuracy(problems, np.full_like(moved, np.nan), problems["y"]).zmp).all()


@pytest.mark.parametrize("name", ["OSQP", "OSQP, its defaults", "DAQP"])
def test_solvers_find_the_reference_solutions(problems, name):
    few = some(problems, 40)
    found = time_solver(name, few, passes=1)
    assert tuple(found) == EXACT if name == "DAQP" else len(found) == 4
    for mode, result in found.items():
        assert tuple(result) == PARTS
        assert result["solved"].all()
        assert (result["seconds"] > 0.0).all()
        rows, gradient, force, zmp = qpset.accuracy(few, result["x"], result["y"])
        loose = mode.startswith("0.0003")
        assert max(rows.max(), gradient.max()) < (0.02 if loose else 1e-7)
        assert force.max() < (10.0 if loose else 1e-3)
        assert zmp.max() < (1e-3 if loose else 1e-7)


def test_missing_peers_are_listed_with_the_reason(problems, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(environments, "folder", lambda: tmp_path)
    monkeypatch.setattr(environments.importlib.util, "find_spec", lambda module: module == "ampm" or None)
    monkeypatch.setattr(compare, "load_set", lambda: some(problems, 100))
    assert cli.main(["peers", "--only", "solvers", "--no-install"]) == Status.PASS
    shown = capsys.readouterr().out
    assert shown.count("not installed") == len(compare.SOLVERS) - 1
    assert "OSQP, 0.0003" in shown
    monkeypatch.setitem(environments.PEERS, "DAQP", environments.Peer("daqp", ("./no/such/package",)))
    with pytest.raises(environments.MissingPeer, match="cannot be installed"):
        environments.python_of(environments.PEERS["DAQP"], install=True)


def test_the_page_has_one_time_of_every_library_and_the_faster_ones_in_bold(monkeypatch, tmp_path):
    monkeypatch.setattr(compare, "TABLE", tmp_path / "peers.csv")
    monkeypatch.setattr(compare, "DOCUMENT", tmp_path / "page.md")
    compare.DOCUMENT.write_text(f"<!-- {compare.MARK} -->\n\n<!-- end of {compare.MARK} -->\n")
    entries = (
        compare.Entry("ours", "1", "", 2.0, 3.0),
        compare.Entry("other", "2", "", 1.0, 4.0),
        compare.Entry("other, slowly", "2", "", 3.0, 4.0),
        compare.Entry("slow", "3", "", 3.0, 4.0),
        compare.Entry("missing", "", "crashes"),
    )
    section = compare.Section("work", entries)
    assert [row[5] for row in section.rows()] == ["1", "0.5", "1.5", "1.5", ""]
    compare.update_document([section])
    page = compare.DOCUMENT.read_text()
    assert page.count("\n|") == 3
    assert "| work | 2 s | **other 1 s**, slow 3 s |" in page
    assert compare.conditions().partition(",")[0] in page


def test_the_bodys_description_for_others_is_the_same_body():
    walk = plan_walk(load_request("normal", ["gait.steps=2"]))
    robot, given = walk.body.robot, body.references(walk, 0.05)
    model = pin.buildModelFromXML(given["urdf"], pin.JointModelFreeFlyer())
    data, order = model.createData(), [model.joints[model.getJointId(n)].idx_v for n in robot.joint_names]
    q = np.concatenate([given["q"][:7], np.zeros(robot.nu)])
    q[np.array(order) + 1] = given["q"][7:]
    indices = [*range(6), *order]
    own = pin.crba(robot.model, robot.data, given["q"])
    np.testing.assert_allclose(pin.crba(model, data, q)[np.ix_(indices, indices)], own, rtol=0.0, atol=1e-9)
    pin.framesForwardKinematics(model, data, q)
    terms = robot.jacobian(given["q"])
    for foot, name in enumerate(given["soles"]):
        pose = data.oMf[model.getFrameId(str(name))]
        np.testing.assert_allclose(pose.translation, terms.sole[foot], rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(pose.rotation, terms.sole_turn[foot], rtol=0.0, atol=1e-12)
    times = walk.plan.contacts.step_ends[1]
    assert len(given["com"]) == int(times / 0.05)
    states = walk.plan.table(0.05 * np.arange(1, len(given["com"]) + 1)).posture.q
    assert max(body.errors(robot, given, states)) < 1e-6
    assert body.errors(robot, given, states[:1] + np.eye(robot.nq)[:1] * 1e-3)[0] == pytest.approx(
        1e-3, rel=1e-3
    )


def test_plans_of_others_follow_their_zmp(monkeypatch):
    monkeypatch.setattr(plans, "_TIMES", 1)
    monkeypatch.setattr(plans, "PERIODS", (0.1, 0.05))
    found = plans.plans()
    ours, dcm, preview, coarse, fine = found.values()
    assert ours.error == dcm.error == 0.0
    assert max(plan.jump for plan in found.values()) < 1e-12
    assert ours.margin > 0.0
    assert 1e-3 < preview.error < fine.error < coarse.error < 0.1
    assert coarse.margin < fine.margin < 0.0  # only the samples are within the support


def test_the_mpc_keeps_the_zmp_of_its_samples_within_the_support():
    walk = plan_walk(load_request("normal", ["gait.steps=6"]))
    mpc, start = plans.Mpc(walk.plan, 0.05), walk.plan.sample([0.0])
    state = np.stack([start.com[0, :2], start.com_velocity[0, :2], start.com_acceleration[0, :2]])
    states, jerks = mpc.follow(state, 20)
    times = np.linspace(0.05, 0.95, 19)
    zmp = mpc.zmp(states, jerks, times)
    margin = [(edges[:, 2] - edges[:, :2] @ p).min() for edges, p in zip(mpc.edges[1:20], zmp, strict=True)]
    assert min(margin) > -1e-6
    assert np.abs(zmp - mpc.reference[1:20]).max() < 0.03
    assert walk.plan.com_height == pytest.approx(-mpc.output[2] * walk.plan.gravity)


def test_our_accelerations_give_the_commanded_wrench(monkeypatch):
    monkeypatch.setattr(dynamics, "_WALKS", 1)
    robot, ticks = dynamics.record(Progress())
    force, zmp = dynamics.command_errors(robot, ticks, ticks["acceleration"])
    assert force.max() < 1.0
    assert zmp.max() < 2e-3
    pushed = ticks["acceleration"].copy()
    pushed[:, 0] += 0.1  # the whole body, 60 kg
    assert np.median(dynamics.command_errors(robot, ticks, pushed)[0]) == pytest.approx(6.0, rel=0.02)
    corners = ticks["corners"]
    np.testing.assert_allclose(corners[1], corners[0][[1, 0, 3, 2]] * [1, -1, 1], rtol=0.0, atol=1e-9)
    assert 0 < np.count_nonzero(ticks["contact"].all(axis=1)) < len(ticks["q"])


def test_our_inverse_kinematics_is_timed(monkeypatch):
    def missing(*arguments, **named):
        raise environments.MissingPeer("left out")

    monkeypatch.setattr(compare, "work", missing)
    ours, *others = compare.compare_kinematics(False, Progress()).entries
    assert min(ours.warm, ours.p99) > 0.0
    assert {entry.error for entry in others} == {"left out"}

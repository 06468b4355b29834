"""The benchmarks run and say what they measured; no test judges a time."""

import json

import numpy as np
import pytest

from benchmarks import cli, ik_peers, loop, page, qp_peers
from benchmarks.peer import peer_table
from validation.cli.app import call
from validation.cli.options import Status
from validation.progress import Progress
from validation.trial.plan import PlannedWalk, load_request, plan_walk
from validation.trial.simulate import simulate


@pytest.fixture(scope="module")
def planned() -> PlannedWalk:
    return plan_walk(load_request("normal", ["gait.steps=1", "simulation.time_step=0.002"]))


@pytest.mark.slow
def test_loop_and_stages_are_measured_and_put_into_the_page(tmp_path, monkeypatch, capsys):
    copy = tmp_path / "page.md"
    copy.write_text("# Title\n<!-- benchmark -->\n\n<!-- end of benchmark -->\nThe end.\n", encoding="utf-8")
    monkeypatch.setattr(page, "PAGE", copy)
    assert call(["--steps", "1", "--walks", "1", "--json", "--markdown"], cli.app) == Status.PASS
    found = json.loads(capsys.readouterr().out)
    assert [walk["time_step"] for walk in found["loop"]] == [0.002, 0.0005]
    for walk in found["loop"]:
        assert 0.0 < walk["solve"] < walk["tick"] <= walk["tick_p99"]
        assert walk["tick"] < walk["period"]
        assert walk["physics"] < walk["period"]
        assert walk["ending"] == ""
    costs = {cost["name"]: cost["value"] for cost in found["run"]}
    assert {"planning", "simulation", "measurement", "recording", "report", "memory peak"} <= costs.keys()
    assert min(costs.values()) > 0.0
    text = copy.read_text(encoding="utf-8")
    assert text.count("\n| 2 ms |") == 1
    assert found["conditions"] in text
    assert text.endswith("The end.\n")


def test_physics_alone_is_that_of_the_walk(planned, monkeypatch):
    record = simulate(planned)
    stepped, make = [], loop.make_engine

    def noted(model, data, run):
        stepped.append(data)
        return make(model, data, run)

    monkeypatch.setattr(loop, "make_engine", noted)
    assert len(loop.time_physics(record, planned)) == record.steps
    np.testing.assert_array_equal(stepped[-1].qpos, record.q[-1])


def test_solvers_agree_on_the_control_qps(planned):
    problems = qp_peers.record_problems(planned, Progress())[::20]
    ours, *others = qp_peers.compare_solvers(planned, problems, Progress())
    assert ours.name == "ours"
    assert float(ours.error.split()[0]) < 5.0
    assert len(others) == len(qp_peers.SOLVERS)
    for peer in others:
        if not np.isnan(peer.median):
            assert peer.name.startswith("qpsolvers, ")
            assert float(peer.error.split()[0]) < 0.1


def test_a_peer_that_is_not_installed_is_listed_with_the_reason(planned, monkeypatch):
    def missing(*_):
        raise ImportError("No module named 'pink'")

    monkeypatch.setattr(ik_peers, "FOLLOWERS", {"pink": missing})
    ours, pink = ik_peers.compare_kinematics(planned, Progress())
    assert ours.median > 0.0
    *others, missed = peer_table({"work": [ours, pink]}).rows
    assert [row[0] for row in others] == ["work", "ours"]
    assert missed == ("pink", "–", "–", "not measured: No module named 'pink'")

"""Other libraries at the same work: the set of QPs is the recorded one, and the comparison runs."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import cli
from benchmarks.peers import compare, environments, qpset
from benchmarks.peers.solve import PARTS, time_solver
from benchmarks.table import DOCUMENT
from validation.cli.options import Status
from validation.progress import Progress

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
    text = DOCUMENT.read_text(encoding="utf-8")
    assert all(f"`{name}`" in text for name in problems)
    assert qpset.FILE.stat().st_size < 2e6
    rows, gradient, *_ = qpset.accuracy(problems, problems["x"], problems["y"])
    assert max(rows.max(), gradient.max()) < 1e-12
    same = problems["l"] == problems["u"]
    switches = [(same[1:] != same[:-1])[problems["sequence"][1:] == s].any(axis=1).sum() for s in (0, 1)]
    assert min(switches) >= 4
    assert np.linalg.eigvalsh(problems["P"]).min() > 0.1
    half = problems["sequence"] == 1
    assert problems["time"][half][-1] == pytest.approx((qpset.TICKS - 1) / 500.0)


def test_errors_are_in_newton_and_metres(problems):
    moved = problems["x"].copy()
    moved[:, 0] += 0.01  # a normal force at the left heel
    _, _, force, zmp = qpset.accuracy(problems, moved, problems["y"])
    np.testing.assert_allclose(force, 0.01 * problems["weight"][problems["sequence"]])
    assert 1e-5 < zmp.min() < zmp.max() < 0.01  # one per cent of the weight, at most a metre away
    assert np.isinf(qpset.accuracy(problems, np.full_like(moved, np.nan), problems["y"]).zmp).all()


@pytest.mark.parametrize("name", ["ADMM", "OSQP", "OSQP, its defaults", "DAQP"])
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
    assert shown.count("not installed") == len(compare.SOLVERS) - 2
    assert "ADMM, 0.0003" in shown
    monkeypatch.setitem(environments.PEERS, "DAQP", environments.Peer("daqp", ("./no/such/package",)))
    with pytest.raises(environments.MissingPeer, match="cannot be installed"):
        environments.python_of(environments.PEERS["DAQP"], install=True)


def test_the_faster_ones_are_named_with_the_reason():
    ours, other = compare.Entry("ours", "1", "", 2.0, 3.0), compare.Entry("other", "2", "", 1.0, 4.0)
    section = compare.Section("work", (ours, other, compare.Entry("third", "", "crashes")), "It does less.")
    assert section.remark() == "work: faster than ours are other (warm). It does less."
    assert [row[5] for row in section.rows()] == ["1", "0.5", ""]
    assert compare.Section("work", (other, ours), "").remark() == "work: faster than ours are ours (p99). "


def test_an_unknown_task_is_refused(capsys):
    assert cli.main(["peers", "--only", "chess"]) == Status.REFUSED
    assert "chess" in capsys.readouterr().err

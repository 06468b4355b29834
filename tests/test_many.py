"""The engine of many walks: every task once, whatever ends a worker or the program."""

import math
import os
import re
import sys
import time
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np

from ampm.parameters import RunParameters
from validation.cli import console
from validation.progress import Stage
from validation.store.machine import hidden_main
from validation.study.many import Task, walk_many
from validation.study.row_file import RowFile, read_rows

EXAMPLES = Path(__file__).parents[1] / "docs" / "examples"


def square(number: int) -> dict[str, object]:
    return {"outcome": "completed", "square": number**2}


def fail(number: int) -> dict[str, object]:
    if number == 0:
        raise ValueError("no square")
    if number == 1:
        os._exit(0)
    time.sleep(1000.0)
    return {}


def tasks(count: int) -> list[Task]:
    return [Task(str(n), square, {"number": n}) for n in range(count)]


def test_other_options_are_another_run(tmp_path):
    for number in (2, 3):
        rows = walk_many([Task("a", square, {"number": number})], out=tmp_path, resume=True, workers=0)
        assert [row["square"] for row in rows] == [number**2]
    assert len(list(read_rows(tmp_path))) == 2


def test_rows_are_json_for_every_reader(tmp_path):
    task = Task("a", square, known={"metric_height": math.inf, "metric_width": math.nan})
    assert list(walk_many([task], out=tmp_path, workers=0))
    (row,) = read_rows(tmp_path)
    assert (row["metric_height"], row["metric_width"]) == ("inf", None)


def test_bad_runs_are_rows_and_the_others_go_on(tmp_path):
    items = [*(Task(f"bad {n}", fail, {"number": n}) for n in range(3)), *tasks(4)]
    rows = {row["key"]: row for row in walk_many(items, out=tmp_path, workers=2, limit=8.0)}
    assert [rows[f"bad {n}"]["outcome"] for n in range(3)] == ["crashed", "crashed", "timed_out"]
    assert [rows[f"bad {n}"]["reason"] for n in range(3)] == ["ValueError", "worker_died", "wall_clock"]
    assert "test_many.py" in rows["bad 0"]["traceback"]
    assert [rows[str(n)]["square"] for n in range(4)] == [0, 1, 4, 9]
    # What crashed is no result.
    stored = RowFile(tmp_path)
    assert not stored.get("bad 0", items[0].digest)
    assert stored.get("0", items[3].digest)
    stored.close()


def test_a_long_array_decides_on_the_digest():
    one, other = np.zeros(5000), np.zeros(5000)
    other[2500] = 1.0
    digests = [Task("a", square, {"table": {"com_x": values}}).digest for values in (one, one.copy(), other)]
    assert digests[0] == digests[1] != digests[2]


def test_what_a_function_holds_decides_on_the_digest():
    def adder(number: int) -> Any:
        return lambda other: number + other

    for make in (adder, partial(partial, square)):
        assert Task("a", make(1)).digest == Task("a", make(1)).digest != Task("a", make(2)).digest


def test_the_digest_of_a_scripts_function_is_the_same_while_workers_run(tmp_path, monkeypatch):
    script = tmp_path / "script.py"
    script.write_text("def work():\n    from .helper import gain\n    return gain\n")  # it has no package
    main: Any = ModuleType("__main__")
    main.__file__ = str(script)
    exec(script.read_text(), vars(main))
    monkeypatch.setitem(sys.modules, "__main__", main)
    before = Task("a", main.work).digest
    with hidden_main():
        assert Task("a", main.work).digest == before
    script.write_text("def work():\n    return {'outcome': 'completed'}\n")
    assert Task("a", main.work).digest != before


def test_digest_is_of_all_that_decides_on_a_row(tmp_path):
    def digest(**options: object) -> str:
        return Task("a", square, options).digest

    body, model, policy = (tmp_path / name for name in ("biped.toml", "biped.urdf", "policy.onnx"))
    body.write_text((EXAMPLES / "biped.toml").read_text())
    model.write_text((EXAMPLES / "biped.urdf").read_text())
    policy.write_text("1")
    run = RunParameters().replace({"body.source": str(body), "controller.options.file": str(policy)})
    before = digest(run=run)
    for file in (model, body, policy):
        file.write_text(file.read_text() + "\n")
        after = digest(run=run)
        assert before != after
        before = after


def test_a_log_gets_lines_with_the_count_the_time_that_is_left_and_the_note(capsys, monkeypatch):
    monkeypatch.setattr(console, "_LINE_EVERY", -1.0)
    with console.Narrator().stage("walks", "runs") as stage:
        stage.note("90 completed")
        stage.advance(90, 100)  # stored ones say nothing about the speed
        stage.advance(95, 100)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "walks: 90 of 100 runs, 90 completed"
    assert re.fullmatch(r"walks: 95 of 100 runs, about [\d.]+ \w+ left, 90 completed", lines[1])
    assert re.fullmatch(r"walks: \d+\.\d s", lines[2])


def test_a_study_counts_its_tasks():
    seen: list[tuple[int, int]] = []
    stage = Stage(lambda done, total: seen.append((done, total)))
    progress: Any = SimpleNamespace(stage=lambda label, unit: nullcontext(stage))
    assert len(list(walk_many(tasks(3), workers=0, progress=progress))) == 3
    assert seen == sorted(seen)
    assert (seen[0], seen[-1]) == ((0, 3), (3, 3))

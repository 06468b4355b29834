"""Every command says how far it is: by a bar on a terminal, elsewhere by lines."""

import io
import re
import time
from contextlib import nullcontext

import pytest
from rich.console import Console

from tests.test_many import doubling, tasks
from validation.cli import console
from validation.cli.console import Narrator
from validation.progress import Progress, Stage
from validation.study.many import walk_many


@pytest.fixture
def narrator(monkeypatch) -> Narrator:
    """One that writes into a file, and a line every 20 ms."""
    monkeypatch.setattr(console, "_LINE_EVERY", 0.02)
    found = Narrator()
    found.console = Console(file=io.StringIO(), soft_wrap=True)
    return found


def lines(narrator: Narrator) -> list[str]:
    """What it wrote."""
    assert isinstance(narrator.console.file, io.StringIO)
    return narrator.console.file.getvalue().splitlines()


def test_a_log_gets_lines_with_the_count_the_time_that_is_left_and_the_note(narrator):
    with narrator.stage("walks", "runs") as stage:
        stage.advance(90, 100)  # stored ones say nothing about the speed
        stage.note("90 completed")
        time.sleep(0.05)
        stage.advance(95, 100)
        stage.advance(96, 100)  # too soon after the last line
    line, end = lines(narrator)
    assert re.fullmatch(r"walks: 95 of 100 runs, about [\d.]+ \w+ left, 90 completed", line)
    assert re.fullmatch(r"walks: \d+\.\d s", end)


def test_a_failed_stage_has_no_end(narrator):
    with pytest.raises(ValueError, match="nothing"), narrator.stage("walks"):
        raise ValueError("nothing")
    assert lines(narrator) == []


class Counted(Progress, Stage):
    """Keeps what is reported."""

    def __init__(self) -> None:
        self.seen: list[tuple[int, int]] = []

    def stage(self, label, unit=""):
        return nullcontext(self)

    def advance(self, done, total):
        self.seen.append((done, total))


def test_a_study_counts_its_tasks_and_searches():
    progress = Counted()
    rows = list(walk_many([*tasks(2), doubling(1)], workers=0, progress=progress))
    assert len(rows) > 3  # a search has many
    assert progress.seen[0] == (0, 3)
    assert progress.seen[-1] == (3, 3)
    assert progress.seen == sorted(progress.seen)

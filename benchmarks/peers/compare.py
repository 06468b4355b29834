"""What the peers are measured at, and the table of it."""

import csv
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any, Self

import numpy as np

from ampm.geometry import Array
from benchmarks.clock import Samples
from benchmarks.peers.environments import MissingPeer, work
from benchmarks.peers.qpset import accuracy, load_set
from benchmarks.peers.solve import SOLVERS
from benchmarks.table import DOCUMENT
from validation.progress import Progress
from validation.show.text import format_duration, replace_between
from validation.store.environment import describe_environment
from validation.table import Table, print_tables
from validation.trial.plan import load_request, plan_walk

MARK = "peers"
TABLE = DOCUMENT.parent / "data" / "peers.csv"
HEADER = ("library", "version", "cold", "warm", "p99", "times ours", "error")


@dataclass(frozen=True)
class Entry:
    """One library at one task; times are NaN where there is none.

    Attributes:
        name: of the library and its setting.
        version: of the library.
        error: what its answers are wrong by; for a missing peer the reason.
        warm: median, or the time of the only way to call it [s].
        p99: 99th percentile of the same [s].
        cold: median with a new workspace for every call [s].
    """

    name: str
    version: str
    error: str
    warm: float = float("nan")
    p99: float = float("nan")
    cold: float = float("nan")

    @classmethod
    def of(cls, name: str, version: str, error: str, seconds: Samples, cold: float = float("nan")) -> Self:
        """Sum up the times of a library."""
        median, p99 = np.percentile(seconds, [50.0, 99.0]).tolist()
        return cls(name, version, error, median, p99, cold)

    def cells(self, ours: float) -> tuple[str, ...]:
        """The row of the table."""
        times = [format_duration(value) if value > 0.0 else "" for value in (self.cold, self.warm, self.p99)]
        ratio = f"{self.warm / ours:.2g}" if self.warm > 0.0 else ""
        return self.name, self.version, *times, ratio, self.error


@dataclass(frozen=True)
class Section:
    """Entries of one task; the first one is ours.

    Attributes:
        title: the task.
        entries: of all libraries.
    """

    title: str
    entries: tuple[Entry, ...]

    def rows(self) -> list[tuple[str, ...]]:
        """Rows of the table."""
        return [entry.cells(self.entries[0].warm) for entry in self.entries]


def compare(tasks: Sequence[str], *, install: bool, progress: Progress) -> list[Section]:
    """Measure all peers at some of :data:`TASKS`."""
    return [TASKS[task](install, progress) for task in tasks]


def _measured(
    what: str,
    names: Iterable[str],
    script: str,
    arrays: dict[str, Any],
    entries: list[Entry],
    *,
    install: bool,
    progress: Progress,
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Name and answer of every library that can be measured; the others get an entry with the reason."""
    for name in names:
        with progress.stage(f"{what} by {name}"):
            try:
                found = work(script, name, arrays, install=install)
            except MissingPeer as error:
                entries.append(Entry(name, "", str(error)))
                continue
        yield name, found


def compare_solvers(install: bool, progress: Progress) -> Section:
    """QP solvers on the recorded control QPs."""
    problems, entries = load_set(), list[Entry]()
    peers = _measured("QPs", SOLVERS, "solve.py", problems, entries, install=install, progress=progress)
    for name, found in peers:
        for mode in dict.fromkeys(key.split("/")[0] for key in found if "/" in key):
            cold, warm = (found[f"{mode}/{start}/seconds"] for start in ("cold", "warm"))
            x, y, solved = (found[f"{mode}/warm/{part}"] for part in ("x", "y", "solved"))
            rows, gradient, force, zmp = (error.max() for error in accuracy(problems, x, y))
            text = f"{force:.2g} N, {1e3 * zmp:.2g} mm; {rows:.1g}, {gradient:.1g}"
            if not solved.all():
                text += f"; {(~solved).sum()} unsolved"
            title = name if mode == "None" else f"{name}, {float(mode):g}"
            entries.append(Entry.of(title, str(found["version"]), text, warm, float(np.median(cold))))
    return Section(f"{len(problems['q'])} control QPs", tuple(entries))


def compare_plans(install: bool, progress: Progress) -> Section:
    """Plans of COM and ZMP, with the feet; each is made here."""
    # Imported here: each task loads only what it needs.
    from benchmarks.peers.plans import STEPS, plans

    with progress.stage("plans"):
        judged = plans()
    entries = []
    for name, plan in judged.items():
        smooth = "C2" if plan.jump < 1e-9 else f"jumps by {plan.jump:.2g} g"
        text = f"ZMP {1e3 * plan.error:.2g} mm off; {1e3 * plan.margin:.3g} mm within the support; {smooth}"
        entries.append(Entry(name, "", text, min(plan.seconds)))
    return Section(f"plan of {STEPS} steps", tuple(entries))


def compare_kinematics(install: bool, progress: Progress) -> Section:
    """Differential inverse kinematics of one body along one plan."""
    # Imported here: each task loads only what it needs.
    from ampm.body.step_reference import step_grid, step_reference
    from benchmarks.peers.body import errors, references
    from benchmarks.peers.track import FOLLOWERS
    from benchmarks.run import time_ik

    walk = plan_walk(load_request("normal", ["gait.steps=3"]), progress)
    run, robot = walk.run, walk.body.robot
    entries: list[Entry] = []

    def add(name: str, version: str, seconds: Samples, given: dict[str, Any], q: Array) -> None:
        com, sole, turn = (1e3 * error for error in errors(robot, given, q))
        text = f"COM {com:.1g} mm, soles {sole:.1g} mm and {turn:.1g} mrad"
        entries.append(Entry.of(name, version, text, seconds))

    wanted = step_reference(walk.plan, step_grid(walk.plan, run.solver.ik_time_step))
    own = {"com": wanted.position[:, 0], "place": wanted.position[:, 1:], "turn": wanted.rotation}
    with progress.stage("inverse kinematics by ours"):
        seconds, step = time_ik(run, robot, walk.plan, walk.motion)
    add("ours", "", seconds, own, step.q)
    given, what = references(walk, run.solver.ik_time_step), "inverse kinematics"
    peers = _measured(what, FOLLOWERS, "track.py", given, entries, install=install, progress=progress)
    for name, found in peers:
        add(name, str(found["version"]), found["seconds"], given, found["q"])
    return Section("tick of the inverse kinematics", tuple(entries))


def compare_dynamics(install: bool, progress: Progress) -> Section:
    """Inverse dynamics of the recorded ticks of a walk."""
    # Imported here: each task loads only what it needs.
    from benchmarks.peers.dynamics import command_errors, record
    from benchmarks.peers.torques import LIBRARIES

    robot, ticks = record(progress)
    entries, what = list[Entry](), "inverse dynamics"
    peers = _measured(what, LIBRARIES, "torques.py", ticks, entries, install=install, progress=progress)
    for name, found in chain([("ours", ticks)], peers):
        force, zmp = (np.median(error) for error in command_errors(robot, ticks, found["acceleration"]))
        text = f"force {force:.2g} N, ZMP {1e3 * zmp:.2g} mm"
        if name != "ours":
            apart = np.sqrt(np.mean((found["torque"] - ticks["torque"]) ** 2))
            text += f"; torques {apart:.2g} N m from ours"
        entries.append(Entry.of(name, str(found.get("version", "")), text, found["seconds"]))
    return Section(f"inverse dynamics, {len(ticks['q'])} ticks", tuple(entries))


TASKS: dict[str, Callable[[bool, Progress], Section]] = {
    "plans": compare_plans,
    "kinematics": compare_kinematics,
    "dynamics": compare_dynamics,
    "solvers": compare_solvers,
}
"""What is compared, by name."""


def conditions() -> str:
    """One sentence on the machine of the measurement."""
    known = describe_environment()
    processor = f"{known['processor']}, one of {known['cores']} cores"
    return f"{processor}, load {os.getloadavg()[0]:.1f} at the end; Python {known['python']}."


def print_sections(sections: Sequence[Section]) -> None:
    """Print the table on stdout."""
    rows: list[tuple[str, ...]] = []
    for section in sections:
        rows += [(section.title, *[""] * 6), *section.rows()]
    print_tables([Table("peers", ["", "", *(f">{name}" for name in HEADER[2:6]), ""], rows, [conditions()])])


def overview() -> Table:
    """Time of ours and of every library in its first setting, by task; bold what is faster than ours."""
    with TABLE.open(encoding="utf-8", newline="") as file:
        measured = [row for row in csv.DictReader(file) if row["warm"]]
    rows = []
    for task in dict.fromkeys(row["task"] for row in measured):
        first: dict[str, dict[str, str]] = {}
        for row in measured:
            if row["task"] == task:
                first.setdefault(row["library"].partition(",")[0], row)
        (_, ours), *others = first.items()
        rows.append((task, ours["warm"], ", ".join(_time(name, row) for name, row in others)))
    return Table("", ("task", ">ours", "others"), rows)


def _time(name: str, row: Mapping[str, str]) -> str:
    text = f"{name} {row['warm']}"
    return f"**{text}**" if float(row["times ours"]) < 1.0 else text


def update_document(sections: Sequence[Section]) -> None:
    """Replace the data file of the documentation, and the overview on its page."""
    rows = [("task", *HEADER), *((section.title, *row) for section in sections for row in section.rows())]
    with TABLE.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)
    text = f"{overview().markdown()}\n\n{conditions()}"
    page = DOCUMENT.read_text(encoding="utf-8")
    DOCUMENT.write_text(replace_between(page, MARK, f"\n{text}\n"), encoding="utf-8")

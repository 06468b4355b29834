"""The tour: random targets, and a punch in every window of time, for any gait, body and controller.

The protocol is that of a public comparison of policies for the Unitree G1: 18 targets, each uniform in a disc
of 1 m about the one before, with a random heading; 5 s for each, and in them one punch of 0.08 s on a random
segment in a random direction, of half to all of a ceiling that rises from a third to all of 500 N within
60 s. Three things differ. Both feet stand at every target. A way takes the time that its steps need, and the
punches go on to the end. Arms follow the plan; there they move at random.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np

from ampm.brief import Brief
from ampm.exceptions import InputError, RefusedGait
from ampm.parameters import RunParameters
from ampm.planner import routes
from validation.progress import Progress
from validation.store.folders import output_file
from validation.store.json import json_ready, write_json
from validation.study.many import Task, study_folder, walk_many
from validation.study.robustness.study import cause_of
from validation.study.row_file import Row, crash_notes
from validation.study.walk_options import users_classes
from validation.table import Table, Tabled, format_number
from validation.trial.disturbances import Push
from validation.trial.plan import PlannedWalk, Request, complete, load_request, plan_walk
from validation.trial.record import SimulationRecord
from validation.trial.simulate import simulate

TARGETS, RADIUS, WINDOW = 18, 1.0, 5.0
"""Targets; radius of the disc [m]; time between punches [s]."""
CEILING, RISES, LASTS = 500.0, 60.0, 0.08
"""Largest force of a punch [N]; time in which its ceiling rises from a third of it; of a punch [s]."""
LENGTH, ASIDE, TURN, WIDER = 0.7, 0.4, 0.4, 0.12
"""Largest step, as a share of the gait's; aside, as a share of that; turn of a step [rad]; by how much the
feet are wider than the gait's, as a share of its step."""
SHORTER, TRIES = 0.85, 4
"""Share by which length and turn are tried again where a way is refused, and how often."""
RESULT = "tour.json"


@dataclass(frozen=True)
class Tours(Brief, Tabled):
    """Tours of one gait.

    Attributes:
        title: gait, body and controller.
        share: of the protocol's force [1].
        walks: by seed, see :func:`walk_tour`.
    """

    title: str
    share: float
    walks: tuple[Row, ...]

    @property
    def completed(self) -> int:
        """Tours that were walked to the end, and whose legs did not meet."""
        return sum(not walk["cause"] for walk in self.walks)

    @property
    def crashes(self) -> list[str]:
        """Tours that an error of program or machine ended, with its cause; they count as not completed."""
        return crash_notes(self.walks)

    def as_dict(self) -> dict[str, Any]:
        """Everything, as plain values in SI units."""
        return dict(json_ready({**vars(self), "completed": self.completed}))

    def tables(self) -> list[Table]:
        """The one table."""
        return [self.table()]

    def table(self) -> Table:
        """Shares and means over all tours; one that was refused lasted no time and reached no target."""
        lasted = [walk["time"] / walk["planned"] if "time" in walk else 0.0 for walk in self.walks]
        reached = [walk.get("reached", 0) for walk in self.walks]
        errors = [1e3 * walk["error"] for walk in self.walks if walk.get("error") is not None]
        cells = {
            "force [%]": f"{100.0 * self.share:.3g}",
            "completed": f"{self.completed} of {len(self.walks)}",
            "survived [%]": f"{100.0 * fmean(lasted):.1f}",
            "targets": f"{fmean(reached):.1f}",
            "off target [mm]": format_number(fmean(errors) if errors else None, 3),
        }
        return Table(f"Tour of {self.title}", [*cells], [[*cells.values()]], self.crashes)


def targets(seed: int, count: int = TARGETS) -> list[routes.Frame]:
    """Targets of a tour: (x, y) [m], heading [rad]."""
    generator, x, y = np.random.default_rng([seed, 0]), 0.0, 0.0
    found: list[routes.Frame] = []
    for _ in range(count):
        away = RADIUS * math.sqrt(generator.uniform())
        way, heading = (float(angle) for angle in generator.uniform(-math.pi, math.pi, 2))
        x, y = x + away * math.cos(way), y + away * math.sin(way)
        found.append((x, y, heading))
    return found


def punches(seed: int, share: float, segments: Sequence[str], until: float) -> list[Push]:
    """Punches of a tour; their times and directions do not depend on the share.

    Args:
        seed: of the tour.
        share: of the protocol's force [1].
        segments: that are hit.
        until: end of the tour [s].
    """
    generator, found = np.random.default_rng([seed, 1]), []
    for window in range(math.ceil(until / WINDOW) if share else 0):
        at = WINDOW * (window + float(generator.uniform()))
        ceiling = share * CEILING * min((1.0 + 2.0 * at / RISES) / 3.0, 1.0)
        way = generator.standard_normal(3)
        x, y, z = (generator.uniform(0.5, 1.0) * ceiling * way / np.linalg.norm(way)).tolist()
        segment = segments[int(generator.integers(len(segments)))]
        if at < until:
            found.append(Push(segment, (x, y, z), at, LASTS))
    return found


def plan_tour(seed: int, given: Request, count: int, planner: Any = None) -> PlannedWalk:
    """Plan the tour of a seed with the longest steps that the body can walk; see :func:`walk_tour`."""
    run, places = given.run, targets(seed, count)
    step = LENGTH * run.gait.step_length
    width = run.gait.step_width + WIDER * run.gait.step_length
    for share in [SHORTER**attempt for attempt in range(TRIES)]:
        footsteps = routes.visit(places, share * step, width, aside=share * ASIDE * step, turn=share * TURN)
        way = run.replace({}, footsteps=routes.as_rows(footsteps)).as_is()
        try:
            return plan_walk(Request(given.name, way), planner=planner)
        except RefusedGait as refusal:
            last = refusal
    raise last


def walk_tour(seed: int, given: Request, count: int, share: float, **users: Any) -> Row:
    """Walk the tour of a seed.

    Args:
        seed: of targets and punches.
        given: gait, all values found.
        count: of targets.
        share: of the protocol's force [1].
        users: classes of a user, see :func:`validation.study.walk_options.users_classes`.

    Returns:
        ``outcome`` and ``cause``, which is empty for a tour that was completed; ``time`` that it lasted and
        that ``planned`` [s]; ``reached``, targets whose time to stand there came; ``error``, mean distance of
        the feet's middle from them [m], None without one.

    Raises:
        RefusedGait: no way to the targets can be walked.
    """
    planned = plan_tour(seed, given, count, users.get("planner"))
    model, plan = planned.body.model.compile(), planned.plan
    hinged = [model.body(int(i)).name for i in dict.fromkeys(model.jnt_bodyid[1:].tolist())]
    record = simulate(
        plan,
        planned.run,
        planned.body.model,
        controller=users.get("controller"),
        estimator=users.get("estimator"),
        planner=planned.replanner,
        disturbances=punches(seed, share, hinged, float(plan.contacts.step_ends[-1])),
    )
    errors = _errors(planned, record, targets(seed, count))
    cause = cause_of(record, planned.body.model)
    return {
        "seed": seed,
        "outcome": "completed" if not cause else cause.partition(":")[0],
        "cause": cause,
        "time": float(record.outcome.time),
        "planned": float(plan.duration),
        "reached": len(errors),
        "error": fmean(errors) if errors else None,
    }


def _errors(planned: PlannedWalk, record: SimulationRecord, places: Sequence[routes.Frame]) -> list[float]:
    """Distance from every target [m] when both feet are to stand there."""
    found: list[float] = []
    for phase in planned.plan.contacts.phases[1:]:
        if len(found) == len(places) or not (phase.left and phase.right):
            continue
        place = places[len(found)][:2]
        middle = 0.5 * (np.array(phase.left.position) + phase.right.position)
        end = phase.start + phase.duration - 1e-9
        if math.dist(middle[:2], place) < 1e-9 and end <= record.time[-1]:
            feet = record.foot_position[np.searchsorted(record.time, end)]
            found.append(math.dist(feet.mean(axis=0)[:2], place))
    return found


def tour(
    run: RunParameters | str | None = "normal",
    settings: Sequence[str] = (),
    *,
    seeds: int = 100,
    share: float = 1.0,
    count: int = TARGETS,
    workers: int | None = None,
    scheduler: str | None = None,
    out: str | Path | None = None,
    resume: bool = False,
    progress: Progress | None = None,
) -> Tours:
    """Walk the tours of many seeds with a gait, its body and its controller.

    Args:
        run: parameters, preset or TOML file.
        settings: ``key=value`` texts, for a preset or file.
        seeds: tours, of the seeds 0, 1, ...
        share: of the protocol's force, at least 0 [1].
        count: targets of a tour.
        workers: processes; None for one a core, 0 for this very process.
        scheduler: address of a dask scheduler that is running already.
        out: folder of every tour and ``tour.json``; None writes nothing.
        resume: go on with what is in ``out``.
        progress: where to report it.

    Raises:
        InputError, RefusedGait: the request cannot be met, or ``out`` is used otherwise.
        StudyStopped: see :func:`validation.study.many.walk_many`.
    """
    for name, value, least in (("seeds", seeds, 1), ("targets", count, 1), ("punches", share, 0)):
        if not least <= value < math.inf:
            raise InputError(f"--{name} {value}: give a number of at least {least}.", value=value)
    folder = study_folder(out, resume=resume)
    request = complete(load_request(run, settings), progress)
    run = request.run
    options = {"given": request, "count": count, "share": share, **users_classes(run)}
    tasks = [Task(f"seed {seed}", walk_tour, {"seed": seed, **options}) for seed in range(seeds)]
    label = f"{request.name}: tours"
    rows = walk_many(tasks, folder, workers=workers, scheduler=scheduler, label=label, progress=progress)
    walks = {row["key"]: row for row in rows}
    controller = f"controller {run.controller.name} ({run.controller.stabilizer})"
    title = f"{request.title}, body {run.body.source}, {controller}"
    found = Tours(title, share, tuple(walks[task.key] for task in tasks))
    if folder is not None:
        with output_file(folder / RESULT) as file:
            write_json(file, found.as_dict())
    return found

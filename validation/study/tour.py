"""The tour: random targets, and a punch in every window of time, for any gait, body and controller.

The protocol is that of a public comparison of policies for the Unitree G1: 18 targets, each uniform in a disc
of 1 m about the one before, with a random heading; 5 s for each, and in them one punch of 0.08 s on a random
segment in a random direction, of half to all of a ceiling that rises from a third to all of 500 N within
60 s. Its arms move at random. Three things differ. Both feet stand at every target. A way takes the time that
its steps need, and the punches go on to the end. Arms that move at random are moved by the controller, which
knows where they go; there they belong to nobody.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ampm.brief import Brief
from ampm.exceptions import InputError, RefusedGait
from ampm.parameters import RunParameters
from ampm.planner import routes
from ampm.run_file import dump_run
from validation.progress import Progress
from validation.show.text import number
from validation.store.folders import output_file
from validation.store.identity import code_hash
from validation.store.json import json_ready, write_json
from validation.study.resumable import Journal, processes, study_folder, work_off
from validation.trial.plan import Request, complete, load_request, plan_walk

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from ampm.body.robot import Robot
    from ampm.geometry import Array
    from ampm.walk import Posture, PostureState
    from validation.trial.disturbances import Push
    from validation.trial.plan import PlannedWalk
    from validation.trial.record import SimulationRecord

TARGETS, RADIUS, WINDOW = 18, 1.0, 5.0
"""Targets; radius of the disc [m]; time between punches [s]."""
CEILING, RISES, LASTS = 500.0, 60.0, 0.08
"""Largest force of a punch [N]; time in which its ceiling rises from a third of it; of a punch [s]."""
LENGTH, ASIDE, TURN, WIDER = 0.7, 0.4, 0.4, 0.12
"""Largest step, as a share of the gait's; aside, as a share of that; turn of a step [rad]; by how much the
feet are wider than the gait's, as a share of its step."""
SHORTER, TRIES = 0.85, 4
"""Share by which length and turn are tried again where a way is refused, and how often."""
EVERY, WANDER, MOST = 1.0, 0.3, 0.8
"""Time between two random angles of an arm's joint [s]; standard deviation of their difference, and largest
distance from the posture [rad]."""
RESULT, JOURNAL = "tour.json", "tours.jsonl"
HEADER = (
    "force", "completed", "mean survival, of planned [s]", "targets", "error at them [mm], [degrees]",
    "median power [W]", "first sign of most falls",
)  # fmt: skip


@dataclass(frozen=True)
class Walked:
    """One tour.

    Attributes:
        seed: of targets and punches.
        completed: whether it was walked to the end, and the legs did not meet.
        time: that it lasted [s].
        planned: duration of the plan [s]; NaN if it was refused.
        reached: targets whose time to stand there came.
        error: mean distance of the middle of both soles from them at that time [m]; NaN if there is none.
        turned: mean difference of the mean heading of both soles [rad]; NaN likewise.
        power: mean positive power of the motors [W].
        cause: of its end, empty if it completed.
    """

    seed: int
    completed: bool
    time: float
    planned: float = math.nan
    reached: int = 0
    error: float = math.nan
    turned: float = math.nan
    power: float = math.nan
    cause: str = ""


@dataclass(frozen=True)
class Tours(Brief):
    """Tours of one gait.

    Attributes:
        gait, body, controller, stabilizer: their names.
        share: of the protocol's force [1].
        arms: whether they move at random.
        walks: by seed.
    """

    gait: str
    body: str
    controller: str
    stabilizer: str
    share: float
    arms: bool
    walks: tuple[Walked, ...]

    @property
    def title(self) -> str:
        """What was walked."""
        return (
            f"Tour of {self.gait}, body {self.body}, controller {self.controller} ({self.stabilizer})"
            f"{', arms at random' if self.arms else ''}"
        )

    @property
    def completed(self) -> int:
        """Tours that were completed."""
        return sum(walk.completed for walk in self.walks)

    def known(self, name: str) -> list[float]:
        """A number of :class:`Walked`, of the tours that have it."""
        return [value for walk in self.walks if not math.isnan(value := getattr(walk, name))]

    def mean(self, name: str) -> float:
        """Mean of :meth:`known`, NaN if there is none."""
        return float(np.mean(values)) if (values := self.known(name)) else math.nan

    def as_dict(self) -> dict[str, Any]:
        """Everything, as plain values in SI units."""
        means = {name: self.mean(name) for name in ("time", "planned", "reached", "error", "turned", "power")}
        return dict(json_ready({**asdict(self), "completed": self.completed, "mean": means}))

    def row(self) -> tuple[str, ...]:
        """Cells of :data:`HEADER`."""
        ends = Counter(_kind(walk.cause) for walk in self.walks if not walk.completed)
        return (
            f"{self.share:.3g}",
            f"{self.completed} of {len(self.walks)}",
            f"{self.mean('time'):.1f} of {self.mean('planned'):.1f}",
            f"{self.mean('reached'):.1f}",
            f"{number(1e3 * self.mean('error'))}, {number(math.degrees(self.mean('turned')))}",
            number(float(np.median(power)) if (power := self.known("power")) else None),
            "{} ({})".format(*ends.most_common(1)[0]) if ends else number(None),
        )


def _kind(cause: str) -> str:
    """First sign of a failure, without time and numbers."""
    sign = cause.partition("first sign was ")[2] or cause
    return re.sub(r"\d+", "…", sign.partition(" at ")[0].partition(",")[0])


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
    from validation.trial.disturbances import Push  # loads the simulator

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


class RestlessArms:
    """A posture whose arms' angles walk at random, with continuous accelerations.

    Args:
        posture: of all else.
        robot: whose arms; their ranges are kept.
        seed: of the tour.
        until: end of the tour [s].
    """

    def __init__(self, posture: Posture, robot: Robot, seed: int, until: float) -> None:
        self._posture, description = posture, robot.description
        self._rows = np.array(robot.velocity_indices((*description.left_arm, *description.right_arm)))
        self.angular_momentum_y_offset = posture.angular_momentum_y_offset
        rest, hinges = posture.sample(np.full(1, until)).q[0, self._rows + 1], self._rows - 6
        low = np.clip(robot.lower[hinges] - rest, -MOST, 0.0)
        high = np.clip(robot.upper[hinges] - rest, 0.0, MOST)
        moves = np.random.default_rng([seed, 2]).normal(
            0.0, WANDER, (math.ceil(until / EVERY) + 1, len(rest))
        )
        nodes = [np.zeros(len(rest))]
        for move in moves:
            nodes.append(np.clip(nodes[-1] + move, low, high))
        self._nodes = np.array(nodes)

    def sample(self, times: ArrayLike) -> PostureState:
        """States at ``times``, shape (T,) [s]."""
        state = self._posture.sample(times)
        at = np.clip(np.atleast_1d(times) / EVERY, 0.0, len(self._nodes) - 1.001)
        row = at.astype(int)
        u, way = (at - row)[:, None], self._nodes[row + 1] - self._nodes[row]
        q, v, a = state.q.copy(), state.v.copy(), state.acceleration.copy()
        q[:, self._rows + 1] += self._nodes[row] + way * u**3 * (10.0 - 15.0 * u + 6.0 * u * u)
        v[:, self._rows] += way * 30.0 * u * u * (1.0 - u) ** 2 / EVERY
        a[:, self._rows] += way * 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / EVERY**2
        return state._replace(q=q, v=v, acceleration=a)

    def report(self) -> dict[str, Any]:
        """Of the posture."""
        return self._posture.report()


def plan_tour(seed: int, given: Request, count: int) -> PlannedWalk:
    """Plan the tour of a seed with the longest steps that the body can walk.

    Args:
        seed: of its targets.
        given: gait, all values found.
        count: of targets.

    Raises:
        RefusedGait: it cannot walk short ones either.
    """
    run, places = given.run, targets(seed, count)
    step = LENGTH * run.gait.step_length
    width = run.gait.step_width + WIDER * run.gait.step_length
    for attempt in range(TRIES):
        share = SHORTER**attempt
        footsteps = routes.visit(places, share * step, width, aside=share * ASIDE * step, turn=share * TURN)
        try:
            return plan_walk(
                Request(given.name, run.replace({}, footsteps=routes.as_rows(footsteps)).as_is())
            )
        except RefusedGait:
            if attempt == TRIES - 1:
                raise
    raise AssertionError  # pragma: no cover


def walk_tour(seed: int, given: Request, count: int, share: float, *, arms: bool) -> Walked:
    """Walk the tour of a seed.

    Args:
        seed: of targets and punches.
        given: gait, all values found.
        count: of targets.
        share: of the protocol's force [1].
        arms: whether they move at random.
    """
    from validation.judge.margins import energy  # loads the simulator, as do the next ones
    from validation.study.robustness.walks import cause_of
    from validation.trial.simulate import simulate

    try:
        planned = plan_tour(seed, given, count)
    except RefusedGait as refusal:
        return Walked(seed, False, 0.0, cause=f"refused: {refusal}")
    model = planned.body.model.compile()
    hinged = [model.body(int(i)).name for i in dict.fromkeys(model.jnt_bodyid[1:].tolist())]
    plan = planned.plan
    pushes = punches(seed, share, hinged, float(plan.contacts.step_ends[-1]))
    if arms:
        plan = replace(plan, posture=RestlessArms(plan.posture, planned.body.robot, seed, plan.duration))
    record = simulate(plan, planned.run, planned.body.model, disturbances=pushes)
    errors = _errors(planned, record, targets(seed, count))
    error, turned = errors.mean(axis=0).tolist() if len(errors) else (math.nan, math.nan)
    power = energy(record, np.ones(len(record.torque), dtype=bool))["mean_power"]
    cause, time = cause_of(record, planned), record.outcome.time
    return Walked(seed, not cause, time, plan.duration, len(errors), error, turned, power, cause)


def _errors(planned: PlannedWalk, record: SimulationRecord, places: Sequence[routes.Frame]) -> Array:
    """Distance [m] and turn [rad] from every target, as both feet are to stand there, shape (n, 2)."""
    found: list[tuple[float, float]] = []
    for phase in planned.plan.contacts.phases[1:]:
        if len(found) == len(places) or not (phase.left and phase.right):
            continue
        x, y, heading = places[len(found)]
        middle = 0.5 * (np.array(phase.left.position) + phase.right.position)
        end = phase.start + phase.duration - 1e-9
        if math.dist(middle[:2], (x, y)) < 1e-9 and end <= record.time[-1]:
            row = int(np.searchsorted(record.time, end))
            w, i, j, k = record.foot_rotation[row].T
            turn = np.arctan2(2.0 * (w * k + i * j), 1.0 - 2.0 * (j * j + k * k)) - heading
            away = math.dist(record.foot_position[row].mean(axis=0)[:2], (x, y))
            found.append((away, abs(math.atan2(np.sin(turn).sum(), np.cos(turn).sum()))))
    return np.array(found).reshape(-1, 2)


def tour(
    run: RunParameters | str | None = "normal",
    settings: Sequence[str] = (),
    *,
    seeds: int = 100,
    share: float = 1.0,
    count: int = TARGETS,
    arms: bool = False,
    workers: int | None = None,
    scheduler: str | None = None,
    out: str | Path | None = None,
    resume: bool = False,
    force: bool = False,
    progress: Progress | None = None,
    runner: Callable[..., Walked] = walk_tour,
) -> Tours:
    """Walk the tours of many seeds with a gait, its body and its controller.

    Args:
        run: parameters, preset or TOML file.
        settings: ``key=value`` texts, for a preset or file.
        seeds: tours, of the seeds 0, 1, ...
        share: of the protocol's force, at least 0 [1].
        count: targets of a tour.
        arms: whether they move at random.
        workers: processes, None for one a core; one walks in this very process.
        scheduler: address of a dask scheduler that is running already.
        out: folder of results; None writes nothing.
        resume: go on with what is in ``out``.
        force: replace earlier tours there.
        progress: where to report it.
        runner: what walks one tour.

    Raises:
        InputError, RefusedGait: the request cannot be met, or ``out`` holds something else.
    """
    for name, value, least in (("seeds", seeds, 1), ("targets", count, 1), ("punches", share, 0)):
        if not least <= value < math.inf:
            raise InputError(f"--{name} {value}: give a number of at least {least}.", value=value)
    progress = progress or Progress()
    processes(workers)
    target = study_folder(out, (RESULT, JOURNAL), JOURNAL, what="tour", resume=resume, force=force)
    request = complete(load_request(run, settings), progress)
    own = request.run
    identity = {"run": dump_run(own), "share": share, "targets": count, "arms": arms, "code": code_hash()}
    path = None if target is None else target / JOURNAL
    with Journal(path, identity, resume=resume) as journal:
        walks = {row["seed"]: _walked(row) for row in journal.rows}
        waiting = [seed for seed in range(seeds) if seed not in walks]
        walk = partial(runner, given=request, count=count, share=share, arms=arms)
        with progress.stage(f"{request.name}: tours", "tours") as stage:
            stage.advance(seeds - len(waiting), seeds)

            def kept(seed: int, walked: Walked) -> None:
                walks[seed] = walked
                journal.keep(asdict(walked))
                stage.advance(sum(number < seeds for number in walks), seeds)

            work_off(waiting, walk, kept, workers=workers, scheduler=scheduler, report=progress.say)
    found = Tours(
        request.title, own.body.source, own.controller.name, own.controller.stabilizer, share, arms,
        tuple(walks[seed] for seed in range(seeds)),
    )  # fmt: skip
    if target is not None:
        with output_file(target / RESULT, force=True) as file:
            write_json(file, found.as_dict())
    return found


def _walked(row: dict[str, Any]) -> Walked:
    values: dict[str, Any] = {key: math.nan if value is None else value for key, value in row.items()}
    return Walked(**values)

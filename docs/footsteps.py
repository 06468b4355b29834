"""Walk over footsteps again: ``python docs/footsteps.py`` writes docs/data/footsteps.csv.

Every row is one trial from standing to standing. The ZMP error is that of all
instants from the first motion to 2 s after the last one, along and across the mean heading of the feet. Names
of walks as arguments walk only these and print them.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator

import numpy as np
from trials import write_rows

import ampm
import validation as val
from ampm.parameters import RunParameters
from ampm.planner import routes
from ampm.planner.contacts import Footstep
from validation.trial.plan import complete, load_request

COLUMNS = (
    "walk",
    "steps",
    "ZMP RMSE along, across [mm]",
    "maximum [mm]",
    "closest parts [mm]",
    "largest torque",
    "QPs with limits, unsolved",
    "outcome",
)


def walks(length: float, width: float, climb: float) -> dict[str, list[Footstep]]:
    """Footsteps by name, for steps of a length, feet of a width and steps of a length onto others [m]."""
    turn, radius = math.pi / 2.0, 5.0 / 3.0 * length
    around = 1 + math.ceil(math.pi * radius / (2.0 / 3.0 * length))
    found = {
        "straight": routes.straight(10, length, width),
        "arc": routes.arc(around, math.pi * radius / (around - 1), radius, width),
        "turn in place": routes.turn(8, turn, width),
        "sidestep": routes.sidestep(10, length / 3.0, width),
        "backward": routes.straight(8, -length / 2.0, width),
        "slalom": slalom(20, 2.0 / 3.0 * length, 0.4, 8, width),
    }
    for name, height, last in (("up", 0.05, None), ("down", -0.05, None), ("up and down", 0.05, 5)):
        found[f"5 cm {name}"] = routes.platform(8, climb, width, height, last=last)
    for seed in range(3):
        found[f"stones {seed}"] = stones(10, 5.0 / 6.0 * length, width, seed=seed)
    for seed in range(2):
        found[f"tour {seed}"] = tour(50, 5.0 / 6.0 * length, width, seed=seed)
    return found


def slalom(steps: int, length: float, angle: float, period: int, width: float) -> list[Footstep]:
    """A wavy line: the heading swings by ``angle`` [rad] to either side once in ``period`` steps."""
    frames: list[routes.Frame] = [(0.0, 0.0, 0.0)]
    for k in range(1, steps):
        x, y, _ = frames[-1]
        heading = angle * math.sin(2.0 * math.pi * k / period)
        frames.append((x + length * math.cos(heading), y + length * math.sin(heading), heading))
    return routes.route(frames, width, toe_out=routes.TOE_OUT)


def stones(steps: int, length: float, width: float, seed: int) -> list[Footstep]:
    """Uneven steps ahead: lengths and widths [m] differ from their means by up to 25 % and 30 %."""
    generator = np.random.default_rng(seed)
    footsteps = routes.straight(steps, length, width)
    x = 0.0
    for k in range(2, len(footsteps)):
        last = k == len(footsteps) - 1
        x += 0.0 if last else length * (1.0 + 0.25 * generator.uniform(-1.0, 1.0))
        y = 0.5 * width * (1.0 + 0.3 * generator.uniform(-1.0, 1.0))
        foot = footsteps[k].foot
        footsteps[k] = Footstep(foot, (float(x), float(y if foot == "left" else -y), 0.0))
    return footsteps


def tour(steps: int, length: float, width: float, seed: int) -> list[Footstep]:
    """Uneven steps ahead, arcs, turns in place, sidesteps and steps back, in any order.

    Arcs have a radius of two steps. A step in place separates what goes ahead, aside and back.

    Args:
        steps: how many.
        length: mean of the steps ahead [m].
        width: lateral distance of the feet [m].
        seed: of the order, the directions and the lengths.
    """
    generator = np.random.default_rng(seed)
    frames: list[routes.Frame] = [(0.0, 0.0, 0.0)]
    kinds: list[str] = []
    while len(frames) < steps:
        kinds = kinds or list(generator.permutation(["uneven", "arc", "turn", "aside", "back"]))
        kind, way = kinds.pop(), float(generator.choice([-1.0, 1.0]))
        for k in range(int(generator.integers(4, 9))):
            swings = "right" if len(frames) % 2 else "left"  # the foot that this step moves
            ahead = aside = turned = 0.0
            if kind == "uneven":
                ahead = length * (1.0 + 0.25 * generator.uniform(-1.0, 1.0))
            elif kind == "arc":
                ahead, turned = 0.8 * length, 0.4 * way
            elif kind == "turn":
                turned = 0.35 * way
            elif kind == "back":
                ahead = -0.6 * length
            elif swings == ("left" if way > 0.0 else "right"):
                aside = 0.4 * length * way
            if k == 0:
                ahead = aside = turned = 0.0
            x, y, heading = frames[-1]
            middle = heading + 0.5 * turned
            x += ahead * math.cos(middle) - aside * math.sin(middle)
            y += ahead * math.sin(middle) + aside * math.cos(middle)
            frames.append((x, y, heading + turned))
    return routes.route(frames[:steps], width, toe_out=routes.TOE_OUT)


def bodies() -> Iterator[tuple[str, RunParameters, dict[str, list[Footstep]]]]:
    """Title, run and walks of every gait and body."""
    for name in ("normal", "momentum"):
        own = ampm.load_run(name)
        yield name, own, walks(own.gait.step_length, 0.2, 0.4)
    robot = complete(load_request(None, ["body.source='g1'"])).run.as_is()
    yield "g1", robot, walks(robot.gait.step_length, 1.1 * robot.gait.step_width, 0.24)


def main() -> None:
    """Walk everything, or what the arguments name."""
    wanted, rows = sys.argv[1:], []
    for title, run, found in bodies():
        for name, footsteps in found.items():
            if not wanted or name in wanted or f"{title}, {name}" in wanted:
                rows.append(_row(f"{title}, {name}", run, footsteps))
                print(*rows[-1], sep=" | ", flush=True)  # noqa: T201
    if not wanted:
        write_rows("footsteps", [COLUMNS, *rows])


def _row(name: str, run: RunParameters, footsteps: list[Footstep]) -> tuple[str, ...]:
    """Agreement and cost of one walk, or its refusal."""
    try:
        trial = val.walk(run, footsteps=footsteps)
    except ampm.RefusedGait as error:
        return (name, str(len(footsteps) - 2), *["–"] * (len(COLUMNS) - 3), f"refused: {error}")
    sample, margins = trial.comparison.sample, trial.comparison.costs["margins"]
    error, c, s = trial.measured.zmp - sample.zmp, np.cos(sample.heading), np.sin(sample.heading)
    own = 1e3 * np.stack([c * error[:, 0] + s * error[:, 1], c * error[:, 1] - s * error[:, 0]])
    status = np.bincount(trial.record.qp_status.astype(int), minlength=3)
    return (
        name,
        str(len(footsteps) - 2),
        ", ".join(f"{value:.2f}" for value in np.sqrt(np.nanmean(own**2, axis=1))),
        ", ".join(f"{value:.0f}" for value in np.nanmax(np.abs(own), axis=1)),
        f"{1e3 * margins['clearance'].value:.0f}",
        f"{100.0 * margins['torque'].value:.0f} %",
        f"{status[1]}, {status[2]}",
        trial.record.outcome.summary,
    )


if __name__ == "__main__":
    main()

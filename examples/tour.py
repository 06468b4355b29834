"""Walk tours over random targets under random punches. A tour of 18 targets takes 20 s of one core.

    python examples/tour.py normal --seeds 2 --targets 3 --punches 1 --out DIR

The protocol is that of a public comparison of policies for the Unitree G1. There a way takes 5 s, and arms
move at random. Here both feet stand at every target, and a way takes as long as its steps.
"""

import argparse
import itertools
import math
import sys
from statistics import fmean

import numpy as np

import ampm
import validation as val
from ampm.planner import routes
from validation.study.robustness.study import cause_of
from validation.trial.plan import Request, complete, load_request, plan_walk
from validation.trial.simulate import simulate

TARGETS, RADIUS, WINDOW = 18, 1.0, 5.0  # targets; radius of the disc [m]; time between punches [s]
CEILING, RISES = 500.0, 60.0  # largest force of a punch [N]; time until it is reached [s]
LASTS = 0.08  # time of a punch [s]
LENGTH, ASIDE, TURN = 0.7, 0.4, 0.4  # step over the gait's; step aside over that; turn [rad]
WIDER, SHORTER, TRIES = 0.12, 0.85, 4  # more width over the gait's step; shorter steps if refused
INWARD, THERE = 0.2, 1e-9  # step inward over one outward; distance at which a target is reached [m]


def targets(seed, count):
    """Targets of a tour, each uniform in a disc about the one before: (x, y) [m], heading [rad]."""
    generator, x, y, found = np.random.default_rng([seed, 0]), 0.0, 0.0, []
    for _ in range(count):
        away = RADIUS * math.sqrt(generator.uniform())
        way, heading = generator.uniform(-math.pi, math.pi, 2).tolist()
        x, y = x + away * math.cos(way), y + away * math.sin(way)
        found.append((x, y, heading))
    return found


def visit(places, length, width, aside, turn):
    """Footsteps to one target after the other, at each of which both feet stand beside each other.

    As few as the limits allow: every step goes ahead [m], outward [m] and turns [rad] as far as it may; all
    steps of a way, the first or the last ones share the turn.
    """
    frames = [(0.0, 0.0, 0.0)]
    for place in places:
        frames += [*way_to(place, frames[-1], len(frames), length, aside, turn), place, place]
    return routes.route(frames, width, toe_out=routes.TOE_OUT)


def way_to(place, start, number, length, outward, most):
    """Fewest frames (x, y, heading) to a target; the left foot steps to those of even number."""
    angle = math.remainder(place[2] - start[2], 2.0 * math.pi)
    for count in itertools.count(1):
        for first, last in [*((0, k) for k in range(count, 0, -1)), *((k, count) for k in range(1, count))]:
            frames, turn = [start], angle / (last - first)
            for step in range(count if abs(turn) <= most else 0):
                (x, y, heading), left = frames[-1], (number + step) % 2 == 0
                c, s = math.cos(heading), math.sin(heading)
                ahead = c * (place[0] - x) + s * (place[1] - y)
                aside = c * (place[1] - y) - s * (place[0] - x)
                reach = outward if left == (aside > 0.0) else INWARD * outward
                ahead, aside = min(max(ahead, -length), length), min(max(aside, -reach), reach)
                heading += turn if first <= step < last else 0.0
                frames.append((x + c * ahead - s * aside, y + s * ahead + c * aside, heading))
            if math.dist(frames[-1][:2], place[:2]) < THERE and len(frames) > count:
                return frames[1:-1]


def hinged(model):
    """Names of the segments that a hinge moves."""
    return [model.body(k).name for k in dict.fromkeys(model.jnt_bodyid[1:].tolist())]


def punches(seed, share, segments, until):
    """Punches, one in every window up to a time [s], of half to all of a ceiling that rises."""
    generator, found = np.random.default_rng([seed, 1]), []
    for window in range(math.ceil(until / WINDOW) if share else 0):
        at = WINDOW * (window + float(generator.uniform()))
        ceiling = share * CEILING * min((1.0 + 2.0 * at / RISES) / 3.0, 1.0)
        way = generator.standard_normal(3)
        force = (generator.uniform(0.5, 1.0) * ceiling * way / np.linalg.norm(way)).tolist()
        if at < until:
            found.append(val.Push(segments[generator.integers(len(segments))], tuple(force), at, LASTS))
    return found


def plan_tour(request, places):
    """Plan the way to all places with the longest steps that the body can walk."""
    step = LENGTH * request.run.gait.step_length
    width = request.run.gait.step_width + WIDER * request.run.gait.step_length
    for share in [SHORTER**attempt for attempt in range(TRIES)]:
        footsteps = visit(places, share * step, width, share * ASIDE * step, share * TURN)
        run = request.run.replace({}, footsteps=footsteps).as_is()
        try:
            return plan_walk(Request(request.name, run))
        except ampm.RefusedGait as refusal:
            last = refusal
    raise last


def distances(places, plan, record):
    """Distances of the feet's middle from the targets that were reached [m], at the end of each stand."""
    found, waiting = [], list(places)
    for phase in plan.contacts.phases[1:]:
        if waiting and phase.left and phase.right:
            middle = 0.5 * (np.array(phase.left.position) + phase.right.position)
            end = phase.start + phase.duration - 1e-9
            if math.dist(middle[:2], waiting[0][:2]) < 1e-9 and end <= record.time[-1]:
                feet = record.foot_position[np.searchsorted(record.time, end)].mean(axis=0)
                found.append(math.dist(feet[:2], waiting.pop(0)[:2]))
    return found


def walk_tour(seed, request, count, share):
    """Walk the tour of a seed: how it ended, mean error [m], times [s]."""
    places = targets(seed, count)
    planned = plan_tour(request, places)
    plan, body = planned.plan, planned.body.model
    pushes = punches(seed, share, hinged(body.compile()), until=float(plan.contacts.step_ends[-1]))
    record = simulate(planned, disturbances=pushes)
    off, cause = distances(places, plan, record), cause_of(record, body)  # no cause: completed
    row = {"seed": seed, "outcome": cause.partition(":")[0] or "completed", "cause": cause}
    row |= {"reached": len(off), "error": fmean(off) if off else None}
    return row | {"time": float(record.outcome.time), "planned": float(plan.duration)}


def walk_tours(gait, settings, seeds, count, share, workers=None, out=None, resume=False):
    """Walk the tours of seeds 0, 1, ... and return their rows, which a folder keeps."""
    request = complete(load_request(gait, settings))
    options = {"request": request, "count": count, "share": share}
    tasks = [val.Task(f"seed {seed}", walk_tour, {"seed": seed, **options}) for seed in range(seeds)]
    rows = {}
    for row in val.walk_many(tasks, workers=workers, out=out, resume=resume):
        rows[row["key"]] = row
        print(f"{row['key']}: {row['cause'] or 'completed'}, {row.get('reached', 0)} targets", flush=True)
    return [rows[task.key] for task in tasks]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("gait", nargs="?", help="preset or TOML file; by default the own gait of the body")
    parser.add_argument("--set", dest="settings", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--seeds", type=int, default=100, help="tours, of the seeds 0, 1, ...")
    parser.add_argument("--targets", dest="count", type=int, default=TARGETS)
    parser.add_argument("--punches", dest="share", type=float, default=1.0, help="1 for up to 500 N")
    parser.add_argument("--workers", type=int, help="processes; by default one a core")
    parser.add_argument("--out", metavar="DIR", help="keep every tour")
    parser.add_argument("--resume", action="store_true", help="go on with the tours of the folder")
    given = parser.parse_args()
    if given.seeds < 1 or given.count < 2 or not 0.0 <= given.share <= 100.0:
        parser.error("--seeds of 1 or more, --targets of 2 or more, --punches of 0 to 100")
    try:
        walks = walk_tours(**vars(given))
    except ampm.AmpmError as error:
        sys.exit(f"tour.py: {error}")
    print(f"{sum(not walk['cause'] for walk in walks)} of {len(walks)} completed")

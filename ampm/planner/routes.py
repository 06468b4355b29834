"""Lists of footsteps: generators of common walks, and files.

Every generator returns where both feet stand at first, then where each lands, left and right in turn; at the
end the feet stand beside each other. It begins at the origin, facing +x.
"""

import csv
import io
import math
from collections.abc import Callable, Sequence
from pathlib import Path

from ampm.exceptions import InputError, RefusedGait
from ampm.files import check_columns, read_text, separator
from ampm.parameters import FootstepParameters, RunParameters
from ampm.planner.contacts import Footstep, Side
from ampm.section import parse_setting

Frame = tuple[float, float, float]
"""Middle between two feet that stand beside each other, and their heading: (x, y) [m], [rad]."""
_MOST_TRIED = 40  # footsteps of a walk that is tried with smaller ones: each takes 40 ms
TOE_OUT = 0.1
"""Angle by which the feet of the turning walks are turned out, so that the legs pass each other [rad]."""


def route(
    frames: Sequence[Frame], width: float, first: Side = "right", *, toe_out: float = 0.0
) -> list[Footstep]:
    """Footsteps through frames, one of each, then the other foot beside the last one.

    Args:
        frames: the first one is where both feet stand; then one for every step.
        width: lateral distance of the feet [m].
        first: foot that swings first.
        toe_out: angle by which either foot is turned out [rad].
    """
    if not frames:
        raise InputError("a route of no steps is not a walk; give 2 steps or more.")
    other: Side = "left" if first == "right" else "right"
    feet = [first, other, *([first, other] * len(frames))]
    visited = [frames[0], frames[0], *frames[1:], frames[-1]]
    return [_beside(frame, foot, width, toe_out) for frame, foot in zip(visited, feet, strict=False)]


def _beside(frame: Frame, foot: Side, width: float, toe_out: float) -> Footstep:
    x, y, heading = frame
    aside = 0.5 * width if foot == "left" else -0.5 * width
    place = x - aside * math.sin(heading), y + aside * math.cos(heading), 0.0
    return Footstep(foot, place, heading + (toe_out if foot == "left" else -toe_out))


def straight(steps: int, length: float, width: float) -> list[Footstep]:
    """Equal steps ahead; backward with a negative length [m]."""
    return route([(k * length, 0.0, 0.0) for k in range(steps)], width)


def arc(
    steps: int, length: float, radius: float, width: float, *, toe_out: float = TOE_OUT
) -> list[Footstep]:
    """Equal steps along a circle, to the left; with a negative radius [m] to the right."""
    if not radius:
        raise InputError("the radius of an arc must not be 0 m; use turn for a turn in place.")
    turns = [k * length / radius for k in range(steps)]
    frames = [(radius * math.sin(turn), radius * (1.0 - math.cos(turn)), turn) for turn in turns]
    return route(frames, width, "left" if radius > 0.0 else "right", toe_out=toe_out)


def turn(steps: int, angle: float, width: float, *, toe_out: float = TOE_OUT) -> list[Footstep]:
    """A turn in place by an angle, to the left if it is positive [rad]."""
    frames = [(0.0, 0.0, angle * k / max(steps - 1, 1)) for k in range(steps)]
    return route(frames, width, "left" if angle > 0.0 else "right", toe_out=toe_out)


def platform(
    steps: int, length: float, width: float, height: float, *, first: int = 3, last: int | None = None
) -> list[Footstep]:
    """Equal steps ahead, some of them on a platform.

    Args:
        steps: how many.
        length: of a step [m].
        width: lateral distance of the feet [m].
        height: of the platform; negative: the floor is lower there [m].
        first: first step on it.
        last: last step on it; the walk's own by default.
    """
    footsteps, last = straight(steps, length, width), steps if last is None else last
    return [
        step._replace(position=(*step.position[:2], height if first <= number <= last else 0.0))
        for number, step in enumerate(footsteps, start=-1)
    ]


def sidestep(steps: int, length: float, width: float) -> list[Footstep]:
    """Steps to the left, to the right with a negative length [m]: one foot goes, the other one follows."""
    frames = [(0.0, ((k + 1) // 2) * length, 0.0) for k in range(steps)]
    return route(frames, width, "left" if length > 0.0 else "right")


def eased(footsteps: Sequence[Footstep | FootstepParameters], share: float, width: float) -> list[Footstep]:
    """The same walk with smaller steps, at the same times.

    Args:
        footsteps: two on which the feet stand, then where each lands; those of a run are fine.
        share: of the lengths, turns and heights that is kept [1].
        width: towards which the lateral distance of the feet goes, as far as a step's length towards 0 [m].
    """
    steps = [step if isinstance(step, Footstep) else of_row(step) for step in footsteps]
    found = steps[:1]
    for number, step in enumerate(steps[1:], start=1):
        last, new, foot = steps[number - 1], found[-1], math.copysign(1.0, (step.foot == "left") - 0.5)
        heading = step.heading
        if number > 1:  # from the same foot, as toes may be turned out
            heading = found[number - 2].heading + share * (heading - steps[number - 2].heading)
        before, after = 0.5 * (last.heading + step.heading), 0.5 * (new.heading + heading)
        x, y, z = (there - here for there, here in zip(step.position, last.position, strict=True))
        ahead = share * (math.cos(before) * x + math.sin(before) * y)
        aside = foot * width + share * (math.cos(before) * y - math.sin(before) * x - foot * width)
        x = new.position[0] + math.cos(after) * ahead - math.sin(after) * aside
        y = new.position[1] + math.sin(after) * ahead + math.cos(after) * aside
        found.append(step._replace(position=(x, y, new.position[2] + share * z), heading=heading))
    return found


def easier(run: RunParameters, plan: Callable[[RunParameters], object]) -> str:
    """Words on an easier walk than a refused one, which ``plan`` accepts; empty without one, or with many."""
    footsteps, width = [*map(of_row, run.footsteps)], run.gait.step_width

    def accepted(footsteps: Sequence[Footstep]) -> bool:
        try:
            plan(run.replace({}, footsteps=footsteps))
        except (RefusedGait, InputError):
            return False
        return True

    if len(footsteps) > _MOST_TRIED:
        return ""
    free = [step._replace(time=None) for step in footsteps]
    if free != footsteps and accepted(free):
        return "leave out their times"
    stand = {step.foot: step.heading for step in footsteps[:2]}
    toe_out = 0.5 * math.remainder(stand["left"] - stand["right"], math.tau)
    turned = {"left": -toe_out, "right": toe_out}
    ahead = [step._replace(heading=step.heading + turned[step.foot]) for step in footsteps]
    if toe_out and accepted(ahead):
        return f"turn the toes of either foot {'in' if toe_out > 0.0 else 'out'} by {abs(toe_out):.3g} rad"
    shares = (0.875, 0.75, 0.625, 0.5, 0.25)
    share = next((share for share in shares if accepted(eased(footsteps, share, width))), 0.0)
    kept = "keeps that share of lengths, turns and heights"
    return f"ampm.planner.routes.eased(run.footsteps, {share:g}, {width:.3g}) {kept}" if share else ""


def of_row(row: FootstepParameters) -> Footstep:
    """The footstep of a row of a run."""
    return Footstep(row.foot, (row.x, row.y, row.z), row.heading, row.time)


def read_footsteps(path: str | Path) -> list[Footstep]:
    """Footsteps from a CSV file whose columns are the keys of ``[[footsteps]]``; cells may be empty.

    Commas, semicolons or tabs part the columns, the latter two with decimal commas, too. Raises
    :class:`InputError` if the file cannot be read, or a row is not a footstep.
    """
    try:
        text = read_text(Path(path))
        between = separator(text)
        lines = io.StringIO(text if between == "," else text.replace(",", "."), newline="")
        table = csv.DictReader(lines, skipinitialspace=True, delimiter=between)
        table.fieldnames = names = [name.strip() for name in table.fieldnames or ()]
        check_columns(names, Path(path))
        found = [(table.line_num, row) for row in table if any(row.values())]
    except csv.Error as error:
        raise InputError(f"the file {str(path)!r} cannot be read ({error}); give a CSV file.") from None
    needed = [name for name, field in FootstepParameters.model_fields.items() if field.is_required()]
    if missing := [name for name in needed if names and name not in names]:
        known = f"it has {', '.join(names)}; footsteps need {', '.join(needed)}; --planner walks a plan"
        raise InputError(f"{path} has no column {missing[0]!r}; {known}.")
    footsteps = []
    for line, cells in found:
        if more := cells.pop(None, []):
            raise InputError(
                f"{path}, line {line} has {len(names) + len(more)} cells and the header {len(names)}; "
                "name all columns, for example foot,x,y,heading,time."
            )
        settings = [f"{name}={cell or ''}" for name, cell in cells.items() if cell or name in needed]
        try:
            row = dict(map(parse_setting, settings))
            footsteps.append(of_row(FootstepParameters(**row)))
        except InputError as error:
            raise InputError(f"{path}, line {line}: {error}", **error.details) from None
    if not footsteps:
        raise InputError(f"{path} holds no footsteps; a walk takes at least 3.")
    return footsteps

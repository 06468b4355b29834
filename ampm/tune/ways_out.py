"""A way out of a refusal: a change of a gait with which a search has accepted it.

Every change goes towards :func:`ampm.tune.first_gait.easy_gait`, with steps at its cadence, or leaves open
values that are given.
"""

import math
from collections.abc import Callable, Iterator, Mapping

from ampm.description import BodyDescription
from ampm.exceptions import InputError
from ampm.parameters import HUMAN, OPEN_KEYS, RunParameters
from ampm.run_file import key_info
from ampm.tune.first_gait import easy_gait

Change = Mapping[str, float | None]
"""Values by key; None leaves a key open."""

_MOST_NAMED = 4  # other settings in a message
_MOST_OF_ONE = 40  # choices of one search, which also takes at most half of those that are left
_MOST_OF_LAST = 100  # choices of the search for an easy gait: what it says of the body must hold
_OF_A_GAIT = ("gait.", "foot.", "body.", "controller.friction")  # sections with what it may fail by
_NEAR = 0.1  # distance from the easy gait's value below which it is no change [1]


def ways_out(
    run: RunParameters,
    description: BodyDescription,
    accepts: Callable[[RunParameters, int], tuple[bool, int]],
    choices: int,
) -> str:
    """A change with which a refused gait is accepted, in words.

    It is a change of one value; where no single one is enough, of all values. Half of it is told if it is
    accepted, too.

    Args:
        run: the refused request.
        description: of the body.
        accepts: whether a run is accepted, by a search of so many choices at most, and how many it tried.
        choices: that all searches may try together.
    """

    def accepted(change: Change, most: int = _MOST_OF_ONE) -> bool:
        nonlocal choices
        most = most if most > _MOST_OF_ONE else min(most, choices // 2)
        if most < 1:
            return False
        try:
            changed = _changed(run, change)
        except InputError:  # beyond the range of a key
            return False
        answer, tried = accepts(changed, most)
        choices -= tried
        return answer

    found = next(filter(accepted, _single_changes(run, description)), None)
    if found is None:
        easy = {key: _rounded(value) for key, value in easy_gait(run, description).items()}
        found = {**easy, **_opened(run)}
        if not accepted(found, _MOST_OF_LAST):
            values = ", ".join(f"{key} = {value:.3g}" for key, value in easy.items())
            given = run.given - set(OPEN_KEYS) - easy.keys() - {"gait.steps", "body.source"}
            others = sorted(key for key in given if key.startswith(_OF_A_GAIT))[:_MOST_NAMED]
            if run.body.source != HUMAN:
                others.append("the body's description")
            way_out = f"change {', '.join(others)}, or take" if others else "take"
            return f"not even a gait with {values} was accepted; {way_out} another body"
    closed = {key: value for key, value in found.items() if value is not None}
    half = {**found, **{key: _rounded(0.5 * (run.value(key) + value)) for key, value in closed.items()}}
    return f"{_in_words(run, half if closed and accepted(half) else found)} (tried and accepted)"


def _single_changes(run: RunParameters, description: BodyDescription) -> Iterator[Change]:
    """Given values left open, and one value at a time of an easier gait, the largest changes first."""
    if opened := _opened(run):
        yield opened
    easy, gait = easy_gait(run, description), run.gait
    usual_step = easy["gait.step_length"]
    cadence = easy["gait.switching_velocity"] / usual_step
    step_length = min(max(gait.switching_velocity / cadence, usual_step), 2.0 * usual_step)
    speed = cadence * gait.step_length
    changes = {
        "gait.switching_velocity": (speed, abs(math.log(speed / gait.switching_velocity))),
        "gait.step_length": (step_length, abs(math.log(step_length / gait.step_length))),
        "gait.c_s": (easy["gait.c_s"], 2.0 * abs(gait.c_s - easy["gait.c_s"])),
        "gait.c_y": (easy["gait.c_y"], abs(gait.c_y - easy["gait.c_y"])),
    }
    for key, (value, distance) in sorted(changes.items(), key=lambda item: -item[1][1]):
        if distance > _NEAR:
            yield {key: _rounded(value)}


def _opened(run: RunParameters) -> Change:
    """The change that leaves open what could be open and is given."""
    return {key: None for key in OPEN_KEYS if key in run.given}


def _changed(run: RunParameters, change: Change) -> RunParameters:
    """A run as with these settings."""
    opened = {key for key, value in change.items() if value is None}
    values = {key: key_info(key).default if key in opened else value for key, value in change.items()}
    run = run.replace(values)
    return run.giving(run.given - opened)


def _in_words(run: RunParameters, change: Change) -> str:
    """A change as advice."""
    words, opened = [], " and ".join(key for key, value in change.items() if value is None)
    # Values that are only rounded are told where there is no other change.
    news = {key: value for key, value in change.items() if value is None or value != _rounded(run.value(key))}
    for key, value in (news or change).items():
        if value is not None and value != run.value(key):
            verb, unit = "raise" if value > run.value(key) else "lower", key_info(key).unit
            words.append(f"{verb} {key} to {value:g}" + ("" if unit == "1" else f" {unit}"))
    return " and ".join([*words, f"leave {opened} open"] if opened else words)


def _rounded(value: float) -> float:
    """A value as it is told."""
    return float(f"{value:.3g}")

"""A convergence study: walks of a gait, their verdict, and files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ampm.exceptions import InputError
from ampm.parameters import steps_per_tick
from validation.judge import profiles
from validation.judge.uncertainty import FILE
from validation.progress import Progress
from validation.store.folders import check_target, output_file
from validation.store.json import write_json
from validation.study.convergence.result import Convergence, combine
from validation.study.convergence.studies import LEVELS, studies
from validation.study.convergence.text import markdown
from validation.study.convergence.walks import Runner, walk_level, walk_levels
from validation.trial.plan import load_request, plan_walk

STEPS = 6
"""Walked at every level, by default: the gait is periodic, and a record grows as the time step shrinks."""
MARKDOWN = "convergence.md"
PICTURES = ("convergence.svg", "convergence.png")
FILES = (FILE, MARKDOWN, *PICTURES)


def study_gait(
    gait: str | None,
    settings: Sequence[str] = (),
    *,
    as_is: bool = False,
    steps: int = STEPS,
    levels: int = LEVELS,
    only: Sequence[str] = (),
    profile: str = "default",
    workers: int | None = None,
    out: Path | None = None,
    force: bool = False,
    progress: Progress | None = None,
    runner: Runner = walk_level,
) -> Convergence:
    """Study one gait; nothing is written.

    Args:
        gait: preset or TOML file.
        settings: ``key=value`` texts.
        as_is: find nothing that the gait leaves open.
        steps: walked at every level.
        levels: of every numerical study.
        only: studies, all by default.
        profile: name of the tolerance profile.
        workers: processes, None for one a core.
        out: folder that :func:`write` will fill, None for none; it is checked before the first walk.
        force: replace an earlier study there.
        progress: where to report it.
        runner: what walks one level.

    Raises:
        InputError, RefusedGait: the request cannot be met.
    """
    if steps < 2:
        raise InputError(f"--steps {steps}: the first step is in no metric; walk 2 at least.", value=steps)
    if workers is not None and workers < 1:
        raise InputError(f"--workers {workers}: at least one process has to walk.", value=workers)
    limits = profiles.profile(profile)
    if out is not None:
        check_target(out, FILES, force=force, what="convergence study")
    request = load_request(gait, [*settings, f"gait.steps={steps}"], as_is=as_is)
    found = studies(request.run, only, levels=levels)
    # Halving the time step does not correct a control period that is no multiple of it.
    steps_per_tick(request.run.controller.frequency, request.run.simulation.time_step)
    if runner is walk_level:  # refuse before any worker starts
        request = plan_walk(request, progress).request
        found = studies(request.run, only, levels=levels)  # of the values that were found
    runs = [request.run, *(run for study in found for run in study.runs)]
    walks = walk_levels(runs, request.name, workers=workers, progress=progress, runner=runner)
    return combine(request, limits, found, walks)


def write(result: Convergence, out: Path) -> None:
    """Write table, pictures and, last, ``convergence.json``, which marks a complete study."""
    from validation.study.convergence.picture import draw  # imported here because matplotlib is slow to load

    (out / FILE).unlink(missing_ok=True)
    with output_file(out / MARKDOWN) as path:
        path.write_text(markdown(result), encoding="utf-8")
    for name in PICTURES:
        draw(result, out / name)
    with output_file(out / FILE) as path:
        write_json(path, result.as_dict())

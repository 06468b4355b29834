"""The trial of one gait, kept in a folder.

The files that are hardest to replace are written first: parameters and environment before the walk, the
record as soon as it ends, then signals and summary, last the pictures, which can be drawn again.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ampm.exceptions import InputError
from validation.judge.profiles import Profile
from validation.judge.uncertainty import Uncertainty
from validation.progress import Progress, interruption
from validation.run.trial import draw_run, write_inputs, write_results
from validation.run.walk import walk_planned
from validation.store.folders import check_run_folder, new_folder, run_folder
from validation.store.record import save_record
from validation.store.saved import read_summary
from validation.trial.disturbances import Disturbance
from validation.trial.files import RunFile
from validation.trial.outcome import OutcomeName
from validation.trial.plan import Request, plan_walk
from validation.trial.record import SimulationRecord


def targets(requests: Sequence[Request], out: Path | None, *, force: bool) -> list[Path]:
    """Folder of every run, all of them checked before anything runs.

    ``out`` itself for one gait, a folder of each gait's name in it for several; without it
    ``runs/<gait>-<time>``. Raises :class:`InputError` if a folder must not be written.
    """
    if out is None:
        folders = [new_folder(item.name) for item in requests]
    elif len(requests) == 1:
        folders = [out]
    else:
        if (out / RunFile.RUN).exists():
            raise InputError(f"{out} is itself the folder of a run; give another folder.")
        folders = [out / item.name for item in requests]
    for folder in folders:
        check_run_folder(folder, force=force)
    return folders


def validate(
    request: Request,
    target: Path,
    profile: Profile | None = None,
    *,
    force: bool = False,
    uncertainty: Uncertainty | None = None,
    disturbances: Sequence[Disturbance] = (),
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Plan, walk, measure and judge one gait, and keep everything in a folder.

    A walk that is interrupted (``KeyboardInterrupt``) is measured and kept up to that time. An interruption
    after the walk leaves out recording and report only; ``interruption.pending`` is then set. Arguments are
    those of :func:`validation.walk` and of :meth:`validation.run.trial.Trial.save`.

    Returns:
        The contents of ``summary.json``.

    Raises:
        InputError, MathematicalRefusal, BodilyRefusal: the request cannot be met; nothing is written.
        OSError: the disk is full.
    """
    planned = plan_walk(request, progress)
    with run_folder(target, force=force) as folder:
        write_inputs(folder, planned)

        def keep(record: SimulationRecord) -> None:
            if record.outcome.name == OutcomeName.INTERRUPTED:
                interruption.acknowledge()
            else:
                interruption.holding = True
            save_record(record, folder)

        try:
            trial = walk_planned(planned, profile, disturbances=disturbances, progress=progress, keep=keep)
            summary = write_results(folder, replace(trial, uncertainty=uncertainty))
            del trial  # drawing needs the memory
        finally:
            interruption.holding = False
    if interruption.pending:
        return summary
    try:
        draw_run(target, request.name, progress)
        summary["files"] = read_summary(target)["files"]  # with the digest of the recording
        interruption.check()
    except (Exception, KeyboardInterrupt) as error:
        error.add_note(f"the run itself is complete in {target}, and 'ampm report' draws it again")
        if not interruption.pending:  # else the command line tells the verdict first
            raise
    return summary

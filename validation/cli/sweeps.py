"""Commands on many runs: ``ampm sweep``, and those that work with what it leaves."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from validation.cli.console import Narrator, print_json
from validation.cli.options import Debug, Force, Json, Status

SWEEP_EPILOG = (
    "Exit status: 0 every run that walked passed, 1 some are out of tolerance, 2 bad input, or every run was "
    "refused, 3 some did not complete, 4 some crashed, 5 stopped from outside (full disk, lost scheduler): "
    "--resume goes on, 130 interrupted: --resume goes on. --dry-run: 0, or 2 if it is sure that every run is "
    "refused."
)


DIFF_EPILOG = "Exit status: 0 no regression beyond tolerance, 1 some, 2 bad input."


def sweep(
    file: Annotated[Path, typer.Argument(help="Definition of the sweep (TOML).", metavar="FILE")],
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Folder of the sweep; only --dry-run needs none."),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option("--workers", metavar="N", help="Processes on this machine; one per core by default."),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(
            "--scheduler",
            metavar="ADDRESS",
            help="Run on this dask scheduler: tcp://HOST:8786, or its --scheduler-file.",
        ),
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with what is missing in --out.")] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Count runs and refusals; walk one run to time it.")
    ] = False,
    retry: Annotated[
        str | None,
        typer.Option(
            "--retry",
            metavar="OUTCOME,...",
            help="With --resume: also walk again what crashed, timed_out, fell, ...: --retry crashed.",
        ),
    ] = None,
    force: Annotated[
        bool,
        typer.Option("--force", help="With --resume: go on although code or versions have changed since."),
    ] = False,
    as_json: Json = False,
    debug: Debug = False,
) -> int:
    """Walk many runs, headless, on all cores or a cluster; keep every result, whatever happens.

    FILE says which runs: grids, lists, Latin hypercubes or Sobol points over any parameter. Every finished
    run is on the disk at once; after a kill, a full disk or Ctrl-C, --resume walks exactly what is missing,
    and the table is the same to the bit.
    """
    from validation.study.sweep import command, opening

    if dry_run:
        from validation.cli.forecast import dry_run as forecast  # loads all that measures

        return forecast(file, workers, as_json=as_json)
    options = opening.Options(
        out=out,
        workers=workers,
        scheduler=scheduler,
        resume=resume,
        force=force,
        retry=opening.retried(retry),
    )
    return Status(command.run(file, options, as_json=as_json, narrator=Narrator()))


CONVERGENCE_EPILOG = (
    "Exit status: 0 every metric is within its limit by more than its numerical uncertainty, 1 one is over "
    "it, undecided or not measured, 2 bad input or refused, 3 a walk of a numerical study did not complete, "
    "4 crash of ampm itself, 130 interrupted."
)


def convergence(
    gait: Annotated[str, typer.Argument(help="Preset or TOML file.", metavar="[GAIT]")] = "normal",
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="KEY=VALUE", help="Change one parameter, e.g. gait.c_s=1.2; repeatable."
        ),
    ] = None,
    steps: Annotated[
        int, typer.Option("--steps", metavar="N", help="Walked at every level: the gait is periodic.")
    ] = 6,
    levels: Annotated[
        int,
        typer.Option(
            "--levels", metavar="N", help="Of every numerical study, 3 ... 6; 4 can confirm an order."
        ),
    ] = 4,
    only: Annotated[
        list[str] | None,
        typer.Option(
            "--study",
            metavar="NAME",
            help="time_step, ik_grid, qp_tolerance, contact_stiffness or contact_depth; repeatable, all by "
            "default.",
        ),
    ] = None,
    profile: Annotated[
        str, typer.Option("--profile", metavar="P", help="Tolerance profile: default, strict, or wide.")
    ] = "default",
    workers: Annotated[
        int | None, typer.Option("--workers", metavar="N", help="Processes; one per core by default.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Write convergence.json, a table and a picture."),
    ] = None,
    force: Force = False,
    as_json: Json = False,
    debug: Debug = False,
) -> int:
    """Say how far a gait's figures depend on time step, grids, tolerances and contact parameters.

    The time step is halved again and again, at the same control frequency; so is the grid of the inverse
    kinematics; the QP's tolerance is tightened; contact stiffness is varied. Every metric gets its observed
    order, extrapolated value and numerical uncertainty, or "no asymptotic range"; 'ampm validate
    --uncertainty' quotes the uncertainty in its verdict.
    """
    from validation.study.convergence import command
    from validation.study.convergence.table import print_convergence

    options = command.Options(
        steps=steps, levels=levels, only=only or (), profile=profile, workers=workers, out=out, force=force
    )
    narrator = Narrator()
    result = command.run(gait, settings or (), options, stages=narrator)
    if as_json:
        print_json(result.as_dict())
    else:
        print_convergence(result)
    if out is not None:
        narrator.say(f"wrote {', '.join(str(out / name) for name in command.FILES)}")
    if not result.completed:
        return Status.NOT_COMPLETED
    return Status.PASS if result.verdict == "pass" else Status.OUT_OF_TOLERANCE


def diff(
    a: Annotated[Path, typer.Argument(help="Sweep that is the reference: folder or table.", metavar="A")],
    b: Annotated[Path, typer.Argument(help="Sweep that is compared with it.", metavar="B")],
    tolerance: Annotated[
        list[str] | None,
        typer.Option(
            "--tolerance",
            metavar="SHARE|METRIC=SHARE",
            help="By which share of its limit a figure may grow (0.1 if not given); repeatable.",
        ),
    ] = None,
    uncertainty: Annotated[
        Path | None,
        typer.Option(
            "--uncertainty",
            metavar="convergence.json",
            help="Numerical uncertainty of the figures: no smaller difference is called one.",
        ),
    ] = None,
    require_all: Annotated[
        bool, typer.Option("--require-all", help="Runs of A that B lacks are regressions, too.")
    ] = False,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE.html", help="Write the comparison as a page.")
    ] = None,
    force: Force = False,
    as_json: Json = False,
    debug: Debug = False,
) -> int:
    """Compare two sweeps run by run: better, worse, newly failing, newly passing, missing.

    Runs are matched by their parameters, whatever the revision. A difference below the noise is none: runs
    repeat to the bit on one machine, so the noise is that of floating point, or of a convergence study.
    """
    from validation.store.folders import check_output_file
    from validation.study.sweep import diff_text
    from validation.study.sweep.diff import compare_sweeps

    if out is not None:
        diff_text.check_page(out)
        check_output_file(out, force=force)
    found = compare_sweeps(a, b, tolerances=tolerance or (), uncertainty=uncertainty, require_all=require_all)
    if out is not None:
        diff_text.write_page(found, out, force=force)
    if as_json:
        print_json(diff_text.describe_diff(found))
    else:
        diff_text.print_diff(found)
    if out is not None:
        Narrator().say(f"wrote {out}")
    return Status.OUT_OF_TOLERANCE if found.regressions else Status.PASS


def register(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    app.command(epilog=SWEEP_EPILOG)(sweep)
    app.command(epilog=DIFF_EPILOG)(diff)
    app.command(epilog=CONVERGENCE_EPILOG)(convergence)

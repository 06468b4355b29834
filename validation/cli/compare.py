"""``ampm compare``: gaits, finished runs, or two sweeps."""

from dataclasses import dataclass
from pathlib import Path

import typer

from ampm.exceptions import InputError
from validation.cli import options
from validation.cli.console import Narrator
from validation.cli.options import Status, grouped, option
from validation.store.folders import names_folder

app = typer.Typer()

_ONCE = "Once for all walks, or once for each."


@dataclass(frozen=True)
class Each:
    """What is given once for all walks, or once for each; studies of the walks."""

    planner: list[str] | None = option("--planner", _ONCE, "NAME|FILE.csv|.parquet|MODULE:CLASS")
    body: list[str] | None = option("--body", _ONCE, "NAME|FILE.toml")
    controller: list[str] | None = option("--controller", _ONCE, "NAME|MODULE:CLASS")
    engine: list[str] | None = option("--engine", _ONCE, "mujoco|drake")
    uncertainty: list[Path] | None = options.UNCERTAINTY
    robustness: list[Path] | None = option(
        "--robustness", "robustness.json of a walk, from 'ampm robustness'; once for each.", "FILE"
    )


@app.command(
    rich_help_panel=options.WALK,
    epilog="Exit status: 0 all walked to the end, or no regression; 1 a regression of a sweep, 3 a walk did "
    f"not complete; {options.EXITS}",
)
@grouped
def compare(
    walks: list[str] | None = typer.Argument(
        None,
        help="Presets, TOML files, folders of runs (./normal is a folder, normal the preset), or two sweeps; "
        "normal if none. One gait alone is walked once for each value of a repeated option; with one "
        "--planner, --controller or --engine it is compared with its walk without them, else with ipm.",
        metavar="WALK",
    ),
    *,
    settings: list[str] | None = options.SETTINGS,
    as_is: bool = options.AS_IS,
    steps: int | None = options.STEPS,
    each: Each,
    execution: options.Running,
) -> int:
    """Compare gaits, finished runs, or two sweeps.

    Gaits are walked, sweeps compared run by run. The first line is the conclusion: who tracks the ZMP best,
    at which cost, and how near to the limits. Options of a planner or controller follow its name after a
    comma: --planner "mine:Planner,gain=2". Of two sweeps the first is the reference: runs are matched by
    their parameters, and the exit status tells a regression.
    """
    from validation.study.compare.comparison import WalkComparison, compare_gaits, compare_runs
    from validation.study.compare.report import write_comparison
    from validation.study.compare.sweeps import SweepComparison, compare_sweeps
    from validation.study.many import study_folder
    from validation.study.sweep.table import is_sweep

    folder = study_folder({"out": execution.out, "resume": execution.resume})
    choices = {key: values for name, key in options.SHORT.items() if (values := vars(each).get(name))}
    walks, studies, survived = walks or [], each.uncertainty or (), each.robustness or ()
    done = [text for text in walks if names_folder(text)]
    sweeps = [text for text in done if is_sweep(Path(text))]
    if done and (len(done) < len(walks) or len(done) < 2 or settings or choices or steps or as_is):
        other = "".join(f", and {text} does not" for text in walks if text not in done)
        raise InputError(
            f"{done[0]} names a folder of results{other}; give two such folders or more, without gaits and "
            "their options ('ampm validate --out DIR' keeps the run of a gait)."
        )
    found: WalkComparison | SweepComparison
    if sweeps:
        if len({Path(text).resolve() for text in sweeps}) != 2 or sweeps != walks or studies or survived:
            raise InputError(f"{sweeps[0]} is a sweep; compare it with one other sweep, without studies.")
        found = compare_sweeps(*sweeps)
        status = Status.OUT_OF_TOLERANCE if found.counts else Status.PASS
    else:
        if done:
            found = compare_runs(done, uncertainty=studies, robustness=survived)
        else:
            settings = options.with_short(settings, steps=steps)
            for key, values in choices.items():  # refuses a key that is set, too
                for value in values:
                    options.with_short([*settings, f"{key}={value}"])
            found = compare_gaits(
                walks,
                settings,
                choices=choices,
                as_is=as_is,
                uncertainty=studies,
                robustness=survived,
                **execution.given(),
            )
        completed = all(side.outcome == "completed" for side in found.sides)
        status = Status.PASS if completed else Status.NOT_COMPLETED
    if folder is not None:
        write_comparison(found, folder)
    execution.answer(found)
    if folder is None:
        Narrator().say("nothing is kept; --out DIR keeps a page with curves, the numbers and the runs")
    return status

"""Command line of ``python -m benchmarks``."""

import os
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

import typer

from validation.cli.console import Narrator, print_json
from validation.cli.options import Status, option
from validation.table import Table, print_tables

if TYPE_CHECKING:
    from validation.trial.plan import Request

_TIME_STEPS = (0.002, 0.0005)  # of the physics in the closed loop [s]
app = typer.Typer(
    name="python -m benchmarks",
    pretty_exceptions_enable=False,
    add_completion=False,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.command()
def benchmark(
    gait: str = option("--gait", "Preset or TOML file of a periodic gait.", "GAIT", default="normal"),
    settings: list[str] | None = option("--set", "Change one parameter; repeatable.", "KEY=VALUE"),
    steps: int = option("--steps", "Walking steps of every walk.", least=1, default=30),
    walks: int = option("--walks", "Equal walks; of each part the least time counts.", least=1, default=3),
    peers: bool = option("--peers", "Compare with other libraries instead."),
    as_json: bool = option("--json", "Print JSON instead of tables."),
    markdown: bool = option("--markdown", "Put the tables into docs/benchmarks.md as well."),
) -> int:
    """Time the stages of a run, and its closed loop beside the bare physics.

    The loop is timed at time steps of 2 ms and 0.5 ms; simulation.time_step holds for the stages only.
    Another controller is timed by --set controller.name=module:Class. The work is the same every time and
    on one thread. The default takes about two minutes.
    """
    # Imported here so that '--help' loads neither simulator nor Pinocchio.
    from benchmarks.page import conditions, write_page
    from validation.trial.plan import load_request

    load, narrator = os.getloadavg()[0], Narrator()
    request = load_request(gait, [*(settings or ()), f"gait.steps={steps}"])
    if peers:
        tables, results = _compare(request, narrator)
    else:
        tables, results = _time(request, walks, narrator)
    note = conditions(f"{request.title}, {steps} steps", load)
    if as_json:
        print_json({**results, "conditions": note})
    else:
        print_tables([*tables, Table("", (), (), [note])])
    if markdown:
        texts = [table.markdown() for table in tables]
        write_page("peers" if peers else "benchmark", "\n\n".join(texts if peers else [*texts, note]))
        narrator.say("wrote docs/benchmarks.md")
    return Status.PASS


def _time(request: "Request", walks: int, narrator: Narrator) -> tuple[list[Table], dict[str, Any]]:
    """Tables and values of the closed loop and the stages of a run."""
    from benchmarks.loop import loop_table, time_loop
    from benchmarks.stages import cost_table, time_run
    from validation.trial.plan import plan_walk

    costs = time_run(request, walks, narrator)  # first, for the memory's peak is that of the process
    loops = []
    for time_step in _TIME_STEPS:
        changed = request.run.replace({"simulation.time_step": time_step})
        loops.append(time_loop(plan_walk(replace(request, run=changed)), walks, narrator))
    results = {"loop": [asdict(walk) for walk in loops], "run": [cost._asdict() for cost in costs]}
    return [loop_table(loops), cost_table(costs)], results


def _compare(request: "Request", narrator: Narrator) -> tuple[list[Table], dict[str, Any]]:
    """Table and values of other libraries at the same work."""
    from benchmarks.ik_peers import compare_kinematics
    from benchmarks.peer import peer_table
    from benchmarks.qp_peers import compare_solvers, record_problems
    from validation.trial.plan import plan_walk

    planned = plan_walk(request)
    problems = record_problems(planned, narrator)
    sections = {
        f"{len(problems)} control QPs, error of a point's normal force": compare_solvers(
            planned, problems, narrator
        ),
        "tick of the inverse kinematics": compare_kinematics(planned, narrator),
    }
    return [peer_table(sections)], {task: list(map(asdict, found)) for task, found in sections.items()}

"""Walking all levels of all studies, side by side."""

from __future__ import annotations

import multiprocessing
from collections.abc import Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from typing import TYPE_CHECKING

from validation.progress import Progress
from validation.store.machine import one_blas_thread
from validation.study.convergence.studies import Figures, Runner, Study, walk_level

if TYPE_CHECKING:
    from ampm.parameters import RunParameters
    from validation.judge.profiles import Profile

Level = tuple[str, float]
"""Key and value; the run's own parameters are ``("", 0.0)``."""
OWN: Level = ("", 0.0)


def level(study: Study, index: int) -> Level:
    """Which walk a level of a study is: all studies share the one at the run's own parameters."""
    return OWN if index == study.own else (study.topic.key, study.values[index])


def runs_of(run: RunParameters, found: Sequence[Study]) -> dict[Level, RunParameters]:
    """Every walk that the studies need, once, the costliest first."""
    runs = {OWN: run}
    for study in found:
        for index, value in enumerate(study.values):
            if index != study.own:
                runs[level(study, index)] = run.replace({study.topic.key: value})
    # The finest steps last longest: begun first, they leave no worker idle at the end.
    return dict(sorted(runs.items(), key=lambda item: _cost(item[1]), reverse=True))


def _cost(run: RunParameters) -> float:
    return 1.0 / run.simulation.time_step + 1.0 / run.solver.ik_time_step


def walk_levels(
    runs: Mapping[Level, RunParameters],
    name: str,
    profile: Profile,
    *,
    workers: int = 2,
    stages: Progress | None = None,
    runner: Runner = walk_level,
) -> dict[Level, Figures]:
    """Walk every level.

    Args:
        runs: level to its complete parameters.
        name: of the gait.
        profile: of the tolerances.
        workers: processes; one walks in this very process.
        stages: where to report progress.
        runner: what walks one level; with more than one worker, it must be importable.
    """
    done: dict[Level, Figures] = {}
    with (stages or Progress()).stage(f"{name}: convergence", "walks") as stage:
        if workers == 1:
            for key, run in runs.items():
                done[key] = runner(run, name, profile)
                stage.advance(len(done), len(runs))
            return done
        one_blas_thread()
        # Workers are started afresh: a fork would share the state of compiled libraries.
        context = multiprocessing.get_context("spawn")
        others = set(multiprocessing.active_children())
        with ProcessPoolExecutor(max_workers=min(workers, len(runs)), mp_context=context) as pool:
            asked = {pool.submit(runner, run, name, profile): key for key, run in runs.items()}
            pending = set(asked)
            try:
                while pending:
                    finished, pending = wait(pending, return_when=FIRST_COMPLETED)
                    for future in finished:
                        done[asked[future]] = future.result()
                    stage.advance(len(done), len(runs))
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                for worker in set(multiprocessing.active_children()) - others:
                    worker.terminate()  # a level under way is of no use to anybody
                raise
    return done

"""Shared by all tests: no display, and real runs that are simulated once and read by whoever needs them."""

import fcntl
import hashlib
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

os.environ.setdefault("MUJOCO_GL", "disable")
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest

RunOf = Callable[..., Path]


def pytest_configure(config: pytest.Config) -> None:
    """Compile what a walk needs before parallel workers start, so that no two of them compile the same."""
    if getattr(config.option, "numprocesses", None) and not hasattr(config, "workerinput"):
        from ampm.compiled import folder
        from ampm.run_file import load_run
        from validation.run.walk import compile_once, walk  # loads simulator and controller

        is_new = not (folder() / "complete").exists()
        compile_once()
        if is_new:  # the estimator, too, which several files of tests use
            sensed = {"estimator": "kalman", "force_sensor": "wrench"}
            walk(load_run("normal", gait={"steps": 1}, sensors=sensed))


@pytest.fixture(scope="session")
def run_of(tmp_path_factory: pytest.TempPathFactory) -> RunOf:
    """See :func:`run_in`, in one folder for all workers of a parallel test session."""
    base = tmp_path_factory.getbasetemp()
    if os.environ.get("PYTEST_XDIST_WORKER"):
        base = base.parent  # each worker has its own below it
    folder = base / "shared-runs"
    folder.mkdir(exist_ok=True)
    return run_in(folder)


def run_in(shared_folder: Path) -> RunOf:
    """Folder of a real run, simulated by the first test that asks for it; nothing is tuned."""

    def get(
        gait: str = "normal",
        settings: dict[str, object] | None = None,
        *,
        steps: int = 8,
        footsteps: list[Any] | None = None,
    ) -> Path:
        from validation.run.walk import walk_planned
        from validation.trial.plan import load_request, plan_walk

        changed = [f"{key}={value}" for key, value in {**(settings or {}), "gait.steps": steps}.items()]
        sections = {"footsteps": footsteps} if footsteps else {}
        words = json.dumps([gait, changed, sections])
        name = f"{gait}-{steps}-{hashlib.sha256(words.encode()).hexdigest()[:8]}"
        target = shared_folder / name
        with (shared_folder / f"{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)  # two workers do not simulate the same run
            if not (target / "summary.json").is_file():
                shutil.rmtree(target, ignore_errors=True)
                request = load_request(gait, changed, as_is=True, sections=sections)
                walk_planned(plan_walk(request), "default").save(target, recording=False)
        return target

    return get


class Answer(NamedTuple):
    """What a command line gave back."""

    status: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        return json.loads(self.out)


@pytest.fixture
def ampm(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Callable[..., Answer]:
    """Run a command line in this process, as if all functions had been compiled before."""
    # Here, not above: that would load typer and numba for every test.
    from ampm.compiled import compilation
    from validation.cli.app import call

    monkeypatch.setattr(compilation, "_announced", True)

    def run(*arguments: object) -> Answer:
        capsys.readouterr()
        return Answer(call([str(argument) for argument in arguments]), *capsys.readouterr())

    return run

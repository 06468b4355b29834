"""pytest plugin: walks as fixtures, their verdicts as assertions, their recordings with failures.

    def test_my_controller(walked, assert_within):
        walked("momentum", controller=MyController, gait={"steps": 10})
        assert_within("default")

A walk is made once in a session for equal inputs, also by the workers of pytest-xdist. The runs of a failed
test are saved with their recordings. Importing this module loads nothing but pytest.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import pickle
import re
import tempfile
import warnings
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any
from uuid import uuid4

import pytest

if TYPE_CHECKING:
    from ampm.parameters import RunParameters
    from ampm.walk import ControllerFactory, Planner
    from validation.judge.profiles import Profile
    from validation.judge.verdict import MetricResult
    from validation.run.trial import Trial
    from validation.trial.disturbances import Disturbance

BASELINES = "ampm_baselines"
"""Folder beside a test's file that holds its baselines."""
_SESSION = "AMPM_PYTEST_SESSION"  # environment variable: folder of the session's walks, also for its workers
_PROPERTY = "ampm baseline"
_WALKED, _PLACE = pytest.StashKey[list["Trial"]](), pytest.StashKey[Path]()


# ------------------------------------------------------------------------------------------- hooks


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options."""
    group = parser.getgroup("ampm", "walks of the AMPM testbed")
    group.addoption(
        "--ampm-update", action="store_true", help="write the baselines of walks, and show what changed"
    )
    group.addoption(
        "--ampm-runs",
        metavar="DIR",
        type=Path,
        help="folder for runs of failed tests; a temporary one if not given",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Make the folder of the session's walks."""
    if hasattr(config, "workerinput"):  # of pytest-xdist, which has it from the session
        return
    folder = tempfile.TemporaryDirectory(prefix="ampm-pytest-")
    outer = os.environ.get(_SESSION)
    os.environ[_SESSION] = folder.name

    def end() -> None:
        folder.cleanup()
        os.environ.pop(_SESSION)
        if outer is not None:
            os.environ[_SESSION] = outer

    config.add_cleanup(end)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Save the walks of a failed test, and show where."""
    report = yield
    trials = item.stash.get(_WALKED, [])
    if report.failed and trials:
        report.sections.append(("AMPM runs", "\n".join(_saved(item, trials))))
        trials.clear()  # a failure of the teardown needs no second copy
    return report


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Show the baselines that were written."""
    reports = [report for group in terminalreporter.stats.values() for report in group]
    texts = [
        text
        for report in reports
        if getattr(report, "when", "") == "call"
        for name, text in report.user_properties
        if name == _PROPERTY
    ]
    if texts:
        terminalreporter.section("AMPM baselines")
        for text in texts:
            terminalreporter.write_line(text)


# ---------------------------------------------------------------------------------------- fixtures


@pytest.fixture
def walked(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Trial]:
    """``walked(gait, body=..., controller=..., ...)``: a trial, see :func:`walk_once`."""
    trials = request.node.stash.setdefault(_WALKED, [])
    given = request.config.getoption("--ampm-runs")
    request.node.stash[_PLACE] = given or tmp_path_factory.getbasetemp() / "ampm-runs"

    def walk(source: RunParameters | str | None = None, /, **inputs: Any) -> Trial:
        if isinstance(source, str) and (beside := request.path.parent / source).is_file():
            source = str(beside)
        trials.append(walk_once(source, **inputs))
        return trials[-1]

    return walk


@pytest.fixture
def assert_within(request: pytest.FixtureRequest) -> Callable[..., None]:
    """``assert_within(profile, *trials)``: every tolerance is met; by default by all that the test walked.

    Without a profile the preset's own counts.
    """

    def check(profile: Profile | str | None = None, *trials: Trial) -> None:
        __tracebackhide__ = True
        # Imported here: loads NumPy.
        from validation.judge.profiles import Profile
        from validation.judge.profiles import profile as find_profile
        from validation.judge.verdict import judge

        wrong = []
        for trial in trials or _walks_of(request):
            verdict = trial.verdict
            if profile is not None:
                found = profile if isinstance(profile, Profile) else find_profile(profile)
                ended = trial.record.outcome.ending
                verdict = judge(trial.metrics, found, trial.comparison.scales, trial.uncertainty, ended=ended)
            if not verdict.passed:
                wrong.append(
                    f"{_title(trial)}: {verdict.name.replace('_', ' ')} ({verdict.profile}). {verdict.reason}"
                )
                wrong += [f"    {item.label}: {item.against}" for item in verdict.failed]
        if wrong:
            pytest.fail("\n".join(wrong), pytrace=False)

    return check


@pytest.fixture
def assert_baseline(request: pytest.FixtureRequest) -> Callable[..., None]:
    """``assert_baseline(*trials)``: no judged metric is worse than in the baseline.

    ``--ampm-update`` writes it. A metric may grow by a tenth of its limit, as in ``ampm compare`` of sweeps.
    """

    def check(*trials: Trial) -> None:
        __tracebackhide__ = True
        wrong = []
        for number, trial in enumerate(trials or _walks_of(request)):
            path = _baseline_path(request, number)
            before = _earlier(path)
            now = _baseline(trial)
            if request.config.getoption("--ampm-update"):
                lines = _differences(before, trial)[1] if before else ["new"]
                if before is None or lines:
                    path.parent.mkdir(exist_ok=True)
                    path.write_text(json.dumps(now, indent=2) + "\n", encoding="utf-8")
                    text = "\n  ".join([f"{path}: {_title(trial)}", *lines])
                    request.node.user_properties.append((_PROPERTY, text))
            elif before is None:
                wrong.append(
                    f"{_title(trial)}: there is no whole baseline {path}; write it with --ampm-update."
                )
            else:
                worse, lines = _differences(before, trial)
                if worse:
                    title = f"{_title(trial)}: worse than {path}; if that is meant, --ampm-update."
                    wrong += [title, *(f"    {line}" for line in lines)]
        if wrong:
            pytest.fail("\n".join(wrong), pytrace=False)

    return check


def _earlier(path: Path) -> dict[str, Any] | None:
    """A baseline; None if there is none or it is damaged."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        return found if {"outcome", "steps_completed", "metrics"} <= found.keys() else None
    except (OSError, ValueError, AttributeError):
        return None


# ------------------------------------------------------------------------------------ walks of a session


def walk_once(
    source: RunParameters | str | None = None,
    /,
    *,
    body: Mapping[str, Any] | str | None = None,
    controller: ControllerFactory | str | None = None,
    planner: Planner | str | None = None,
    disturbances: Sequence[Disturbance] = (),
    **sections: Mapping[str, Any],
) -> Trial:
    """Walk, unless a walk of equal inputs was made in this session.

    Args:
        source: parameters, or a preset or TOML file; `normal` by default, or the own gait of another body.
        body: its name (``body.source``), or values of the section ``body``.
        controller: class or name, as :func:`validation.walk` takes it.
        planner: likewise.
        disturbances: likewise.
        sections: values by section and key, as :func:`ampm.load_run` takes them.

    Raises:
        InputError, MathematicalRefusal, BodilyRefusal: there is no such walk, or a user's class fails.
    """
    # Imported here: they load simulator, controller and NumPy.
    import cloudpickle

    from validation.run.walk import walk
    from validation.store.identity import parameter_values
    from validation.trial.plan import load_request

    request = load_request(source, body=body, sections=sections)
    options: dict[str, Any] = {
        "controller": controller,
        "planner": planner,
        "disturbances": list(disturbances),
    }
    try:
        inputs = cloudpickle.dumps(options)
    except (
        TypeError,
        AttributeError,
        pickle.PicklingError,
    ):  # a class that holds a file or a library's handle
        inputs = uuid4().bytes
    run, name = request.run, request.name
    text = json.dumps([name, parameter_values(run), sorted(run.given)])
    path = Path(os.environ[_SESSION]) / hashlib.sha256(text.encode() + inputs).hexdigest()[:16]
    with _locked(path.with_suffix(".lock")):
        if path.is_file():
            return pickle.loads(path.read_bytes())
        trial = walk(run, name=name, **options)
        with suppress(TypeError, AttributeError, pickle.PicklingError):  # of a user's own posture or plan
            part = path.with_suffix(".part")
            part.write_bytes(cloudpickle.dumps(trial))
            part.rename(path)  # a process may be killed while it writes
        return trial


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Lock, so that two processes do not walk the same."""
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _walks_of(request: pytest.FixtureRequest) -> list[Trial]:
    __tracebackhide__ = True
    found = request.node.stash.get(_WALKED, [])
    if not found:
        pytest.fail("this test walked nothing; call walked() first, or give the trials.", pytrace=False)
    return list(found)


def _title(trial: Trial) -> str:
    controller = trial.planned.run.controller.name
    return trial.planned.request.title + (f" with {controller}" if controller != "ampm" else "")


def _saved(item: pytest.Item, trials: Sequence[Trial]) -> Iterator[str]:
    """Save the walks of a failed test; a line on each."""
    for number, trial in enumerate(trials):
        folder = item.stash[_PLACE] / _plain(item.nodeid) / f"{number}-{trial.planned.name}"
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of libraries that draw
                trial.save(folder, force=True)
            yield f"{_title(trial)}: {trial.record.outcome.summary}; ampm view {folder}"
        except Exception as error:  # the test's own failure must be shown all the same
            yield f"{_title(trial)}: cannot be saved ({error})"


def _plain(text: str) -> str:
    """Text as part of a file's name."""
    return re.sub(r"[^\w.=-]+", "-", text).strip("-")


# --------------------------------------------------------------------------------------- baselines


def _baseline_path(request: pytest.FixtureRequest, number: int) -> Path:
    name = _plain(f"{request.path.stem}-{request.node.name}") + (f"-{number}" if number else "")
    return request.path.parent / BASELINES / f"{name}.json"


def _baseline(trial: Trial) -> dict[str, Any]:
    """What a baseline holds: outcome, and value of every judged metric in its SI unit."""
    values = {item.name: item.value for item in trial.verdict.judged}
    return {
        "outcome": str(trial.record.outcome.name),
        "steps_completed": trial.record.outcome.steps_completed,
        "metrics": {name: None if value != value else value for name, value in values.items()},
    }


def _differences(before: Mapping[str, Any], trial: Trial) -> tuple[bool, list[str]]:
    """Whether a trial is worse than a baseline, and a line on every difference beyond rounding."""
    from validation.judge.metrics import metric_label  # loads NumPy
    from validation.judge.uncertainty import rounding  # loads NumPy
    from validation.study.compare.sweeps import TOLERANCE  # loads pyarrow

    now, lines, worse = _baseline(trial), [], False
    ends = [(item["outcome"] == "completed", item["steps_completed"]) for item in (before, now)]
    if ends[0] != ends[1]:
        worse = not ends[1][0] and ends[1] < ends[0]
        lines.append(
            " -> ".join(f"{item['outcome']} after {item['steps_completed']} steps" for item in (before, now))
        )
    known: Mapping[str, MetricResult] = {item.name: item for item in trial.verdict.judged}
    for name in {**before["metrics"], **now["metrics"]}:
        old, new = before["metrics"].get(name), now["metrics"].get(name)
        item = known.get(name)
        if old is None or new is None or item is None:
            if old != new:
                worse = worse or new is None
                words = ["none" if value is None else str(value) for value in (old, new)]
                lines.append(f"{metric_label(name)}: {' -> '.join(words)}")
            continue
        if abs(new - old) > rounding(max(abs(old), abs(new)), item.of.unit):
            limit = item.tolerance or 0.0
            grown = new - old > TOLERANCE * limit
            worse = worse or grown
            shown = [f"{number * item.factor:.4g}" for number in (old, new, limit)]
            mark = ", worse" if grown else ""
            unit = f" {item.display_unit}".rstrip()
            lines.append(f"{item.label}: {shown[0]} -> {shown[1]}{unit} (limit {shown[2]}){mark}")
    return worse, lines

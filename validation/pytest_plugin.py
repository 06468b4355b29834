"""pytest plugin: walks as fixtures, their verdicts as assertions, their recordings with failures.

    def test_my_controller(walked, assert_within):
        walked("momentum", controller=MyController, gait={"steps": 10})
        assert_within("default")

A walk is made once in a process for inputs, classes and files that are alike. The runs of a failed test are
saved with their recordings in pytest's folder for temporary files (``--basetemp``). Importing this module
loads nothing but pytest.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from ampm.parameters import RunParameters
    from validation.run.trial import Trial

_WALKED, _PLACE = pytest.StashKey[list["Trial"]](), pytest.StashKey[Path]()
_walks: dict[bytes, Trial] = {}
"""Trials of this process by their pickled inputs, as the objects among them may change."""


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Save the walks of a failed test, and show where."""
    report = yield
    trials = item.stash.get(_WALKED, [])
    if report.failed and trials:
        report.sections.append(("AMPM runs", "\n".join(_saved(item, trials))))
        trials.clear()  # a failure of the teardown needs no second copy
    return report


@pytest.fixture
def walked(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Trial]:
    """``walked(gait, controller=..., ...)``: a trial, see :func:`walk_once`."""
    trials = request.node.stash.setdefault(_WALKED, [])
    request.node.stash[_PLACE] = tmp_path_factory.getbasetemp() / "ampm-runs"

    def walk(source: Any = None, /, **inputs: Any) -> Trial:
        if isinstance(source, str | Path) and (beside := request.path.parent / source).is_file():
            source = str(beside)
        trials.append(walk_once(source, **inputs))
        return trials[-1]

    return walk


@pytest.fixture
def assert_within(request: pytest.FixtureRequest) -> Callable[..., None]:
    """``assert_within(profile, *trials)``: every tolerance is met; by default by all that the test walked.

    Without a profile the preset's own counts, as in ``assert_within(trial)``.
    """

    def check(profile: Any = None, *trials: Trial) -> None:
        __tracebackhide__ = True
        if hasattr(profile, "judged"):
            profile, trials = None, (profile, *trials)
        trials, wrong = trials or tuple(request.node.stash.get(_WALKED, ())), []
        if not trials:
            pytest.fail("this test walked nothing; call walked() first, or give the trials.", pytrace=False)
        for trial in trials:
            if not hasattr(trial, "judged"):
                pytest.fail(f"{trial!r:.70} is no trial; give trials one by one.", pytrace=False)
            verdict = (trial if profile is None else trial.judged(profile)).verdict
            if not verdict.passed:
                name = verdict.name.replace("_", " ")
                wrong.append(f"{_title(trial)}: {name} ({verdict.profile}). {verdict.reason}")
                wrong += [f"    {item.label}: {item.against}" for item in verdict.failed]
        if wrong:
            pytest.fail("\n".join(wrong), pytrace=False)

    return check


def walk_once(
    source: RunParameters | str | None = None,
    /,
    *,
    controller: Any = None,
    planner: Any = None,
    disturbances: Sequence[Any] = (),
    **sections: Mapping[str, Any],
) -> Trial:
    """Walk as :func:`validation.walk` does, unless the same was walked in this process.

    The same are inputs, classes with the values that they use, and files. A mapping as controller or planner
    is its section. Inputs that cannot be pickled are walked every time.

    Raises:
        InputError, MathematicalRefusal, BodilyRefusal: there is no such walk, or a user's class fails.
    """
    # Imported here: they load simulator, controller and NumPy.
    from validation.judge.metrics import added_metrics
    from validation.run.walk import walk
    from validation.study.many import identity
    from validation.study.pool import pickled
    from validation.trial.plan import load_request
    from validation.trial.users import users_classes

    if isinstance(controller, Mapping):
        sections, controller = {**sections, "controller": controller}, None
    if isinstance(planner, Mapping):
        sections, planner = {**sections, "planner": planner}, None
    request = load_request(source, sections=sections)
    run, name = request.run, request.name
    options = {"controller": controller, "planner": planner, "disturbances": disturbances}
    given = {"controller.name": controller, "gait.planner": planner}
    named = {key: text for key, text in given.items() if isinstance(text, str)}
    try:
        key = pickled((name, run, run.given, options, added_metrics(), users_classes(run.replace(named))))
        key += identity([run, *map(Path, named.values())]).encode()
    except Exception:  # of the user's objects
        return walk(run, name=name, **options)
    if key not in _walks:
        _walks[key] = walk(run, name=name, **options)
    return _walks[key]


def _title(trial: Trial) -> str:
    controller = trial.planned.run.controller.name
    return trial.planned.request.title + (f" with {controller}" if controller != "ampm" else "")


def _saved(item: pytest.Item, trials: Sequence[Trial]) -> Iterator[str]:
    """Save the walks of a failed test; a line on each."""
    place = item.stash[_PLACE] / re.sub(r"[^\w.=-]+", "-", item.nodeid).strip("-")
    while place.exists():  # of a test with another of these signs, or its first try
        place = place.with_name(f"{place.name}+")
    for number, trial in enumerate(trials):
        folder = place / f"{number}-{trial.planned.name}"
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of libraries that draw
                trial.save(folder, force=True)
            yield f"{_title(trial)}: {trial.record.outcome.summary}; ampm view {quote(str(folder))}"
        except Exception as error:  # the test's own failure must be shown all the same
            yield f"{_title(trial)}: cannot be saved ({error})"

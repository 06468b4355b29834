"""What every renderer writes: one golden file each, in which ``#`` stands for a number.

Numbers are tested where they are computed. ``AMPM_WRITE=1 pytest tests/test_rendered.py`` writes the files.
"""

from __future__ import annotations

import html
import os
import re
from dataclasses import replace
from pathlib import Path

import pytest
from validation.study.sweep.forecast import Forecast, Refused

from tests.saved_run import make_run
from tests.sweep_table import ENVIRONMENT, make_table, replaced, sweep_of
from tests.test_convergence import summary_with
from validation.cli.studies import _print_sweep, print_forecast, print_pair
from validation.cli.validate import print_result
from validation.judge.uncertainty import Uncertainty
from validation.progress import Progress
from validation.show.report import render as render_run
from validation.show.rerun.record import verdict_markdown
from validation.store.saved import load_saved_run
from validation.study.compare.pair import load_side, pair_of
from validation.study.compare.report import render as render_pair
from validation.study.sweep import figures
from validation.study.sweep.design import parse_sweep
from validation.study.sweep.diff import compare_sweeps
from validation.study.sweep.diff_text import print_diff, write_page
from validation.study.sweep.report import render as render_sweep

FOLDER = Path(__file__).parent / "rendered"
NUMBER = re.compile(r"(?<![\w.])[-−+]?\d[\d,]*(\.\d+)?(e[-+]?\d+|·10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)?")
KNOWN = Uncertainty(
    "x", 6, "abc", {"zmp_x_rmse": 0.0025, "zmp_y_rmse": float("inf")}, {}, ("time_step",), ("qp_tolerance",),
    {"force_x_rmse": ("qp_tolerance",)},
)  # fmt: skip


def plain(page: str) -> str:
    """Text of a page or a terminal, without pictures, frames and numbers, a line per row."""
    page = re.sub(r"(?s)<(script|style|svg)\b.*?</\1>", "", page)
    page = re.sub(r"</(p|h\d|li|tr|div|section|figcaption|summary|title)>", "\n", page)
    page = html.unescape(re.sub(r"(?s)<[a-z/!][^>]*>", " ", page))
    page = NUMBER.sub("#", re.sub(r"[\u2500-\u257f]+", " ", page))
    lines = (" ".join(line.split()) for line in page.splitlines())
    return "\n".join(line for line in lines if line) + "\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return make_run(tmp_path_factory.mktemp("run") / "run", uncertainty=KNOWN)


@pytest.fixture
def saved(folder):
    run = load_saved_run(folder)
    return replace(run, summary={**run.summary, "environment": ENVIRONMENT})


@pytest.fixture(scope="module")
def pair(run_of):
    folders = run_of("normal", steps=5), run_of("ipm", steps=5)
    return pair_of(*(load_side(name, at, Progress()) for name, at in zip(("a", "b"), folders, strict=True)))


@pytest.fixture(scope="module")
def diff():
    before = make_table(60)
    worse = [value and 1.5 * value for value in before["metric_zmp_y_rmse"].to_pylist()]
    late = ["fell" if run == 3 else end for run, end in enumerate(before["outcome"].to_pylist())]
    after = replaced(replaced(before, "metric_zmp_y_rmse", worse), "outcome", late).slice(0, 55)
    return compare_sweeps(sweep_of(before, "A"), sweep_of(after, "B"))


FORECAST = Forecast(
    definition=parse_sweep('[[vary]]\nmethod = "list"\ngait.c_y = [0.5, 1.0]\n'), runs=2,
    refused=(Refused("c_y_not_positive", 1, "too low; raise it."),), gaits=9, checked=5,
    body_refused=(Refused("leg_too_short", 1, "too long; shorten it."),), motion_refused=("bend the knee.",),
    walking=1, seconds=3.0, recording=2.0, workers=2,
)  # fmt: skip


def page_of_diff(request):
    path = request.getfixturevalue("tmp_path") / "diff.html"
    write_page(request.getfixturevalue("diff"), path, force=False)
    return path.read_text(encoding="utf-8")


def of(fixture, render):
    return lambda request: render(request.getfixturevalue(fixture))


def told(*words):
    """Output of a command line; ``{run}`` is a run's folder."""

    def text(request):
        folder = request.getfixturevalue("folder") if "{run}" in words else ""
        return request.getfixturevalue("ampm")(*(word.format(run=folder) for word in words)).out

    return text


RENDERERS = {
    "plan": told("plan", "normal"),
    "result": lambda _: print_result(summary_with(KNOWN), Path("run")),
    "report": of("saved", render_run),
    "verdict": of("saved", verdict_markdown),
    "comparison": of("pair", print_pair),
    "comparison-page": of("pair", render_pair),
    "sweep": lambda _: _print_sweep(sweep_of(make_table(200))),
    "sweep-page": lambda _: render_sweep(sweep_of(make_table(200))),
    "forecast": lambda _: print_forecast(FORECAST),
    "diff": of("diff", print_diff),
    "diff-page": page_of_diff,
}


@pytest.mark.parametrize("name", RENDERERS)
def test_a_renderer_writes_what_it_wrote(name, request, capsys, monkeypatch):
    monkeypatch.setattr(figures, "svg", lambda *_: "")
    text = RENDERERS[name](request)
    text = plain(text if text is not None else capsys.readouterr().out)
    path = FOLDER / f"{name}.txt"
    if os.environ.get("AMPM_WRITE"):
        path.write_text(text, encoding="utf-8")
    assert text.splitlines() == path.read_text(encoding="utf-8").splitlines()

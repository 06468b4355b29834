"""The report is one page that needs nothing else, tells the truth about a failure, and escapes all text."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ampm.exceptions import InputError
from tests.saved_run import make_run
from validation.judge.metrics import metric_label
from validation.show import run_figures as figures
from validation.show.report import REPORT_FILE, render, write_report
from validation.show.style import decimate
from validation.show.text import number, with_unit
from validation.store.saved import load_saved_run
from validation.store.signals import column_of
from validation.trial.outcome import Outcome, OutcomeName


class Page(HTMLParser):
    """Collects what a test asks about."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.ids: list[str] = []
        self.tags: set[str] = set()
        self.links: list[str] = []
        self.figures = 0
        self.text = ""
        self.open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.tags.add(tag)
        self.figures += tag == "svg"
        if tag not in ("meta", "br", "link", "img"):
            self.open.append(tag)
        for name, value in attributes:
            if name == "id":
                self.ids.append(value)
            if name in ("href", "src", "xlink:href"):
                self.links.append(value)

    def handle_endtag(self, tag):
        assert self.open, f"</{tag}> closes nothing"
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory):
    return make_run(tmp_path_factory.mktemp("run"), steps=6)


@pytest.fixture(scope="module")
def html(run_dir):
    assert write_report(run_dir) == run_dir / REPORT_FILE
    return (run_dir / REPORT_FILE).read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def page(html):
    return Page(html)


def test_page_is_self_contained(html, page):
    assert "script" not in page.tags
    assert all(link.startswith("#") for link in page.links)
    assert not re.search(r"https?://(?!www\.w3\.org/)", html)
    assert "@import" not in html
    assert "url(http" not in html


def test_page_is_well_formed(page):
    assert page.open == []
    assert len(page.ids) == len(set(page.ids))
    assert {link.removeprefix("#") for link in page.links} <= set(page.ids)


def test_every_judged_metric_stands_in_the_page(run_dir, page):
    summary = json.loads((run_dir / "summary.json").read_text(encoding="utf-8"))
    judged = {name: item for name, item in summary["metrics"].items() if item["tolerance"] is not None}
    assert judged
    for name in judged:
        assert metric_label(name) in page.text
        assert name not in page.text  # only readable names
    assert with_unit(judged["zmp_x_rmse"]["display"]["value"], "mm") in page.text


def test_cost_and_plain_statement_stand_beside_the_agreement(page):
    for phrase in (
        "Agreement", "Cost", "What this trial shows, and what it does not", "agreement alone proves nothing",
        "feedback on the ZMP",
        "largest torque", "friction used", "The first step", "Zero moment point", "Ground reaction force",
        "Angular momentum about the COM", "COM error", "Causes of the ZMP error",
    ):  # fmt: skip
        assert phrase in page.text, phrase


def test_figures_follow_the_colours_of_the_page(html, page):
    assert page.figures >= 15
    assert "#0101" not in html.lower()
    assert "prefers-color-scheme: dark" in html
    used = set(re.findall(r"var\(--([\w-]+)\)", html))
    defined = set(re.findall(r"--([\w-]+):", html))
    assert used <= defined


def test_page_is_small(html):
    assert len(html) < 3e6


def test_same_run_gives_the_same_page(run_dir, html):
    assert render(load_saved_run(run_dir)) == html


@pytest.mark.parametrize("seconds", [0.0, 0.002, 0.9])
def test_a_fall_is_told_as_one(tmp_path, seconds):
    end = Outcome(OutcomeName.FELL, seconds, "The <b>pelvis</b> sank & stayed.", 0)
    directory = make_run(tmp_path, steps=4, seconds=seconds, outcome=end)
    html = write_report(directory).read_text(encoding="utf-8")
    page = Page(html)
    assert "fell" in page.text
    assert 'class="card verdict fail"' in html
    assert "<b>pelvis</b>" not in html
    assert "The <b>pelvis</b> sank & stayed." in page.text


def test_names_from_outside_are_escaped(run_dir):
    saved = load_saved_run(run_dir)
    nasty = "</title><script>alert(1)</script>"
    summary = {**saved.summary, "gait": nasty, "reason": nasty, "environment": {nasty: nasty}}
    object.__setattr__(saved, "summary", summary)
    html = render(saved)
    assert "<script" not in html
    assert nasty in Page(html).text


def test_a_folder_that_is_no_run_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"summary\.json"):
        write_report(tmp_path)


def test_missing_column_is_named(run_dir):
    signals = load_saved_run(run_dir).signals
    assert all(column_of(name).meaning for name in signals.columns)
    with pytest.raises(InputError, match="plan_nothing"):
        signals["plan_nothing"]


def test_strides_are_two_steps_each_and_leave_out_the_first(run_dir):
    saved = load_saved_run(run_dir)
    plan = saved.plan()
    assert plan is not None
    strides = figures.strides(saved.signals)
    assert [round(saved.signals.time[s.start] / plan.constants.step_duration, 2) for s in strides] == [2.0]
    length = (strides[0].stop - strides[0].start) * saved.record.time_step
    assert length == pytest.approx(2 * plan.constants.step_duration, abs=saved.record.time_step)
    first = saved.signals.first_step()
    assert saved.signals.time[first] == pytest.approx(plan.constants.step_duration, abs=0.002)


@settings(max_examples=50, deadline=None)
@given(
    values=st.lists(st.floats(-1e6, 1e6) | st.just(float("nan")), min_size=1, max_size=3000),
    buckets=st.integers(1, 50),
)
def test_thinning_keeps_the_extremes(values, buckets):
    value = np.array(values)
    time, thin = decimate(np.arange(len(value), dtype=float), value, buckets)
    assert len(time) == len(thin)
    assert len(thin) <= max(2 * buckets, 1)
    assert np.all(np.diff(time) > 0)
    if np.isfinite(value).any():
        assert np.nanmin(thin) == np.nanmin(value)
        assert np.nanmax(thin) == np.nanmax(value)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "–"), (float("nan"), "–"), (0.0, "0"), (1.0634, "1.06"), (0.495, "0.495"), (123.456, "123"),
        (-0.0123, "−0.0123"), (1e-9, "1.00·10⁻⁹"), (7, "7"), (True, "yes"), ("text", "text"),
        (99.96, "100.0"),
    ],
)  # fmt: skip
def test_numbers_are_written_for_people(value, text):
    assert number(value) == text


def test_units_do_not_break_from_their_figures():
    assert with_unit(1.5, "N m s") == "1.50\u00a0N\u00a0m\u00a0s"
    assert with_unit(1.5, "1") == "1.50"
    assert with_unit(None, "mm") == "–"

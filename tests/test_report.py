"""The report is one page that needs nothing else, tells the truth about a failure, and escapes all text."""

import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ampm.exceptions import InputError
from tests.saved_run import make_run
from validation.show.cost_table import cost_table, reported_table
from validation.show.report import REPORT_FILE, render, write_report
from validation.show.rerun.record import verdict_markdown, write_recording
from validation.show.run_figures import strides
from validation.show.style import decimate
from validation.show.text import limit_with_unit, number, with_unit
from validation.store.saved import load_saved_run, run_events
from validation.store.signals import column_of
from validation.trial.outcome import Outcome, OutcomeName

COARSE = ("simulation.time_step=0.002",)


class Page(HTMLParser):
    """Collects what a test asks about."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.ids: list[str] = []
        self.tags: list[str] = []
        self.links: list[str] = []
        self.text = ""
        self.open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
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


def test_the_soles_are_those_of_the_body_that_walked(run_dir):
    saved = load_saved_run(run_dir)
    long = replace(saved, body=replace(saved.body, sole=replace(saved.body.sole, tip_x=0.3)))
    plans = saved.plan(), long.plan()
    assert [plan.feet.sole.tip_x for plan in plans if plan] == [pytest.approx(0.158), 0.3]


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory):
    return make_run(tmp_path_factory.mktemp("run"), steps=6, settings=COARSE)


@pytest.fixture(scope="module")
def html(run_dir):
    assert write_report(run_dir) == run_dir / REPORT_FILE
    return (run_dir / REPORT_FILE).read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def page(html):
    return Page(html)


def test_page_is_self_contained_small_and_well_formed(run_dir, html, page):
    assert "script" not in page.tags
    assert not re.search(r"https?://(?!www\.w3\.org/)|@import|url\(http", html)
    assert page.open == []
    assert len(page.ids) == len(set(page.ids))
    assert set(page.links) - {"data:,"} <= {f"#{name}" for name in page.ids}
    assert len(html) < 3e6
    assert render(load_saved_run(run_dir)) == html  # the same run gives the same page
    assert page.tags.count("svg") >= 15
    assert "#0101" not in html.lower()  # every colour is one of the page's
    assert set(re.findall(r"var\(--([\w-]+)\)", html)) <= set(re.findall(r"--([\w-]+):", html))


def test_page_shows_the_tables_of_the_run(run_dir, html, page):
    saved = load_saved_run(run_dir)
    assert saved.table().__html__() in html
    assert cost_table(saved.summary).__html__() in html
    assert reported_table(saved.summary).__html__() in html
    assert not [name for name in saved.summary["metrics"] if name in page.text]  # only readable names


@pytest.mark.parametrize("seconds", [0.0, 0.9])
def test_a_fall_is_told_as_one(tmp_path, seconds):
    cause = "The <b>pelvis</b> sank & stayed \N{SKULL}."
    end = Outcome(OutcomeName.FELL, seconds, cause, 0)
    directory = make_run(tmp_path, settings=COARSE, outcome=end)
    html = write_report(directory).read_text(encoding="utf-8")
    assert 'class="card verdict fail"' in html
    assert "<b>pelvis</b>" not in html
    text = Page(html).text
    assert "fell" in text
    assert cause in text
    write_recording(directory)
    saved = load_saved_run(directory)
    assert any(level == "CRITICAL" and "fell" in text for _, level, text in run_events(saved))
    assert "fell" in verdict_markdown(saved)


def test_the_title_names_what_was_changed(run_dir):
    saved = load_saved_run(run_dir)
    changed = replace(saved, summary={**saved.summary, "changed": {"gait.c_y": 0.93, "solver.qp": "daqp"}})
    assert changed.title != saved.title
    assert f"<h1>{changed.title}" in render(changed)


def test_names_from_outside_are_escaped(run_dir):
    nasty = "</title><script>alert(1)</script>"
    saved = load_saved_run(run_dir)
    summary = {**saved.summary, "gait": nasty, "reason": nasty, "environment": {nasty: nasty}}
    html = render(replace(saved, summary=summary))
    assert "<script" not in html
    assert nasty in Page(html).text


@pytest.mark.parametrize("write", [write_report, write_recording])
def test_a_folder_that_is_no_run_is_refused(write, tmp_path):
    with pytest.raises(InputError, match=r"run\.toml.*summary\.json"):
        write(tmp_path)


def test_missing_column_is_named(run_dir):
    signals = load_saved_run(run_dir).signals
    assert all(column_of(name).meaning for name in signals.columns)
    with pytest.raises(InputError, match="plan_nothing"):
        signals["plan_nothing"]


def test_strides_are_two_steps_each_and_leave_out_the_first(run_dir):
    saved = load_saved_run(run_dir)
    plan = saved.plan()
    assert plan is not None
    time, step = saved.signals.time, plan.constants.step_duration
    (stride,) = strides(saved.signals)
    ends = time[[saved.signals.first_step(), stride.start, stride.stop]]
    np.testing.assert_allclose(ends, [step, 2 * step, 4 * step], atol=0.005)


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
    assert with_unit(value, "N m s").replace("\u00a0", " ") == (text if text == "–" else f"{text} N m s")
    assert with_unit(value, "1") == text


@pytest.mark.parametrize(
    ("limit", "text"), [(2.5, "2.5"), (0.0, "0"), (1e-6, "1·10⁻⁶"), (2.5e-9, "2.5·10⁻⁹"), (1.647293, "1.647")]
)
def test_limits_are_written_as_they_were_set(limit, text):
    assert limit_with_unit(limit, "1") == text

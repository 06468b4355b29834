"""The report is one page that needs nothing else, tells the truth about a failure, and escapes all text."""

import re
from dataclasses import replace
from html.parser import HTMLParser
from unittest.mock import patch

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ampm.exceptions import InputError
from tests.browser import look
from tests.saved_run import make_run
from validation.judge.metrics import METRICS
from validation.show.cost_table import cost_table, reported_table
from validation.show.report import REPORT_FILE, render, write_report
from validation.show.rerun.record import verdict_markdown, write_recording
from validation.show.run_figures import RunFigures, middle, strides
from validation.show.style import decimate, style
from validation.show.walker import INSTANTS, arrow_scale, draw_walker, outline
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


# ------------------------------------------------------------------------------------------- first screen


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("size", [(1200, 900), (390, 844)], ids=["laptop", "phone"])
def test_the_first_screen_has_verdict_contents_walker_and_gait(html, tmp_path, size, dark):
    path = tmp_path / "report.html"
    path.write_text(html, encoding="utf-8")
    script = """
    const bottom = (name) => Math.max(...[...document.querySelectorAll(name)].map(
      (part) => part.getBoundingClientRect().bottom));
    const inside = [...document.querySelectorAll(".walker svg")].every((svg) => {
      const box = svg.getBoundingClientRect();
      return box.width > 80 && box.left >= 0 && box.right <= innerWidth; });
    tell({ inside, pictures: document.querySelectorAll(".walker svg").length,
      bottoms: [".verdict", "nav", ".walker", "header .facts"].map(bottom),
      wide: document.documentElement.scrollWidth - innerWidth,
      page: getComputedStyle(document.body).backgroundColor,
      limb: getComputedStyle(document.querySelector(".walker .left")).fill });
    """
    seen = look(path, tmp_path, script, size=size, dark=dark)
    assert seen.console == []
    told = seen.told
    assert told["wide"] <= 0
    assert told["inside"]
    assert told["pictures"] == INSTANTS
    assert told["bottoms"] == sorted(told["bottoms"])
    if size[0] == 1200:
        assert told["bottoms"][-1] <= size[1]
    else:
        assert told["bottoms"][1] <= size[1]  # on a telephone verdict and contents, and the walker begins
    assert (told["page"] == "rgb(20, 23, 27)") == dark
    assert "color" in told["limb"] or told["limb"].startswith("rgb")


def test_contents_lead_to_every_section_in_order(html):
    nav = html[html.index("<nav") : html.index("</nav>")]
    entries = re.findall(r'<a href="#([\w-]+)">([^<]+)</a>', nav)
    assert entries == re.findall(r'<h2 id="([\w-]+)">([^<]+)</h2>', html)
    assert len(entries) > 8


def test_the_gait_is_told_by_its_parameters(run_dir, html):
    gait = load_saved_run(run_dir).parameters.gait
    header = html[html.index("<header>") : html.index("</header>")]
    facts = dict(re.findall(r"<dt>([^<]+)</dt><dd>([^<]+)</dd>", header))
    assert facts["step length"] == f"{gait.step_length:g} m"
    assert facts["COM height"] == f"{gait.com_height:g} m"
    assert facts["slopes c_s, c_y"] == f"{gait.c_s:g}, {gait.c_y:g}"
    assert facts["steps walked"] == "6 of 6"


def test_the_walker_is_drawn_from_saved_joint_angles_forces_and_zmps(run_dir, tmp_path):
    saved = load_saved_run(run_dir)
    stride = middle(saved.signals)
    with patch("mujoco.mj_step", side_effect=AssertionError("stepped")):
        instants = draw_walker(saved, saved.plan(), stride)
    assert len(instants) == INSTANTS
    assert [item.phase for item in instants] == [
        "left single support", "left single support", "double support",
        "right single support", "right single support", "double support",
    ]  # fmt: skip
    signals, scale = saved.signals, 200.0  # px/m
    for item in instants:
        row = int(np.searchsorted(signals.time, item.time - 1e-9))
        # Place of the measured ZMP from the COM, and of the tip from the ZMP: what the signals say.
        (com,) = re.findall(r'circle class="com" cx="([\d.-]+)"', item.svg)
        (zmp,) = re.findall(r'circle class="measured" cx="([\d.-]+)"', item.svg)
        offset = signals["measured_zmp_x"][row] - signals["measured_com_x"][row]
        assert (float(zmp) - float(com)) / scale == pytest.approx(offset, abs=1e-3)
        ends = r" ".join(rf'{name}="([\d.-]+)"' for name in ("x1", "y1", "x2", "y2"))
        (arrow,) = re.findall(f'line class="measured" {ends}', item.svg)
        x1, y1, x2, y2 = map(float, arrow)
        force = arrow_scale(saved) * signals.vector("measured_force")[row]
        assert ((x2 - x1) / scale, (y1 - y2) / scale) == pytest.approx((force[0], force[2]), abs=1e-3)
        # The lowest shape is on the floor.
        shapes = re.findall(r'polygon class="(?:left|right)" points="([^"]+)"', item.svg)
        lowest = max(float(corner.split(",")[1]) for shape in shapes for corner in shape.split())
        (floor,) = set(re.findall(r'line class="floor" x1="[\d.-]+" y1="([\d.-]+)"', item.svg))
        assert (lowest - float(floor)) / scale == pytest.approx(0.0, abs=0.01)
    bent = load_saved_run(make_run(tmp_path, steps=6, settings=COARSE, angles={"left_knee_pitch": 1.5}))
    assert draw_walker(bent, bent.plan(), stride) != instants


def test_outlines_are_those_of_the_shapes():
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><asset><mesh name='m' vertex='-.1 0 0 .3 0 0 0 .2 0 0 0 .4'/></asset><worldbody>"
        "<body pos='0 0 1' euler='0 90 0'><freejoint/><geom size='.1'/><geom type='box' size='.1 .2 .3'/>"
        "<geom type='capsule' size='.1 .3'/><geom type='ellipsoid' size='.1 .2 .3'/>"
        "<geom type='mesh' mesh='m'/></body></worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    plane = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    # The body's z is the world's x: half the extent along x and z.
    for geom, extent in enumerate([(0.1, 0.1), (0.3, 0.1), (0.4, 0.1), (0.3, 0.1), (0.2, 0.2)]):
        corners = outline(model, data, geom, plane)
        np.testing.assert_allclose(np.ptp(corners, axis=0) / 2.0, extent, atol=2e-3)


def test_a_lost_walk_is_shown_at_its_end(tmp_path):
    end = Outcome(OutcomeName.FELL, 0.9, "It fell.", 0)
    saved = load_saved_run(make_run(tmp_path, settings=COARSE, outcome=end))
    times = [item.time for item in draw_walker(saved, saved.plan(), middle(saved.signals))]
    assert times == sorted(times)
    assert times[-1] == pytest.approx(0.9, abs=0.02)
    assert len(times) == INSTANTS


# ---------------------------------------------------------------------------------------- panels and hints


def test_errors_have_the_large_panels(run_dir):
    figures = []
    saved = load_saved_run(run_dir)
    with (
        style(),
        patch("validation.show.style.picture", lambda figure, *_, **__: figures.append(figure)),
    ):
        RunFigures(saved, None).tracking("zmp_x", "ZMP x", "mm", 1e3)
    large, lower, whole = figures[0].axes
    heights = [axis.get_position().height for axis in (large, lower, whole)]
    assert heights[0] > 1.8 * max(heights[1:])
    assert large.get_title(loc="left").startswith("Error of ZMP along x")
    assert [line.get_label() for line in lower.get_lines()] == ["plan", "command", "measured"]
    signals, stride = saved.signals, middle(saved.signals)
    error = 1e3 * (signals["measured_zmp_x"] - signals["plan_zmp_x"])[stride]
    np.testing.assert_array_equal(large.get_lines()[0].get_ydata(), error)
    assert all("[" in axis.get_ylabel() and "[s]" in axis.get_xlabel() for axis in figures[0].axes)


def test_a_number_that_alarms_is_explained_below_it(run_dir, html):
    summary = load_saved_run(run_dir).summary
    label = METRICS["margin_plan_polygon"].label
    assert summary["margins"]["plan_polygon"]["value"] < 1e-3
    hint = cost_table(summary).hints[label]
    assert f"{1e3 * summary['margins']['plan_in_measured_polygon']['value']:.3g} mm" in hint
    assert re.search(rf'{re.escape(label)}</th>.*</tr><tr class="hint"><td[^>]*>{re.escape(hint)}', html)
    outside = {
        **summary,
        "margins": {**summary["margins"], "plan_polygon": {"value": -0.01, "time": 1.0, "where": ""}},
    }
    assert label not in cost_table(outside).hints  # a plan that leaves its support is not excused

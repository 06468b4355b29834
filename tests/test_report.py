"""The report is one page that needs nothing else, tells the truth about a failure, and escapes all text.

Recordings hold the data they are drawn from, and stand side by side on the gait's phase.
"""

import os
import re
import subprocess
import sys
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rerun.chunk import RrdReader
from scipy.spatial.transform import Rotation

from ampm.exceptions import InputError
from tests.browser import look
from tests.saved_run import TWO_MS, make_run
from validation.cli.app import Status
from validation.show.chart import decimate
from validation.show.cost_table import cost_table, reported_table
from validation.show.curves import CURVES, DIFFERENCES
from validation.show.report import render, write_report
from validation.show.rerun.record import SINGLE_SUPPORT, verdict_markdown, write_recording
from validation.show.rerun.views import PHASE
from validation.show.run_figures import RunFigures, middle, strides
from validation.show.style import MEASURED, SHADE
from validation.show.walker import INSTANTS, draw_walker
from validation.store.record import load_record
from validation.store.saved import SavedRun, load_saved_run, run_events
from validation.store.signals import load_signals
from validation.trial.files import RunFile
from validation.trial.outcome import Outcome, OutcomeName


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
        self.ids += [value for name, value in attributes if name == "id"]
        self.links += [value for name, value in attributes if name in ("href", "src", "xlink:href")]

    def handle_endtag(self, tag):
        assert self.open, f"</{tag}> closes nothing"
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


def assert_self_contained(html: str) -> Page:
    """A page loads nothing, runs nothing, closes what it opens and knows its colours."""
    page = Page(html)
    assert "script" not in page.tags
    assert not re.search(r"https?://(?!www\.w3\.org/)|@import|url\((?!#)", html)
    assert page.open == []
    assert set(re.findall(r"var\(--([\w-]+)\)", html)) <= set(re.findall(r"--([\w-]+):", html))
    return page


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory):
    return make_run(tmp_path_factory.mktemp("run"), steps=6)


@pytest.fixture(scope="module")
def html(run_dir):
    assert write_report(run_dir) == run_dir / RunFile.REPORT
    return (run_dir / RunFile.REPORT).read_text(encoding="utf-8")


def test_pushes_are_drawn_and_told(tmp_path, monkeypatch):
    """The figures show the stride that was pushed; the recording has an arrow while the push acts."""
    push = (f"disturbance.push_{name}" for name in ("segment=chest", "y=30", "at=2.5", "duration=0.1"))
    saved = load_saved_run(make_run(tmp_path / "run", steps=7, settings=(*TWO_MS, *push)))
    assert saved.pushes == [("thorax", pytest.approx(2.5), pytest.approx(2.6), 30.0)]
    stride = RunFigures(saved, saved.plan()).window
    assert saved.signals.time[stride][0] < 2.5 < saved.signals.time[stride][-1]
    found = strides(saved.signals)
    assert stride == middle(saved) != found[len(found) // 2]
    page, told = render(saved), "A push of up to 30 N on thorax for 0.1 s."
    assert page.count("Red: a push.") == 13
    assert (pytest.approx(2.5), "WARN", told) in run_events(saved)
    (rows,) = batches(write_recording(saved), "/world/force/push/thorax")
    assert sum(map(bool, rows.column("Arrows3D:vectors").to_pylist())) == pytest.approx(10, abs=1)
    monkeypatch.setattr(SavedRun, "pushes", [("thorax", 0.1, 0.2, 30.0)])
    assert RunFigures(saved, saved.plan()).causes("x").charts[0].marks[0].fill == SHADE  # below the push
    assert middle(saved) == found[0]


def test_page_is_self_contained_small_and_well_formed(run_dir, html):
    page = assert_self_contained(html)
    assert len(page.ids) == len(set(page.ids))
    links = {link for link in page.links if not link.startswith("data:")}
    assert links == {f"#{name}" for name in page.ids}  # the contents lead to every section
    assert len(html) < 3e6
    assert render(load_saved_run(run_dir)) == html  # the same run gives the same page
    assert page.tags.count("img") >= 15


def test_page_shows_the_tables_of_the_run(run_dir, html):
    saved = load_saved_run(run_dir)
    for table in (saved.table(), cost_table(saved.summary), reported_table(saved.summary)):
        assert table.__html__() in html
    facts = dict(re.findall(r"<dt>([^<]+)</dt><dd>([^<]+)</dd>", html))
    gait = saved.parameters.gait
    assert facts["step length"] == f"{gait.step_length:g} m"
    assert facts["slopes c_s, c_y"] == f"{gait.c_s:g}, {gait.c_y:g}"
    assert facts["steps walked"] == "6 of 6"
    other = replace(saved, summary={**saved.summary, "changed": {"gait.c_y": 0.93, "solver.tolerance": 1e-5}})
    assert f"<h1>{other.title}" in render(other) != html


def test_an_error_is_drawn_as_measured_minus_planned_in_the_unit_of_its_axis(run_dir):
    saved = load_saved_run(run_dir)
    force = [saved.signals[f"{kind}_force_z"] for kind in ("measured", "plan")]
    error = 100.0 * (force[0] - force[1]) / (saved.record.mass * saved.record.gravity)
    figures = RunFigures(saved, saved.plan())
    drawn = figures.tracking(CURVES["force_z"]).charts[2].marks[1].points[:, 1]
    assert (drawn.min(), drawn.max()) == pytest.approx((np.nanmin(error), np.nanmax(error)))
    error = 1e3 * (saved.signals["measured_zmp_x"] - saved.signals["plan_zmp_x"])[figures.window]
    drawn = figures.causes("x").charts[0].marks[-1].points[:, 1]
    assert (drawn.min(), drawn.max()) == pytest.approx((error.min(), error.max()))


def test_a_plan_that_is_not_known_again_leaves_times_and_measured_footprints(run_dir, html):
    saved = load_saved_run(run_dir)
    other = replace(saved, summary={**saved.summary, "planner": "Mine"})
    of_both = [dict(re.findall(r"<dt>([^<]+)</dt><dd>([^<]+)</dd>", page)) for page in (html, render(other))]
    for name in ("single support", "double support", "planned speed"):
        known, found = (float(facts[name].split()[0]) for facts in of_both)
        assert found == pytest.approx(known, abs=0.002), name
    assert ("step length" in of_both[0], "step length" in of_both[1]) == (True, False)
    planned, measured = (RunFigures(saved, plan).top_view() for plan in (saved.plan(), other.plan()))
    assert "over measured footprints" in measured.label
    places = [
        [mark.points.mean(axis=0) for mark in picture.charts[0].marks if mark.fill == SHADE]
        for picture in (planned, measured)
    ]
    assert len(places[1]) >= 4
    for place in places[1]:
        assert np.linalg.norm(np.array(places[0]) - place, axis=1).min() < 0.03


@pytest.mark.parametrize("seconds", [0.0, 0.9])
def test_a_fall_is_told_as_one(tmp_path, seconds):
    cause = "The <b>pelvis</b> sank & stayed \N{SKULL}."
    directory = make_run(tmp_path, outcome=Outcome(OutcomeName.FELL, seconds, cause, 0))
    html = write_report(directory).read_text(encoding="utf-8")
    assert 'class="card verdict fail"' in html
    assert "<b>pelvis</b>" not in html
    text = Page(html).text
    assert "fell" in text
    assert cause in text
    write_recording(directory)
    saved = load_saved_run(directory)
    assert any(level == "CRITICAL" and "fell" in text for _, level, text in run_events(saved))
    assert "not measured (fell)" in verdict_markdown(saved)
    if seconds:
        (chart,) = draw_walker(saved, saved.plan(), middle(saved))
        *_, last = chart.xticks
        assert len(chart.xticks) == INSTANTS
        assert float(last.split()[0]) == pytest.approx(seconds, abs=0.02)


def test_names_from_outside_are_escaped(run_dir):
    nasty = "</title><script>alert(1)</script>"
    saved = load_saved_run(run_dir)
    summary = {
        **saved.summary,
        "gait": nasty,
        "reason": nasty,
        "environment": {nasty: nasty},
        "verdict": "partial",
    }
    html = render(replace(saved, summary=summary))
    assert ("<script" in html, "verdict open" in html) == (False, True)
    assert nasty in Page(html).text


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


@pytest.mark.parametrize("size", [(1200, 900), (390, 844)], ids=["laptop", "phone"])
def test_the_first_screen_has_verdict_contents_walker_and_gait(html, tmp_path, size):
    path = tmp_path / "report.html"
    path.write_text(html, encoding="utf-8")
    script = """
    const bottom = (name) => document.querySelector(name).getBoundingClientRect().bottom;
    tell({ bottoms: [".verdict", "nav", "header figure", "header .facts"].map(bottom),
      drawn: [...document.images].every((image) => image.naturalWidth > 100),
      wide: ["html", ".scroll"].map(
        (name) => document.querySelector(name).scrollWidth - document.querySelector(name).clientWidth) });
    """
    told, console = look(path, tmp_path, script, size=size)
    assert console == []
    assert max(told["wide"]) <= 0  # of the page, and of the table of metrics
    assert told["drawn"]
    assert told["bottoms"] == sorted(told["bottoms"])
    last = -1 if size[0] == 1200 else 2  # on a telephone the facts may lie below
    assert told["bottoms"][last] <= size[1]


def test_the_walker_is_drawn_from_saved_joint_angles_forces_and_zmps(run_dir, monkeypatch):
    saved = load_saved_run(run_dir)
    signals, stride = saved.signals, middle(saved)
    (chart,) = draw_walker(saved, saved.plan(), stride)
    phases = [text.partition("\n")[2] for text in chart.xticks]
    single = ["left support"] * 2, ["right support"] * 2
    assert phases == [*single[0], "double support", *single[1], "double support"]
    zmps = [mark.points[0, 0] for mark in chart.marks if mark.stroke == MEASURED and mark.round]
    for (text, at), zmp in zip(chart.xticks.items(), zmps, strict=True):
        row = int(np.searchsorted(signals.time, float(text.split()[0]) - 0.006))
        near = slice(row, row + 8)  # the text is rounded
        offsets = (signals["measured_zmp_x"] - signals["measured_com_x"])[near]
        assert np.abs(offsets - (zmp - at)).min() < 1e-3
        shapes = [mark for mark in chart.marks if mark.opacity < 1.0 and abs(mark.points[0, 0] - at) < 0.45]
        lowest = min(mark.points[:, 1].min() for mark in shapes)
        assert lowest == pytest.approx(0.0, abs=0.01)  # the lowest shape is on the floor
    spec = mujoco.MjSpec.from_file(str(run_dir / RunFile.MODEL))
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[9.0, 1.0, 0.5], pos=[0.0, 0.0, -0.5])
    monkeypatch.setattr(SavedRun, "model", lambda self: spec.compile())
    (deep,) = draw_walker(saved, saved.plan(), stride)
    assert 0.1 < chart.limits()[0][1] - deep.limits()[0][1] < 0.2


SLOW = ("gait.switching_velocity=0.9", "gait.a_s=2.4")


@pytest.fixture(scope="module")
def walks(tmp_path_factory):
    """Folders of runs with recordings: a gait, the same again but shorter, and a slower one."""
    base = tmp_path_factory.mktemp("walks")
    folders = {
        "one": make_run(base / "one", steps=4),
        "two": make_run(base / "two", steps=2),
        "slow": make_run(base / "slow", steps=4, settings=(*TWO_MS, *SLOW)),
    }
    for folder in folders.values():
        assert write_recording(folder) == folder / RunFile.RECORDING
    return folders


@pytest.fixture
def one(walks):
    return walks["one"]


def assert_rrd(command: str, *files: Path) -> None:
    """Check files by the viewer's own program."""
    words = [sys.executable, "-m", "rerun", "rrd", command, *map(str, files)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr


def entities(path: Path) -> set[str]:
    found = {chunk.entity_path for chunk in RrdReader(path).stream()}
    return {entity for entity in found if not entity.startswith("/__")}  # properties of the recording


def identity(path: Path) -> str:
    """What a viewer tells recordings apart by."""
    (recording,) = RrdReader(path).recordings()
    return str(recording.recording_id)


def batches(path: Path, entity: str, *, static: bool = False) -> list[Any]:
    chunks = RrdReader(path).stream().filter(content=entity)
    return [chunk.to_record_batch() for chunk in chunks if chunk.is_static == static and chunk.num_rows]


def column(path: Path, entity: str, name: str) -> np.ndarray:
    """Values of a component at all times, or one of its time lines [s]."""
    values = batches(path, entity)[0].column(name)
    return np.array(values.to_pylist()) if ":" in name else values.to_numpy() / np.timedelta64(1, "s")


def last_static(path: Path, entity: str, column: str) -> Any:
    """Value of a static component in the viewer: the newest by row id."""
    rows = [
        (batch.column(0)[row].as_py(), batch.column(column)[row].as_py())
        for batch in batches(path, entity, static=True)
        if column in batch.schema.names
        for row in range(batch.num_rows)
    ]
    return max(rows)[1]


def test_series_are_the_signals_bit_for_bit(one):
    signals, path = load_signals(one / "signals.parquet"), one / RunFile.RECORDING
    force = column(path, "/signals/force_z", "Scalars:scalars")
    for index, kind in enumerate(("plan", "command", "measured")):
        assert np.array_equal(force[:, index], signals[f"{kind}_force_z"])
    np.testing.assert_allclose(column(path, "/signals/force_z", "sim_time"), signals["time"], 0, 1e-12)
    zmp = column(path, "/residual/zmp", "Scalars:scalars")
    error = [signals[f"measured_zmp_{axis}"] - signals[f"plan_zmp_{axis}"] for axis in "xy"]
    np.testing.assert_allclose(zmp, 1e3 * np.stack(error, axis=1), rtol=0.0, atol=1e-9)


def test_segments_move_as_the_model_says(one):
    record, path = load_record(one), one / RunFile.RECORDING
    model = mujoco.MjModel.from_xml_string((one / "model.xml").read_text(encoding="utf-8"))
    data = mujoco.MjData(model)
    for name in ("pelvis", "left_foot"):
        places = column(path, f"/world/body/{name}", "Transform3D:translation")
        turns = column(path, f"/world/body/{name}", "Transform3D:quaternion")
        for row in (0, len(places) // 2, len(places) - 1):
            data.qpos[:] = record.q[row]
            mujoco.mj_kinematics(model, data)
            np.testing.assert_allclose(places[row, 0], data.body(name).xpos, atol=1e-6)
            turned = Rotation.from_quat(turns[row, 0]).as_matrix()
            np.testing.assert_allclose(turned.ravel(), data.body(name).xmat, atol=1e-5)


def test_a_recording_is_sound_small_and_has_what_a_viewer_must_show(walks, one, tmp_path):
    path = one / RunFile.RECORDING
    assert_rrd("verify", path)
    wanted = """world/follow world/plan/polygon world/plan/footprints world/floor/zmp/plan
        world/floor/zmp/measured world/force/plan world/force/measured world/force/left world/force/right
        world/com/measured/trail world/feet/left/sole phase/planned_stance verdict events effort/torque"""
    assert {f"/{name}" for name in [*wanted.split(), *DIFFERENCES]} <= entities(path)
    assert path.stat().st_size / load_record(one).outcome.time < 1e6
    again = write_recording(make_run(tmp_path / "run", steps=4))
    assert_rrd("compare", path, again)  # of an identical run
    assert identity(path) == identity(again) != identity(walks["slow"] / RunFile.RECORDING)
    assert last_static(path, "/__properties", "RecordingInfo:name") == ["normal, simulation.time_step 0.002"]
    os.truncate(again, 99)
    with pytest.raises(InputError, match=r"recording\.rrd has changed"):
        load_saved_run(again.parent)
    again.unlink()  # it can be drawn again
    assert load_saved_run(again.parent)


def test_several_runs_are_in_one_file_with_curves_in_a_colour_of_each(walks, tmp_path, ampm):
    target = tmp_path / "both.rrd"
    assert ampm("view", walks["one"], walks["two"], "--save", target).status == Status.PASS
    assert_rrd("verify", target)
    for letter, name in (("a", "one"), ("b", "two")):
        own = entities(walks[name] / RunFile.RECORDING)
        assert {f"/{letter}{entity}".rstrip("/") for entity in own} <= entities(target)
        shown = last_static(target, f"/{letter}/residual/zmp", "SeriesLines:names")
        assert shown == [f"{name} x", f"{name} y"]
    colours = [last_static(target, f"/{which}/signals/zmp_x", "SeriesLines:colors") for which in "ab"]
    assert not {*colours[0]} & {*colours[1]}
    assert ampm("view", walks["one"], "--save", target, "--force").status == Status.PASS  # as it is
    assert target.read_bytes() == (walks["one"] / RunFile.RECORDING).read_bytes()


def test_phases_of_different_gaits_coincide_and_data_is_not_touched(walks, tmp_path, ampm):
    target = tmp_path / "both.rrd"
    assert ampm("view", walks["one"], walks["slow"], "--save", target).status == Status.PASS
    signals = load_signals(walks["slow"] / "signals.parquet")
    values = column(target, "/b/signals/force_z", "Scalars:scalars")
    np.testing.assert_array_equal(values[:, 2], signals["measured_force_z"])
    for which, name in (("a", "one"), ("b", "slow")):
        plan = load_saved_run(walks[name]).plan()
        assert plan is not None
        seconds, phase = (column(target, f"/{which}/signals/zmp_x", line) for line in ("sim_time", PHASE))
        assert (np.diff(phase) > 0).all()
        starts = np.array([p.start for p in plan.contacts.phases])
        expected = np.arange(len(starts)) // 2 + np.where(np.arange(len(starts)) % 2, SINGLE_SUPPORT, 0.0)
        # The label of a phase begins at the first sample in it, one step of the simulation late at most.
        pace = 0.005
        np.testing.assert_allclose(np.interp(starts, seconds, phase), expected, atol=pace)
        assert phase[-1] == pytest.approx(4.0, abs=2 * pace)

"""The one table of results: its forms, and the tables of a run from one summary.

Figures, tables and citations for papers say what the page says, in the size that was asked.
"""

import json
import math
import os
import re
import zipfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from markupsafe import Markup

import validation as val
from tests.saved_run import make_run
from tests.sweep_table import make_table, write_sweep
from tests.test_report import Page
from validation.cli.validate import print_trial
from validation.judge.metrics import METRICS
from validation.judge.uncertainty import Uncertainty
from validation.show.cost_table import cost_table, reported_table
from validation.show.paper import UNSTUDIED
from validation.show.report import write_report
from validation.show.rerun.record import verdict_markdown
from validation.store.metric_table import metric_table
from validation.table import Table, with_uncertainty

SNAPSHOT = Path(__file__).with_name("run_tables.md")
TABLE = Table(
    "walk",
    ["metric", ">value", ""],
    [["signals", "", ""], ["zmp [mm]", "0.59", "pass"], ["a|<b>", "2", "FAIL"]],
    ["A note."],
)


def test_page_has_headings_colours_and_escapes():
    html = TABLE.__html__()
    assert Page(html).open == []
    assert '<th colspan="3" class="group">signals</th>' in html
    assert '<th scope="row">a|&lt;b&gt;</th><td class="n">2</td><td class="red">FAIL</td>' in html
    assert Table("t", ["x"], []).__html__() == ""
    assert '<th scope="row">pass</th>' in Table("t", ["better"], [["pass"]]).__html__()  # a walk's name


def test_latex_breaks_the_lines_of_long_cells():
    assert r"{@{}lp{.5\linewidth}@{}}" in Table("t", ["x", "y"], [["a", 71 * "b"]]).tex()


@pytest.mark.parametrize(
    ("value", "doubt", "text"),
    [
        (1.2004, 0.00241, "1.2004 ± 0.0024"),
        (123.4, 25.0, "123 ± 25"),
        (0.6000132, 3.7e-6, "0.6000132 ± 0.0000037"),
        (-2.6e-6, 1.6e-4, "0.00000 ± 0.00016"),
        (7e-13, 1.1e-12, "(0.7 ± 1.1)e-12"),
        (0.0, 3e-9, "(0.0 ± 3.0)e-9"),
        (0.6, None, "0.6"),
        (0.6, 0.0, "0.6 ± 0"),
        (0.6, math.inf, "0.6 ± ∞"),
        (math.inf, 0.1, "inf ± 0.1"),
    ],
)
def test_a_value_is_cut_at_the_second_digit_of_its_uncertainty(value, doubt, text):
    assert with_uncertainty(value, doubt) == text


@pytest.fixture
def said():
    """Contents of a ``summary.json`` with a metric of every kind of verdict, every margin and energy."""
    found = json.loads(Path(__file__).with_name("run_summary.json").read_text(encoding="utf-8"))
    numbers = {"margins": {"value": 0.5, "time": 1.25, "where": "left_knee_pitch"}, "energy": 2.0}
    for section, value in numbers.items():
        names = (item.name.partition("_")[2] for item in METRICS.values() if item.section == section)
        found[section] = {**dict.fromkeys(names, value), **found[section]}
    return found


def test_tables_of_a_run_are_those_of_the_snapshot(said):
    """``AMPM_SNAPSHOT=1 pytest tests/test_result_table.py`` writes it anew; look at the difference."""
    found = "\n".join(table(said).markdown() for table in (metric_table, cost_table, reported_table))
    if os.environ.get("AMPM_SNAPSHOT"):
        SNAPSHOT.write_text(found, encoding="utf-8")
    assert found == SNAPSHOT.read_text(encoding="utf-8")
    rows = set(re.findall(r"^\| (.*?) \|", found, re.MULTILINE))
    assert {item.label for item in METRICS.values() if item.section} <= rows
    for value, notes in ((1e-4, [True, False]), (-7e-3, [True])):  # the ZMP passes the ball, by 5 mm at most
        said["margins"]["plan_polygon"] = {"value": value, "time": 2.6, "where": ""}
        assert ["µs" in note for note in cost_table(said).notes] == notes


def test_terminal_and_recording_show_the_tables(said, capsys):
    print_trial(said, Path("run"))
    out = capsys.readouterr().out
    shown = [[cell.strip() for cell in line.split("│")[1:-1]] for line in out.splitlines() if "│" in line]
    tables = metric_table(said), cost_table(said)
    assert shown == [list(row) for table in tables for row in table.rows]
    assert "normal: FAIL  One is not met. ampm explain run says why." in out
    print_trial(said, Path("run"), wrote=False)  # judged by another profile
    print_trial({**said, "verdict": "undecided"}, Path("run"))
    assert "ampm explain" not in capsys.readouterr().out
    record = SimpleNamespace(outcome=SimpleNamespace(name="completed"), time_step=5e-4)
    saved: Any = SimpleNamespace(title="normal", summary=said, record=record, is_log=False)
    saved.table = lambda: tables[0]
    text = verdict_markdown(saved)
    assert text.startswith("# normal: ")
    assert "| unsolved QPs | 3 | 0 |  |  | FAIL |" in text
    assert "| ground force, RMS error along x | 0.9 ± inf | 0.8 | % BW | 112 % | undecided |" in text
    assert "Every time step (0.5 ms) is in `signals.parquet`." in text


COLUMN = 88.0 / 25.4 * 72.0  # [pt]


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory):
    return make_run(tmp_path_factory.mktemp("run") / "normal")


def _only(pattern, text):
    """The only group that is found."""
    found = re.search(pattern, text)
    assert found
    return next(filter(None, found.groups()))


@pytest.fixture(scope="module")
def page(run_dir):
    return write_report(run_dir).read_text(encoding="utf-8")


@pytest.mark.parametrize("form", ["pdf", "pgf"])
def test_every_figure_of_the_page_is_a_file_with_its_caption(run_dir, page, tmp_path, ampm, form):
    out = tmp_path / "paper"
    assert ampm("report", run_dir, "--figures", out, "--format", form).status == 0
    captions = (out / "captions.txt").read_text(encoding="utf-8").split("\n\n")[:-1]
    assert [caption.partition(".")[0] for caption in captions] == [f"Figure {n + 1}" for n in range(16)]
    assert re.findall("<figcaption>(.*?)</figcaption>", page) == [str(Markup.escape(c)) for c in captions]
    files = sorted(out.glob(f"figure-*.{form}"))
    assert len(files) == 16
    column, wide = (files[number].read_bytes() for number in (1, 0))
    for data, points in ((column, COLUMN), (wide, 2 * COLUMN + 5.0 / 25.4 * 72.0)):
        if form == "pdf":
            assert b"/FontFile" in data
        else:
            assert data.count(b"begin{pgfscope}") == data.count(b"end{pgfscope}") > 10
        width = _only(rb"MediaBox ?\[0 0 ([\d.]+)|origin}{.pgfqpoint{([\d.]+)bp", data)
        assert float(width) == pytest.approx(points, abs=1.0)
    cited = (out / "cite.txt").read_text(encoding="utf-8").strip()
    assert str(Markup.escape(cited)) in page
    assert cited.startswith("Run of 4 steps, gait normal, ")
    assert cited.count("planner") == 1
    assert re.search(r"sha256 = {[0-9a-f]{64}}", (out / "cite.bib").read_text(encoding="utf-8"))


def test_tables_have_the_uncertainty_of_a_study_or_say_that_there_is_none(run_dir, tmp_path, ampm):
    told = ampm("report", run_dir, "--tables", "md").out
    assert "ZMP, RMS error along x" in told
    assert UNSTUDIED in told
    known = Uncertainty("normal", 6, {"zmp_x_rmse": 8.3e-5})
    studied = make_run(tmp_path / "run", uncertainty=known)
    told = ampm("report", studied, "--tables", "tex").out
    assert re.search(r"ZMP, RMS error along x & 0\.\d{3} \$\\pm\$ 0\.083 & 2\.5 & mm", told)
    assert r"\toprule" in told
    assert "convergence study is known" not in told
    assert re.search(r"0\.\d{3} ± 0\.083,2\.5,mm", ampm("report", studied, "--tables", "csv").out)


def test_figures_of_a_sweep(tmp_path, ampm):
    folder = write_sweep(tmp_path / "sweep", make_table(20))
    out = tmp_path / "paper"
    assert ampm("report", folder, "--figures", out, "--format", "svg", "--tables", "tex").status == 0
    drawn = [path.read_text(encoding="utf-8") for path in sorted(out.glob("*.svg"))]
    widths = [float(_only(r'<svg [^>]*width="([\d.]+)pt"', text)) for text in drawn]
    assert len(widths) > 6
    assert widths == pytest.approx([COLUMN] * len(widths), abs=1.0)
    assert UNSTUDIED.split("(")[0] in (out / "tables.tex").read_text(encoding="utf-8")


def test_evidence_says_what_was_done_and_what_was_not(run_dir, tmp_path, ampm):
    file = tmp_path / "run.zip"
    assert ampm("report", run_dir, "--evidence", file).status == 0
    with zipfile.ZipFile(file) as bundle:
        linked = json.loads(bundle.read("evidence.jsonld"))
        page = bundle.read("evidence.html").decode()
        assert bundle.read("run.toml") == (run_dir / "run.toml").read_bytes()
    factors = {item["factorType"]: item for item in linked["hasCredibilityFactor"]}
    assert len(factors) == page.count('"unit">ASME-VV40-') + page.count('"unit">NASA-STD-') == 19
    assert (", with changes" in page) is json.loads((run_dir / "environment.json").read_text())["modified"]
    verified = factors["Numerical code verification"]["rationale"]
    assert "replay: identical" in verified
    assert "engine: not done" in verified
    for name in ("Discretization error", "Output comparison", "Results robustness", "Use error"):
        assert (factors[name]["factorStatus"], factors[name]["rationale"]) == ("not-assessed", "not done")
    assert page.count("NOT ASSESSED") == sum(item["rationale"] == "not done" for item in factors.values())
    for digest in json.loads((run_dir / "summary.json").read_text(encoding="utf-8"))["files"].values():
        assert digest in page


def test_evidence_takes_logs_and_studies_of_its_own_gait_alone(run_dir, tmp_path, ampm):
    logs = {}
    for name, settings in (("own", []), ("other", ["gait.c_y=0.4"])):
        trial = val.judge_log(run_dir, run_dir, settings=settings, start=0.0, place=(0.0, 0.0))
        logs[name] = trial.save(tmp_path / name, recording=False)
    answer = ampm("report", run_dir, "--evidence", file := tmp_path / "run.zip", "--study", logs["own"])
    assert answer.status == 0, answer.err
    with zipfile.ZipFile(file) as bundle:
        factors = json.loads(bundle.read("evidence.jsonld"))["hasCredibilityFactor"]
    said = {item["factorType"]: item["rationale"] for item in factors}
    assert "normal on normal" in said["Output comparison"]
    assert said["Use history"] == "not done"
    assert ampm("report", run_dir, "--evidence", file, "--force", *["--study", logs["own"]] * 2).status == 0
    with zipfile.ZipFile(file) as bundle:
        linked = bundle.read("evidence.jsonld").decode()
    assert linked.count("normal on normal") == 2 * json.dumps(factors).count("normal on normal")
    assert "--force" in ampm("report", run_dir, "--evidence", file).err
    answer = ampm("report", run_dir, "--evidence", file, "--force", "--study", logs["other"])
    assert "of the gait and body of normal" in answer.err
    answer = ampm("report", logs["own"], "--evidence", file, "--force")
    assert "is a log; give a walk of its plan" in answer.err
    numbers = {"walks": [{"label": n, "run": str(run_dir), "study": None, "robustness": None} for n in "ab"]}
    (tmp_path / "comparison.json").write_text(json.dumps(numbers), encoding="utf-8")
    answer = ampm("report", run_dir, "--evidence", file, "--force", "--study", tmp_path)
    assert "nor a comparison of engines" in answer.err

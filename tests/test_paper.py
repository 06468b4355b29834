"""Figures, tables and citations for papers: they say what the page says, in the size that was asked."""

import json
import re
import zipfile
from itertools import combinations
from xml.etree import ElementTree

import numpy as np
import pytest
from markupsafe import Markup

from ampm.exceptions import InputError
from tests.saved_run import make_run
from tests.sweep_table import make_table, write_sweep
from validation.judge.uncertainty import Uncertainty
from validation.show.chart import Chart, Picture
from validation.show.paper import UNSTUDIED, parse_width
from validation.show.style import PARTS, SHADE
from validation.table import Table, tex, with_uncertainty

COLUMN = 88.0 / 25.4 * 72.0  # [pt]


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory):
    return make_run(tmp_path_factory.mktemp("run") / "normal")


def _only(pattern, text):
    """The only group that is found."""
    found = re.search(pattern, text)
    assert found
    return next(filter(None, found.groups()))


@pytest.mark.parametrize("form", ["pdf", "svg", "pgf"])
def test_every_figure_of_the_page_is_a_file_with_its_caption(run_dir, tmp_path, ampm, form):
    out = tmp_path / "paper"
    assert ampm("report", run_dir, "--figures", out, "--format", form).status == 0
    assert ampm("report", run_dir).status == 0
    page = (run_dir / "report.html").read_text(encoding="utf-8")
    captions = (out / "captions.txt").read_text(encoding="utf-8").split("\n\n")[:-1]
    assert [caption.partition(".")[0] for caption in captions] == [f"Figure {n + 1}" for n in range(18)]
    assert re.findall("<figcaption>(.*?)</figcaption>", page) == [str(Markup.escape(c)) for c in captions]
    files = sorted(out.glob(f"figure-*.{form}"))
    assert len(files) == 18
    column, wide = (files[number].read_bytes() for number in (1, 0))
    for data, points in ((column, COLUMN), (wide, 2 * COLUMN + 5.0 / 25.4 * 72.0)):
        if form == "pdf":
            assert b"/FontFile" in data
        elif form == "svg":
            assert b"@font-face" in data
        else:
            assert data.count(b"begin{pgfscope}") == data.count(b"end{pgfscope}") > 10
        width = _only(
            rb'MediaBox ?\[0 0 ([\d.]+)|<svg [^>]*width="([\d.]+)pt|origin}{.pgfqpoint{([\d.]+)bp', data
        )
        assert float(width) == pytest.approx(points, abs=1.0)
    cited = (out / "cite.txt").read_text(encoding="utf-8").strip()
    assert str(Markup.escape(cited)) in page
    assert cited.startswith("Run of 4 steps, gait normal, ")
    assert re.search(r"sha256 [0-9a-f]{64}", (out / "cite.bib").read_text(encoding="utf-8"))


def test_tables_have_the_uncertainty_of_a_study_or_say_that_there_is_none(run_dir, tmp_path, ampm):
    told = ampm("report", run_dir, "--tables", "md").out
    assert "ZMP, RMS error along x" in told
    assert UNSTUDIED in told
    studied = make_run(tmp_path / "run", uncertainty=Uncertainty("normal", 6, {"zmp_x_rmse": 8.3e-5}))
    told = ampm("report", studied, "--tables", "tex").out
    assert r"ZMP, RMS error along x & 0.600 $\pm$ 0.083 & 2.5 & mm" in told
    assert r"\toprule" in told
    assert "convergence study is known" not in told
    assert "0.600 ± 0.083,2.5,mm" in ampm("report", studied, "--tables", "csv").out


def test_figures_of_a_sweep(tmp_path, ampm):
    folder = write_sweep(tmp_path / "sweep", make_table(20))
    out = tmp_path / "paper"
    assert ampm("report", folder, "--figures", out, "--format", "svg", "--tables", "tex").status == 0
    drawn = [path.read_text(encoding="utf-8") for path in sorted(out.glob("*.svg"))]
    widths = [float(_only(r'<svg [^>]*width="([\d.]+)"', text)) for text in drawn]
    assert widths == pytest.approx([COLUMN / 0.75], abs=1.0)
    assert UNSTUDIED.split("(")[0] in (out / "tables.tex").read_text(encoding="utf-8")
    refused = ampm("report", folder, "--figures", out, "--format", "pgf")
    assert (refused.status, "give --format pdf or svg" in refused.err) == (2, True)


@pytest.mark.parametrize(
    ("words", "why"),
    [
        ("--format gif", "--format gif is unknown; give pdf or svg or pgf."),
        ("--tables xls", "give tex or md or csv"),
        ("--figures DIR --width 3m", "is 3000 mm; give 40 to 300 mm"),
        ("--figures DIR --width wide", "is not a length"),
        ("--figures FILE", "is a file, not a folder"),
    ],
)
def test_what_cannot_be_written_is_refused_in_one_sentence(run_dir, tmp_path, ampm, words, why):
    (tmp_path / "FILE").touch()
    command = [str(tmp_path / word) if word.isupper() else word for word in words.split()]
    answer = ampm("report", run_dir, *command)
    assert answer.status == 2
    assert why in answer.err
    assert answer.err.count("\n") <= 2


def test_widths_in_any_unit():
    assert [parse_width(text) for text in ("88mm", "8.8 cm", "3.5in")] == pytest.approx([88.0, 88.0, 88.9])
    with pytest.raises(InputError):
        parse_width("-88mm")


@pytest.mark.parametrize(
    ("value", "uncertainty", "text"),
    [
        (0.5861, 0.0312, "0.586 ± 0.031"),
        (0.59, 0.0996, "0.59 ± 0.10"),
        (612.3, 41.0, "612 ± 41"),
        (5123.0, 412.0, "5120 ± 410"),
        (1.234, np.inf, "1.23 ± ∞"),
        (1.234, None, "1.23"),
        (None, 0.1, "–"),
    ],
)
def test_digits_are_cut_where_the_uncertainty_ends(value, uncertainty, text):
    assert with_uncertainty(value, uncertainty) == text


def test_texts_for_latex():
    assert tex("a_b 5 % x² ≤ −1 --set") == r"a\_b 5 \% x$^2$ ≤ $-$1 -{}-set"
    assert Table("t", ("m", ">v"), [("head", ""), ("x", "1")]).tex().count(r"\multicolumn{2}") == 1


def test_a_narrow_picture_keeps_its_letters_and_wraps_its_words():
    chart = Chart(45.0, 30.0, 320.0, 100.0, "a title of many words that a column of a paper does not hold")
    chart.line([0.0, 1.0], [0.0, 1.0], "#000000", label="a long label")
    chart.line([0.0, 1.0], [1.0, 0.0], "#000000", label="another long label of a curve")
    below = Chart(45.0, 190.0, 320.0, 50.0, "b")
    drawn = ElementTree.fromstring(Picture([chart, below], "x").svg(180.0))
    words = [(item.text, float(item.get("y", "nan"))) for item in drawn.iterfind("{*}text")]
    assert drawn.get("width") == "180pt"
    assert {item.get("font-size") for item in drawn.iterfind("{*}text")} == {"8", "9"}
    assert len({y for text, y in words if text and "label" in text}) == 2
    assert min(y for _, y in words) >= 0.0


def test_colours_differ_in_grey():
    def lightness(color):  # L* of CIELAB
        linear = [((int(color[k : k + 2], 16) / 255 + 0.055) / 1.055) ** 2.4 for k in (1, 3, 5)]
        return 116.0 * float(np.dot([0.2126, 0.7152, 0.0722], linear)) ** (1 / 3) - 16.0

    for one, two in combinations((*PARTS, SHADE), 2):
        assert abs(lightness(one) - lightness(two)) > 12.0


def test_evidence_says_what_was_done_and_what_was_not(run_dir, tmp_path, ampm):
    file = tmp_path / "run.zip"
    assert ampm("report", run_dir, "--evidence", file).status == 0
    with zipfile.ZipFile(file) as bundle:
        linked = json.loads(bundle.read("evidence.jsonld"))
        page = bundle.read("evidence.html").decode()
        assert bundle.read("run.toml") == (run_dir / "run.toml").read_bytes()
    factors = {item["factorType"]: item for item in linked["hasCredibilityFactor"]}
    assert len(factors) == 19
    verified = factors["Numerical code verification"]["rationale"]
    assert "replay: identical" in verified
    assert "engine: not done" in verified
    for name in ("Discretization error", "Output comparison", "Results robustness", "Use error"):
        assert (factors[name]["factorStatus"], factors[name]["rationale"]) == ("not-assessed", "not done")
    assert page.count("NOT ASSESSED") == sum(item["rationale"] == "not done" for item in factors.values())
    for digest in json.loads((run_dir / "summary.json").read_text(encoding="utf-8"))["files"].values():
        assert digest in page
    for words, why in ((["--study", run_dir], "is a walk"), ([], "must end in .zip")):
        refused = ampm("report", run_dir, "--evidence", file if words else tmp_path / "run.tar", *words)
        assert refused.status == 2
        assert why in refused.err

"""Figures, captions, tables and citation of a result as files for a paper."""

import hashlib
import re
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from ampm.exceptions import InputError
from validation.show.chart import Picture
from validation.store.folders import check_target, write_whole
from validation.store.json import dump_json
from validation.store.metric_table import walk_title
from validation.store.saved import SavedRun, digests
from validation.table import Table, tex

FORMATS, TABLES = ("pdf", "svg", "pgf"), ("tex", "md", "csv")
"""Formats of figures and of tables."""
NARROWEST, WIDEST, GUTTER = 80.0, 300.0, 5.0
"""Bounds of the width of a figure, and room between two columns, which wide figures span [mm]."""
_TEXT_WIDTH = 190.0  # most that a wide figure spans, unless a column is wider [mm]
_UNITS = {"mm": 1.0, "cm": 10.0, "in": 25.4, "pt": 25.4 / 72.27, "m": 1000.0}
_POINT = 25.4 / 72.0  # of PDF and SVG [mm]
STUDIED = "±: numerical uncertainty by a convergence study."
UNSTUDIED = (
    "No convergence study is known: the values have no numerical uncertainty ('ampm convergence', then "
    "'ampm validate --uncertainty')."
)


class Citation(NamedTuple):
    """How a result is cited."""

    text: str  # one line
    bibtex: str  # entry of a bibliography


class Paper(NamedTuple):
    """Figures and tables in the order of the page, and how to cite the runs."""

    figures: Sequence[Picture]
    tables: Sequence[Table]
    citations: Sequence[Citation]


def parse_width(text: str) -> float:
    """A width such as ``88mm`` in millimetres; raises InputError of no length, or of one that no page has."""
    found = re.fullmatch(r"\s*(\d+\.?\d*|\.\d+)\s*(mm|cm|in|pt|m)\s*", text)
    width = float(found[1]) * _UNITS[found[2]] if found else 0.0
    if not NARROWEST <= width <= WIDEST:
        what = f"is {width:g} mm" if found else "is not a length"
        raise InputError(
            f"--width {text} {what}; give {NARROWEST:g} to {WIDEST:g} mm, such as 88mm, 3.5in or 252pt."
        )
    return width


def cite(what: str, environment: Mapping[str, Any], digest: str) -> Citation:
    """How to cite what was computed, in this environment, with the SHA-256 of its files."""
    version = environment.get("versions", {}).get("ampm") or "of unknown version"
    commit = str(environment.get("revision") or "unknown")[:12]
    changed = ", with changes" if environment.get("modified") else ""
    day = str(environment.get("time", ""))[:10]
    software = f"AMPM testbed {version}, commit {commit}{changed}"
    lines = [
        f"@misc{{ampm-{digest[:8]},",
        "  author = {{The AMPM testbed authors}},",
        f"  title = {{{{{tex(what)}}}}},",
        f"  year = {{{day[:4]}}},",
        f"  note = {{{tex(software)}; computed {day}; sha256 {digest[:16]}}},",
        f"  sha256 = {{{digest}}},",
        "}\n",
    ]
    return Citation(f"{what}. {software}. Computed {day}, sha256 {digest[:16]}.", "\n".join(lines))


def digest_of(saved: SavedRun) -> str:
    """SHA-256 of the digests of all files of a run."""
    return hashlib.sha256(dump_json(digests(saved.directory, saved.summary)).encode()).hexdigest()


def cite_run(saved: SavedRun) -> Citation:
    """How to cite a run, with its digest."""
    summary, run = saved.summary, saved.parameters
    body = f"{Path(run.body.source).stem}, {run.body.height:.3g} m, {saved.record.mass:.3g} kg"
    names = f"planner {summary.get('planner') or 'ampm'}, controller {summary.get('controller') or 'ampm'}"
    how = names.partition(",")[0] if saved.is_log else f"{names}, {run.simulation.engine}"
    steps = saved.record.outcome.steps_completed
    what = "Log beside" if saved.is_log else f"Run of {steps} step{'s' * (steps != 1)},"
    changed = {key: value for key, value in summary.get("changed", {}).items() if key != "body.source"}
    gait = walk_title({**summary, "changed": changed, "planner": ""})
    return cite(f"{what} gait {gait}, body {body}, {how}", summary["environment"], digest_of(saved))


def write_paper(
    folder: Path, paper: Paper, *, form: str, width: float, table_form: str | None, force: bool
) -> None:
    """Write everything into a folder; with ``force`` into one that is not empty, where equal names go.

    Figures have one of the :data:`FORMATS` and the width of a column [mm], wide ones of two; tables have one
    of :data:`TABLES`, or are left out. Raises :class:`InputError` if the folder is a file, is not empty, or
    cannot be written.
    """
    check_target(folder, None, force=force, way_out="--force to replace files in it")
    two = max(width, min(2.0 * width + GUTTER, _TEXT_WIDTH))
    files: dict[str, str | bytes] = {
        "captions.txt": "".join(f"{figure.text}\n\n" for figure in paper.figures),
        "cite.txt": "".join(f"{item.text}\n" for item in paper.citations),
        "cite.bib": "\n".join(item.bibtex for item in paper.citations),
    }
    if table_form:
        files[f"tables.{table_form}"] = as_text(paper.tables, table_form)
    for figure in paper.figures:
        words = re.sub(r"\W+", " ", figure.label.lower())
        slug = textwrap.shorten(words, 40, placeholder="").replace(" ", "-")
        points = (two if figure.wide else width) / _POINT
        files[f"figure-{figure.number:02d}-{slug}.{form}"] = figure.as_file(form, points)
    for name, content in files.items():
        write_whole(folder / name, content)


def as_text(tables: Sequence[Table], form: str) -> str:
    """Tables in one of the formats :data:`TABLES`, one after another."""
    write = {"tex": Table.tex, "csv": Table.csv, "md": lambda table: f"**{table.title}**\n\n{table}\n"}
    return "\n".join(write[form](table) for table in tables if table.rows)

"""What a paper takes from the folder of a run, a comparison or a sweep."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from validation.show.cost_table import cost_table
from validation.show.paper import STUDIED, UNSTUDIED, Paper, cite_run
from validation.show.report import split_table, write_report
from validation.show.run_figures import RunFigures
from validation.store.saved import load_saved_run
from validation.study.compare.report import draw_walks, is_comparison, load_comparison, write_comparison
from validation.study.sweep.figures import draw_sweep
from validation.study.sweep.report import cite_sweep, sweep_metric_table, write_sweep_report
from validation.study.sweep.table import is_sweep, read_sweep
from validation.table import Table


def load_paper(folder: Path) -> Paper:
    """Read a folder; raises InputError if it holds no run, comparison of walks, or sweep, or is damaged."""
    if is_sweep(folder):
        sweep = read_sweep(folder)
        tables = [sweep_metric_table(sweep), *sweep.tables()]
        return Paper(draw_sweep(sweep), _noted(tables, studied=False), [cite_sweep(sweep)])
    if is_comparison(folder):
        found = load_comparison(folder)
        tables, studied = found.tables(), all(side.study for side in found.sides)
        citations = [cite_run(side.run) for side in found.sides]
        return Paper(draw_walks(found.sides)[1], _noted(tables, studied=studied), citations)
    saved = load_saved_run(folder)
    sections = RunFigures(saved, saved.plan()).sections() if len(saved.signals) > 1 else {}
    pictures = [picture for pictures in sections.values() for picture in pictures]
    tables = [saved.table(), cost_table(saved.summary), split_table(saved.summary["zmp_error_split"])]
    return Paper(pictures, _noted(tables, studied="uncertainty" in saved.summary), [cite_run(saved)])


def _noted(tables: Sequence[Table], *, studied: bool) -> list[Table]:
    """Tables of which the first says whether its values have an uncertainty."""
    first, *others = tables
    known = any("±" in cell for row in first.rows for cell in row)
    note = STUDIED if studied else UNSTUDIED
    return [first if known else replace(first, notes=[*first.notes, note]), *others]


def write_page(folder: Path) -> Path:
    """Write the page of a folder again from its files; returns its path. Raises as :func:`load_paper`."""
    if is_sweep(folder):
        return write_sweep_report(folder)
    if is_comparison(folder):
        return write_comparison(load_comparison(folder), folder)
    return write_report(folder)

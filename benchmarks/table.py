"""One table of a benchmark, for the terminal and for the documentation."""

from pathlib import Path

from benchmarks.run import BenchmarkResult
from validation.show.text import replace_between
from validation.table import Table

DOCUMENT = Path(__file__).resolve().parents[1] / "docs" / "benchmarks.md"
MARK = "benchmark table"
"""Between the marks of this name the page has the table."""

HEADER = ("", ">median", ">p99", ">of the loop")
ON_PAGE = {
    "plan, closed form",
    "periodic motion",
    "tick of the inverse kinematics",
    "closed loop, one control period",
    "control tick",
    "QP: update and solve",
    "physics alone, one control period",
    "planning, simulation, measurement",
    "recording",
    "report",
    "memory peak",
}
"""Lines of the document's table; the terminal's has all."""
_NO_CELLS = ("",) * (len(HEADER) - 1)


def conditions(result: BenchmarkResult) -> str:
    """One sentence on gait, machine and versions of the measurement."""
    known = result.environment
    titles = {"MuJoCo": "mujoco", "Pinocchio": "pin", "OSQP": "osqp", "numpy": "numpy"}
    versions = ", ".join(f"{title} {known['versions'][name]}" for title, name in titles.items())
    return (
        f"{' '.join([result.gait, *result.settings])}, {result.steps} steps; {known['processor']}, one of "
        f"{known['cores']} cores, load {result.load:.1f} at the start; Python {known['python']}, {versions}."
    )


def table(result: BenchmarkResult) -> Table:
    """The table, with the conditions of the measurement as its note."""
    rows: list[tuple[str, ...]] = []
    for heading, lines in result.sections.items():
        rows += [(heading, *_NO_CELLS), *(line.cells() for line in lines)]
    return Table("benchmark", HEADER, rows, [conditions(result)])


def page_table(result: BenchmarkResult) -> Table:
    """The document's table: medians of some lines, those of a walk with the first solver."""
    lines = [line for section in result.sections.values() for line in section]
    first = {line.name: line.cells()[:2] for line in reversed(lines) if line.name in ON_PAGE}
    return Table("", HEADER[:2], [*reversed(first.values())], [conditions(result)])


def update_document(result: BenchmarkResult, document: Path = DOCUMENT) -> None:
    """Replace the table between the marks of a Markdown file.

    Raises:
        ValueError: the file has no marks.
    """
    text = document.read_text(encoding="utf-8")
    shown = page_table(result).markdown()
    document.write_text(replace_between(text, MARK, f"\n{shown}\n"), encoding="utf-8")

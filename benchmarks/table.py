"""One table of a benchmark, for the terminal and for the documentation."""

from pathlib import Path

from benchmarks.run import BenchmarkResult
from validation.show.text import replace_between
from validation.table import Table

DOCUMENT = Path(__file__).resolve().parents[1] / "docs" / "benchmarks.md"
MARK = "benchmark table"
"""Between the marks of this name the page has the table."""

HEADER = ("", ">median", ">p99", ">of the loop")
_NO_CELLS = ("",) * (len(HEADER) - 1)


def conditions(result: BenchmarkResult) -> str:
    """One sentence on gait, machine and versions of the measurement."""
    known = result.environment
    titles = {"MuJoCo": "mujoco", "Pinocchio": "pin", "OSQP": "osqp", "numpy": "numpy"}
    versions = ", ".join(f"{title} {known['versions'][name]}" for title, name in titles.items())
    peak = "unknown" if result.memory_peak is None else f"{result.memory_peak:.0f} MB"
    return (
        f"{' '.join([result.gait, *result.settings])}, {result.steps} steps; {known['processor']}, one of "
        f"{known['cores']} cores, load {result.load:.1f} at the start; Python {known['python']}, {versions}; "
        f"memory peak {peak}."
    )


def table(result: BenchmarkResult) -> Table:
    """The table, with the conditions of the measurement as its note."""
    rows: list[tuple[str, ...]] = []
    for heading, lines in result.sections.items():
        rows += [(heading, *_NO_CELLS), *(line.cells() for line in lines)]
    return Table("benchmark", HEADER, rows, [conditions(result)])


def update_document(result: BenchmarkResult, document: Path = DOCUMENT) -> None:
    """Replace the table between the marks of a Markdown file.

    Raises:
        ValueError: the file has no marks.
    """
    text = document.read_text(encoding="utf-8")
    document.write_text(replace_between(text, MARK, f"\n{table(result).markdown()}\n"), encoding="utf-8")

"""The measurements on the page of the documentation, and what stands between marks of a page."""

from pathlib import Path

from validation.store.environment import describe_environment

PAGE = Path(__file__).resolve().parents[1] / "docs" / "benchmarks.md"


def conditions(title: str, load: float) -> str:
    """One sentence on gait, machine and versions of a measurement.

    Args:
        title: of the gait.
        load: of the machine at the start, mean of the last minute [1].
    """
    known = describe_environment()
    names = ("mujoco", "pin", "osqp")
    versions = ", ".join(f"{name} {known['versions'][name]}" for name in names)
    return (
        f"{title}; {known['processor']}, one of {known['cores']} cores, load {load:.1f} at the start; "
        f"Python {known['python']}, {versions}."
    )


def write_page(mark: str, text: str) -> None:
    """Replace what stands between the marks of a name on the page; ValueError if it has none."""
    PAGE.write_text(replace_between(PAGE.read_text(encoding="utf-8"), mark, f"\n{text}\n"), encoding="utf-8")


def replace_between(page: str, name: str, text: str) -> str:
    """A page with new text between its marks ``<!-- name -->`` and ``<!-- end of name -->``."""
    head, first, rest = page.partition(f"<!-- {name} -->\n")
    _, last, tail = rest.partition(f"\n<!-- end of {name} -->")
    if not (first and last):
        raise ValueError(f"the page lacks the marks of {name!r}")
    return f"{head}{first}{text}{last}{tail}"

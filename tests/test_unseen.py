"""docs/unseen.md shows what its data hold, and the data are those of the draws; the walks take an hour."""

import csv
import sys
from importlib import import_module
from pathlib import Path

import pytest

from validation.study.sweep.design import load_sweep

DOCS = Path(__file__).resolve().parents[1] / "docs"


@pytest.fixture(scope="module")
def unseen():
    """The script that makes both."""
    sys.path.insert(0, str(DOCS))
    yield import_module("unseen")
    sys.path.remove(str(DOCS))


@pytest.fixture(scope="module")
def rows(unseen):
    with unseen.FILE.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_the_page_shows_the_data(unseen, rows):
    page = unseen.PAGE.read_text(encoding="utf-8")
    for table in (unseen.outcomes(rows), unseen.refusals(rows)):
        assert table.markdown() in page


def test_the_data_are_of_the_draw(unseen, rows):
    draw = load_sweep(DOCS / "examples" / "unseen.toml")
    sensed = unseen.changed(draw, unseen.SENSED)
    counts = {unseen.HUMAN: 100, unseen.HUMAN_ESTIMATED: 100}
    counts |= dict.fromkeys((unseen.DRAKE, unseen.HUMAN_SENSED), unseen.IN_BOTH)
    for name, count in counts.items():
        found = unseen.of_draw(rows, name)
        assert len(found) == count
        for row in found:
            values = draw.varied(int(row["gait"]))
            assert values == sensed.varied(int(row["gait"]))
            for key, title in unseen.DRAWN.items():
                assert float(row[title]) == pytest.approx(values[key], abs=6e-4)
    assert all(sensed.parameters(0).value(key) == value for key, value in unseen.SENSED.items())

"""The one table of results, in its forms."""

import pytest

from validation.table import Table, print_tables

TABLE = Table(
    "walk", ["metric", ">value", ""], [["zmp [mm]", "0.59", "pass"], ["a|b", "2", "FAIL"]], ["A note."]
)


def test_markdown_has_alignment_escapes_and_notes():
    lines = TABLE.markdown().splitlines()
    assert lines[:2] == ["| metric | value |  |", "| --- | ---: | --- |"]
    assert lines[3] == "| a\\|b | 2 | FAIL |"
    assert lines[-1] == "A note."


def test_terminal_prints_cells_as_they_are(capsys):
    print_tables([TABLE])
    out = capsys.readouterr().out
    assert "zmp [mm]" in out
    assert out.splitlines()[0] == "walk"
    assert out.splitlines()[-1] == "A note."


def test_html_escapes():
    assert "<td>&lt;b&gt;</td>" in Table("t", ["x"], [["<b>"]])._repr_html_()


def test_rows_must_fit():
    with pytest.raises(ValueError, match="2 cells for 1 columns"):
        Table("t", ["x"], [["1", "2"]])

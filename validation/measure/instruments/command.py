"""``ampm instrument``: a finished run as an instrument would have shown it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import mujoco

from ampm.exceptions import InputError
from ampm.parameters import load_run
from validation.measure.instruments.model import Instrument
from validation.measure.instruments.result import Observation, observe, run_key
from validation.measure.instruments.table import cause_rows, draw, error_rows, observation_columns
from validation.show.text import print_line, print_table
from validation.store.folders import check_folder_of, check_output_file, output_file
from validation.store.tables import check_suffix, write_columns
from validation.trial.record import load_record

if TYPE_CHECKING:
    from ampm.description import BodyDescription

PICTURES = (".png", ".svg")
_COLUMNS = [("", "left"), ("RMSE x", "right"), ("y", "right"), ("largest x", "right"), ("y", "right")]


def observe_folder(directory: Path, instrument: Instrument) -> Observation:
    """Look at a finished run with an instrument, from its folder alone.

    Raises:
        InputError: the folder is no run folder, or lacks what the instrument needs.
    """
    missing = [name for name in ("run.toml", "model.xml") if not (directory / name).is_file()]
    if missing:
        raise InputError(f"{directory} has no {missing[0]}; give the folder of a finished run.")
    run = load_run(directory / "run.toml", ())

    def body() -> tuple[mujoco.MjModel, BodyDescription]:
        from models.human import build

        xml = (directory / "model.xml").read_text(encoding="utf-8")
        return mujoco.MjModel.from_xml_string(xml), build(run.body, run.contact, run.simulation).description

    return observe(instrument, load_record(directory), run_key(run), body)


def check_targets(plot: Path | None, out: Path | None, *, force: bool) -> None:
    """Refuse files that cannot or must not be written, before anything is computed.

    Raises:
        InputError: another suffix, no such folder, or ``out`` exists and ``force`` is off.
    """
    if plot is not None:
        if plot.suffix not in PICTURES:
            raise InputError(f"{plot} must end in {' or '.join(PICTURES)}; the suffix chooses the format.")
        check_folder_of(plot)
        check_output_file(plot, force=True)
    if out is not None:
        check_suffix(out)
        check_output_file(out, force=force)


def write_files(seen: Observation, plot: Path | None, out: Path | None, *, force: bool) -> list[Path]:
    """Write what is asked for; a picture is drawn over an earlier one, as it can be drawn again at once."""
    if out is not None:
        with output_file(out, force=force) as work:
            write_columns(observation_columns(seen), work)
    if plot is not None:
        with output_file(plot) as work:
            draw(seen).savefig(work, dpi=130)
    return [path for path in (out, plot) if path is not None]


def print_observation(seen: Observation) -> None:
    """Print the error and its causes."""
    name, found = seen.instrument.name, seen.as_dict()
    print_table(f"{name}: error that it adds to the ZMP, mm", _COLUMNS, error_rows(found))
    print_table("each cause alone, whole walk, mm", _COLUMNS, cause_rows(found))
    print_line(f"  latency           {1e3 * seen.latency:.3g} ms")
    error = seen.errors["run"]
    if error.unmeasured:
        print_line(f"  no ZMP            at {error.unmeasured} of {error.count + error.unmeasured} instants")
    for note in seen.notes:
        print_line(f"  {note}")

"""``ampm instrument``: a finished run as an instrument would have shown it.

Commands import what they run: simulator, Pinocchio and NumPy take long to load.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ampm.exceptions import InputError
from validation.cli.console import Narrator
from validation.cli.options import Force, Json, RunFolder, Status, answer, option
from validation.show.text import print_line, print_table

if TYPE_CHECKING:
    from validation.measure.instruments.observe import Observation

app = typer.Typer()

PICTURES = (".png", ".svg")
_COLUMNS = ("", ">RMSE x", ">y", ">largest x", ">y")


@app.command()
def instrument(
    directory: RunFolder,
    name: Annotated[
        str,
        option("--instrument", "force-plate, foot-ft, imu, or a TOML file of your own.", "NAME|FILE"),
    ] = "force-plate",
    plot: Annotated[Path | None, option("--plot", "Draw the ZMP, its error, its causes.", "FILE.png")] = None,
    out: Annotated[
        Path | None, option("--out", "Write truth and readings at every step.", "FILE.parquet|.csv")
    ] = None,
    force: Force = False,
    as_json: Json = False,
) -> int:
    """Show a finished run as an instrument would have shown it, and which of its faults matters.

    A model of force plates, foot force/torque sensors or an IMU is put beside the simulator's truth: noise,
    bias, cross-talk, low-pass, sampling, delay, range and resolution. Nothing is simulated again, and nothing
    is judged: the status is 0.
    """
    # Here, not above: NumPy, SciPy and pyarrow take long to load.
    from validation.measure.instruments.model import load_instrument
    from validation.measure.instruments.observe import Observation, observe_folder
    from validation.store.folders import check_folder_of, check_output_file, output_file
    from validation.store.tables import check_suffix, write_columns

    if plot is not None:
        if plot.suffix not in PICTURES:
            raise InputError(f"{plot} must end in {' or '.join(PICTURES)}; the suffix chooses the format.")
        check_folder_of(plot)
        check_output_file(plot, force=True)  # it can be drawn again at once
    if out is not None:
        check_suffix(out)
        check_output_file(out, force=force)
    observed = observe_folder(directory, load_instrument(name))
    if out is not None:
        with output_file(out, force=force) as work:
            write_columns(observed.signal_columns(), work)
    if plot is not None:
        from validation.show.instrument import draw  # loads matplotlib

        draw(observed, plot)
    answer(observed, Observation.as_dict, print_observation, as_json=as_json)
    Narrator().wrote(out, plot)
    return Status.PASS


def print_observation(observed: Observation) -> None:
    """Print the error and its causes."""
    from validation.show.instrument import cause_rows, error_rows

    name, found = observed.instrument.name, observed.as_dict()
    print_table(f"{name}: error that it adds to the ZMP, mm", _COLUMNS, error_rows(found))
    print_table("each cause alone, whole walk, mm", _COLUMNS, cause_rows(found))
    print_line(f"  latency           {1e3 * observed.latency:.3g} ms")
    error = observed.errors["run"]
    if error.unmeasured:
        print_line(f"  no ZMP            at {error.unmeasured} of {error.count + error.unmeasured} instants")
    for note in observed.notes:
        print_line(f"  {note}")

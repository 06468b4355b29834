"""Force plates and points of a C3D file, read by ezc3d."""

from pathlib import Path
from typing import Any

import ezc3d
import numpy as np

from ampm.exceptions import InputError
from ampm.geometry import Array
from validation.measure.log import UNITS

_LEAST = 10.0  # vertical force with a centre of pressure [N]
_BIG_ENDIAN = 86  # type of processor


def read(path: Path) -> dict[str, Any]:
    """Columns of a C3D file whose z is up, in SI units.

    Returns:
        ``time`` of the analog samples; ``force_x`` ... and ``zmp_x``, ``zmp_y`` of all plates;
        ``plate1_force_x`` ..., ``plate1_cop_x``, ``plate1_cop_y`` and others; each point by its label, such
        as ``SACR_x``, NaN where it was not seen, or the plates' column of that name. Forces act on the body.

    Raises:
        InputError: no C3D file, or one that is cut off, or without force plates or a unit of lengths.
    """
    try:
        file = ezc3d.c3d(str(path), extract_forceplat_data=True)
    except (OSError, ValueError, RuntimeError) as error:
        raise InputError(f"{path} cannot be read as C3D ({error}); give one that ezc3d reads.") from error
    plates = file["data"]["platform"]
    if not plates:
        raise InputError(f"{path} has no force plates; a log needs the force of the floor.")
    points, of = file["data"]["points"], file["parameters"]["POINT"]
    unit = "".join(of.get("UNITS", {"value": []})["value"][:1]).strip().lower()  # of the plates, too
    if unit not in UNITS[""]:
        raise InputError(f"{path}: POINT:UNITS is {unit!r}; write m, cm or mm, the unit of lengths, into it.")
    data = path.read_bytes()  # ezc3d takes the frames that are there, and changes the header to them
    order = ">u2" if data[512 * (data[0] - 1) + 3] == _BIG_ENDIAN else "<u2"
    first, last = np.frombuffer(data, order, 2, 6).tolist()
    if points.shape[2] <= last - first:
        wanted = last - first + 1
        raise InputError(f"{path} is cut off after {points.shape[2]} of {wanted} frames; give all of it.")
    rate, scale = file["header"]["analogs"]["frame_rate"], UNITS[""][unit]
    table: dict[str, Any] = {"time": np.arange(plates[0]["force"].shape[1]) / rate}
    seen_at = np.arange(points.shape[2]) / file["header"]["points"]["frame_rate"]
    for label, place in zip(of["LABELS"]["value"], points[:3].swapaxes(0, 1), strict=False):
        _add(table, label, np.array([np.interp(table["time"], seen_at, scale * row) for row in place]))
    # Some hold the force on the plate.
    sign = np.sign(sum(plate["force"][2].mean() for plate in plates)) or 1.0
    total, lever, held = (np.zeros((axes, len(table["time"]))) for axes in (3, 2, 1))
    for number, plate in enumerate(plates, start=1):
        force = sign * plate["force"]
        place = scale * plate["center_of_pressure"][:2]
        load = np.where(force[2] > _LEAST, force[2], 0.0)
        _add(table, f"plate{number}_force", force)
        _add(table, f"plate{number}_cop", np.where(load, place, np.nan))
        total += force
        lever += load * np.nan_to_num(place)
        held += load
    _add(table, "force", total)
    _add(table, "zmp", lever / np.where(held, held, np.nan))
    return table


def _add(table: dict[str, Any], name: str, values: Array) -> None:
    """Columns of a vector, shape (n, K)."""
    table.update({f"{name}_{axis}": column for axis, column in zip("xyz", values, strict=False)})

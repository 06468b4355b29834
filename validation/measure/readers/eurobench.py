"""A run of EUROBENCH's format: joint angles and wrenches of both feet, with a model of the robot."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pyarrow.csv
from scipy.spatial.transform import Rotation

from ampm.exceptions import InputError

_FILES = {"left": "ftl.csv", "right": "ftr.csv"}


def read_eurobench(folder: str | Path, model: pin.Model, soles: Mapping[str, str]) -> dict[str, Any]:
    """Read ``pos.csv``, ``ftl.csv`` and ``ftr.csv`` as columns of a log, with COM and soles by kinematics.

    Args:
        folder: of the run.
        model: of the robot with a free flyer, its joints named as the columns of ``pos.csv``.
        soles: frames by ``left`` and ``right``: the places at which the wrenches act, in the world's axes.

    Raises:
        InputError: a file, a column or a frame is missing.
    """
    try:
        position = _read(Path(folder) / "pos.csv")
        time, states = position["time"], np.tile(pin.neutral(model), (len(position["time"]), 1))
        states[:, :3] = np.column_stack([position[f"base_link_t{axis}"] for axis in "xyz"])
        turns = np.column_stack([position[f"base_link_r{axis}"] for axis in "zyx"])
        states[:, 3:7] = Rotation.from_euler("ZYX", turns).as_quat()
        for name, joint in zip(model.names, model.joints, strict=True):
            if joint.nq == 1:
                states[:, joint.idx_q] = position[name]
        wrenches = {side: _read(Path(folder) / name) for side, name in _FILES.items()}
        loads = {
            f"{side}_sensor_{key}_{axis}": np.interp(time, wrench["time"], wrench[f"{key}_{axis}"])
            for side, wrench in wrenches.items()
            for key in ("force", "torque")
            for axis in "xyz"
        }
    except KeyError as error:
        raise InputError(f"{folder} has no column {error.args[0]!r}; give it, or another model.") from None
    if missing := [name for name in soles.values() if not model.existFrame(name)]:
        raise InputError(f"the model has no frame {missing[0]!r}; give the names of its soles.")
    data, places = model.createData(), np.zeros((len(time), 3, 3))
    for k, state in enumerate(states):
        places[k, 0] = pin.centerOfMass(model, data, state)
        for i, side in enumerate(_FILES, start=1):
            places[k, i] = pin.updateFramePlacement(model, data, model.getFrameId(soles[side])).translation
    names = ("com", *(f"{side}_sensor" for side in _FILES))
    table = {
        f"{name}_{axis}": places[:, i, k] for i, name in enumerate(names) for k, axis in enumerate("xyz")
    }
    on_left = loads["left_sensor_force_z"] > loads["right_sensor_force_z"]
    floor = np.where(on_left, table["left_sensor_z"], table["right_sensor_z"])
    return {"time": time, "floor": floor, **loads, **table}


def _read(path: Path) -> dict[str, Any]:
    """Columns of a table separated by semicolons."""
    try:
        table = pyarrow.csv.read_csv(path, parse_options=pyarrow.csv.ParseOptions(delimiter=";"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path} cannot be read ({error}); give a table separated by semicolons.") from error
    return {name: table[name].to_numpy() for name in table.column_names}

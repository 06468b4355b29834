"""A run of EUROBENCH's format: joint angles and wrenches of both feet, with a model of the robot."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from ampm.exceptions import InputError
from validation.trial.users import read_columns

_FEET = {"left": "ftl", "right": "ftr"}


def read_run(folder: str | Path, model: pin.Model, soles: Mapping[str, str]) -> dict[str, Any]:
    """Read ``pos.csv``, ``ftl.csv`` and ``ftr.csv`` as columns of a log, with COM and soles by kinematics.

    Args:
        folder: of the run.
        model: of the robot with a free flyer, its joints named as the columns of ``pos.csv``.
        soles: frames by ``left`` and ``right``: the places at which the wrenches act, in the world's axes.

    Raises:
        InputError: a file, a column or a frame is missing.
    """
    files = {name: read_columns(Path(folder) / f"{name}.csv") for name in ("pos", *_FEET.values())}
    if missing := [name for name in soles.values() if not model.existFrame(name)]:
        raise InputError(f"the model has no frame {missing[0]!r}; give the names of its soles.")
    table: dict[str, Any] = {"time": (time := files["pos"]["time"])}
    states = np.tile(pin.neutral(model), (len(time), 1))
    try:
        states[:, :3] = np.column_stack([files["pos"][f"base_link_t{axis}"] for axis in "xyz"])
        turns = np.column_stack([files["pos"][f"base_link_r{axis}"] for axis in "zyx"])
        states[:, 3:7] = Rotation.from_euler("ZYX", turns).as_quat()
        for name, joint in list(zip(model.names, model.joints, strict=True))[1:]:  # not the world
            if joint.nq == 1:
                states[:, joint.idx_q] = files["pos"][name]
        for foot, name in _FEET.items():
            for key in (f"{kind}_{axis}" for kind in ("force", "torque") for axis in "xyz"):
                table[f"{foot}_sensor_{key}"] = np.interp(time, files[name]["time"], files[name][key])
    except KeyError as error:
        raise InputError(f"{folder} has no column {error.args[0]!r}; give it, or another model.") from None
    data, places = model.createData(), np.zeros((3, len(time), 3))
    for k, state in enumerate(states):
        places[0, k] = pin.centerOfMass(model, data, state)
        for i, foot in enumerate(_FEET, start=1):
            places[i, k] = pin.updateFramePlacement(model, data, model.getFrameId(soles[foot])).translation
    for name, place in zip(("com", *(f"{foot}_sensor" for foot in _FEET)), places, strict=True):
        table |= {f"{name}_{axis}": column for axis, column in zip("xyz", place.T, strict=True)}
    on_left = table["left_sensor_force_z"] > table["right_sensor_force_z"]
    return {**table, "floor": np.where(on_left, table["left_sensor_z"], table["right_sensor_z"])}

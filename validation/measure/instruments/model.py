"""Model of an instrument: frozen, validated specifications of a data sheet, from a preset or a TOML file.

Defaults are ideal: no noise, no bias, no filter, every step read without delay, infinite range. A file with
``kind`` alone gives the true values.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Literal

from pydantic import Field

from ampm.exceptions import InputError
from ampm.section import Real, Section, parameter, read_source

PRESETS: dict[str, str] = {
    "force-plate": "a laboratory's force plates, one under every footstep",
    "foot-ft": "a six-axis force/torque sensor in each ankle, pose by joint encoders",
    "imu": "an accelerometer and gyroscope on the pelvis",
}
"""Presets and what they are; each is ``validation/measure/instruments/presets/<name>.toml``."""


class Channel(Section):
    """Specifications of one group of channels; ``u`` is its unit: N, N m, rad/s, m/s^2 or rad.

    Each channel of the group (left and right foot, x and y) has noise and bias of its own.
    """

    noise: Real = parameter(
        0.0, "one-sided density of white noise ahead of the filter; RMS over a band of B Hz is noise sqrt(B)",
        "u/sqrt(Hz)", ge=0, le=1e6,
    )  # fmt: skip
    bias: Real = parameter(
        0.0, "bound of a constant, drawn uniformly from -bias ... bias for every run", "u", ge=0, le=1e6
    )
    offset: Real = parameter(0.0, "constant that is always added", "u", ge=-1e6, le=1e6)
    resolution: Real = parameter(0.0, "step of the converter (LSB); 0: no quantisation", "u", ge=0, le=1e6)
    range: float = parameter(math.inf, "readings are cut off at plus and minus this", "u", gt=0)


class Acquisition(Section):
    """Processing of every channel of an instrument: low-pass, sampling, delay."""

    cutoff: Real | None = parameter(
        None, "-3 dB frequency of the causal Butterworth low-pass; without it there is none", "Hz",
        ge=0.01, le=1e6,
    )  # fmt: skip
    order: int = parameter(4, "order of the low-pass", "1", ge=1, le=10)
    rate: Real | None = parameter(
        None, "samples per second, each held until the next; without it as many as steps", "Hz", gt=0, le=1e6
    )
    delay: Real = parameter(0.0, "time from a sample to its arrival", "s", ge=0, le=10)


class Instrument(Section):
    """Data common to all instruments.

    Attributes:
        kind: which instrument.
        name: of this one, for reports.
    """

    kind: str
    name: str = parameter("", "name for reports; by default that of the preset or file", "", max_length=60)
    seed: int = parameter(1, "seed of biases and noise, with the key of the run", "1", ge=0, le=2**63 - 1)
    acquisition: Acquisition = Field(default_factory=Acquisition)
    groups: ClassVar[Mapping[str, str]] = {}
    """Group of channels to its unit."""


class _Wrench(Instrument):
    """Six axes under or in each foot."""

    threshold: Real = parameter(
        0.0, "a foot whose vertical force reads less than this counts as unloaded; 0 takes every reading",
        "N", ge=0, le=1e4,
    )  # fmt: skip
    cross_talk: Real = parameter(
        0.0, "bound of a channel's share of every other one, drawn uniformly, both relative to their ranges",
        "1", ge=0, le=0.5,
    )  # fmt: skip
    force_xy: Channel = Field(default_factory=Channel)
    force_z: Channel = Field(default_factory=Channel)
    moment_xy: Channel = Field(default_factory=Channel)
    moment_z: Channel = Field(default_factory=Channel)
    groups: ClassVar[Mapping[str, str]] = {
        "force_xy": "N", "force_z": "N", "moment_xy": "N m", "moment_z": "N m"
    }  # fmt: skip


class ForcePlate(_Wrench):
    """A plate of its own under every footstep, centred under the sole and level with the floor."""

    kind: Literal["force-plate"]


class FootForceTorque(_Wrench):
    """A force/torque sensor at each ankle's centre, fixed to the foot."""

    kind: Literal["foot-ft"]
    compensation: Literal["none", "weight", "inertia"] = parameter(
        "inertia",
        "compensation of the part of the foot below the sensor: nothing, its weight, or its "
        "weight and inertial forces exactly",
        "1",
    )
    pose: Literal["true", "encoders"] = parameter(
        "true",
        "pose of the sensor that the user takes: the true one, or the pelvis's true pose and the leg's joint "
        "encoders",
        "1",
    )
    encoder: Channel = Field(default_factory=Channel)
    groups: ClassVar[Mapping[str, str]] = {**_Wrench.groups, "encoder": "rad"}


class Imu(Instrument):
    """An inertial measurement unit."""

    kind: Literal["imu"]
    mount: Literal["pelvis", "chest"] = parameter(
        "pelvis", "where it sits: origin of the pelvis, or the model's own sensor site", "1"
    )
    tilt: Real = parameter(
        0.0, "bound of the constant roll and pitch error of the orientation estimate, drawn uniformly", "rad",
        ge=0, le=1,
    )  # fmt: skip
    gyroscope: Channel = Field(default_factory=Channel)
    accelerometer: Channel = Field(default_factory=Channel)
    groups: ClassVar[Mapping[str, str]] = {"gyroscope": "rad/s", "accelerometer": "m/s^2"}


KINDS: dict[str, type[Instrument]] = {"force-plate": ForcePlate, "foot-ft": FootForceTorque, "imu": Imu}


def load_instrument(name: str | Path) -> Instrument:
    """An instrument by the name of a preset or the path of a TOML file.

    Raises:
        InputError: no such preset or file, no valid TOML, unknown key or bad value.
    """
    table = read_source(name, PRESETS, "validation.measure.instruments", "an instrument")
    return make_instrument(table, str(name) if name in PRESETS else Path(name).stem)


def make_instrument(table: Mapping[str, Any], name: str = "") -> Instrument:
    """An instrument of a table as a TOML file holds it.

    Args:
        table: ``kind`` and what that kind has.
        name: used if the table has none.

    Raises:
        InputError: unknown kind or key, or a bad value.
    """
    kind = table.get("kind")
    if not isinstance(kind, str) or kind not in KINDS:
        limit = f"one of {', '.join(map(repr, KINDS))}"
        message = f"kind = {kind!r} is no kind of instrument; write {limit}."
        raise InputError(message, key="kind", value=kind, limit=limit)
    parts = {}
    for group, values in table.items():
        field = KINDS[kind].model_fields.get(group)
        if isinstance(values, dict) and field is not None and isinstance(field.annotation, type):
            unit = KINDS[kind].groups.get(group, "")
            try:
                parts[group] = field.annotation(**values)
            except InputError as error:
                text = re.sub(r"\bu(?=/|\b)", unit, str(error))
                raise InputError(f"{group}: {text}", **error.details) from None
    return KINDS[kind](**{"name": name[:60], **table, **parts})

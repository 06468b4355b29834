"""Numbers of all stamped ROS 2 messages of an MCAP file, such as wrenches, read by mcap-ros2-support."""

from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from ampm.exceptions import InputError


def read(path: Path) -> dict[str, Any]:
    """Columns of an MCAP file of ROS 2: every number of every topic whose messages have a header.

    They are named as ``/left_ft.wrench.force.z``. ``time`` is of the headers of the topic that has most
    wrenches [s]; all others are interpolated there, NaN before the first and after the last message of a
    topic. ROS has SI units. Raises :class:`InputError` for no MCAP file of ROS 2, or one without a wrench.
    """
    times: dict[str, list[float]] = defaultdict(list)
    rows: dict[str, list[dict[str, float]]] = defaultdict(list)
    wrenches: set[str] = set()
    try:
        with path.open("rb") as stream:
            others = SimpleNamespace(decoder_for=lambda *_: bool)  # makes what has no header
            reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory(), others])
            for _, channel, _, said in reader.iter_decoded_messages():
                if hasattr(said, "header"):
                    topic, stamp = channel.topic, said.header.stamp
                    times[topic].append(stamp.sec + 1e-9 * stamp.nanosec)
                    rows[topic].append(dict(_numbers(said, topic)))
                    wrenches |= {topic} if hasattr(said, "wrench") else set()
    except Exception as error:  # also of decompression
        raise InputError(f"{path} cannot be read as MCAP of ROS 2 ({error}); give a whole file.") from error
    if not wrenches:
        raise InputError(f"{path} has no wrench with a header; it has {', '.join(times) or 'no topic'}.")
    clock = np.unique(times[max(sorted(wrenches), key=lambda topic: len(times[topic]))])
    table: dict[str, Any] = {"time": clock}
    for topic, values in rows.items():
        order = np.argsort(times[topic], kind="stable")
        for name in values[0]:
            column = np.array([row.get(name, np.nan) for row in values])[order]
            table[name] = np.interp(clock, np.sort(times[topic]), column, left=np.nan, right=np.nan)
    return table


def _numbers(said: Any, name: str) -> Iterator[tuple[str, float]]:
    """Numbers of a message by their path; not those of its header, nor of arrays."""
    for slot in said.__slots__:
        value, path = getattr(said, slot), f"{name}.{slot}"
        if isinstance(value, bool | int | float):
            yield path, float(value)
        elif slot != "header" and hasattr(value, "__slots__"):
            yield from _numbers(value, path)

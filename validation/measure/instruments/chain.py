"""From true signals to readings: cross-talk, bias, noise, low-pass, sampling, delay, range and converter.

The order is the physical one. Noise arises ahead of the low-pass and always passes it, so noise alone has the
same size as with all other effects.
"""

from __future__ import annotations

import math
from collections.abc import Sequence, Set
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256

import numpy as np
from scipy.signal import butter, sosfilt, sosfilt_zi

from ampm.geometry import Array
from validation.measure.instruments.model import Acquisition, Channel

NOISE, BIAS, CROSS_TALK = "noise", "bias", "cross_talk"
FILTER, SAMPLING, DELAY = "filter", "sampling", "delay"
QUANTISATION, SATURATION = "quantisation", "saturation"
_STREAMS = {NOISE: 1, BIAS: 2, CROSS_TALK: 3}
_SETTLING = 5.0
"""Periods of the cut-off after which the start of filtered noise is forgotten."""


def random_stream(seed: int, key: str, *use: int) -> np.random.Generator:
    """Random draws that depend only on the instrument's seed, the run's key, and their purpose."""
    return np.random.default_rng([seed, int.from_bytes(sha256(key.encode()).digest()[:8], "big"), *use])


@dataclass(frozen=True)
class Chain:
    """All channels of an instrument and their processing.

    Attributes:
        channels: specifications of each of C channels.
        acquisition: processing common to all.
        seed: of the instrument, for biases, noise and coupling.
        key: of the run, any text, for the same.
        time: start of each of K steps [s].
        time_step: dt [s].
        cross_talk: bound of the coupling, relative to the ranges [1].
        number: distinguishes several chains of one instrument.
    """

    channels: Sequence[Channel]
    acquisition: Acquisition
    seed: int
    key: str
    time: Array
    time_step: float
    cross_talk: float = 0.0
    number: int = 0

    @cached_property
    def low_pass(self) -> Array | None:
        """Second-order sections; None without a low-pass that steps of this length can show."""
        cutoff, order = self.acquisition.cutoff, self.acquisition.order
        if cutoff is None or cutoff >= 0.49 / self.time_step:
            return None
        return np.asarray(butter(order, cutoff, fs=1.0 / self.time_step, output="sos"))

    @property
    def effects(self) -> frozenset[str]:
        """Effects that this chain has."""
        channels, acquisition = self.channels, self.acquisition
        there = {
            NOISE: any(channel.noise for channel in channels),
            BIAS: any(channel.bias or channel.offset for channel in channels),
            CROSS_TALK: self.cross_talk > 0.0,
            FILTER: self.low_pass is not None,
            SAMPLING: acquisition.rate is not None,
            DELAY: acquisition.delay > 0.0,
            QUANTISATION: any(channel.resolution for channel in channels),
            SATURATION: any(math.isfinite(channel.range) for channel in channels),
        }
        return frozenset(name for name, active in there.items() if active)

    def _draws(self, effect: str, *use: int) -> np.random.Generator:
        return random_stream(self.seed, self.key, _STREAMS[effect], self.number, *use)

    def bias(self) -> Array:
        """Constant of each channel, shape (C,) [its unit]."""
        draw = self._draws(BIAS).uniform(-1.0, 1.0, len(self.channels))
        return np.array([c.offset for c in self.channels]) + draw * [c.bias for c in self.channels]

    def coupling(self) -> Array:
        """Share of channel j in the reading of channel i, shape (C, C) [unit of i / unit of j]."""
        count = len(self.channels)
        draw = self._draws(CROSS_TALK).uniform(-1.0, 1.0, (count, count))
        full = np.array([c.range if math.isfinite(c.range) else 1.0 for c in self.channels])
        coupling = self.cross_talk * draw * full[:, None] / full[None, :]
        np.fill_diagonal(coupling, 0.0)
        return coupling

    def read(self, truth: Array, effects: Set[str]) -> Array:
        """Readings of all channels.

        Args:
            truth: shape (K, C).
            effects: which of those that the chain has act.

        Returns:
            What the user holds at the start of each step, shape (K, C).
        """
        values = truth
        if CROSS_TALK in effects:
            values = values + values @ self.coupling().T
        if BIAS in effects:
            values = values + self.bias()
        if FILTER in effects:
            values = self._filtered(values, start=values[0])
        steps = (self.sample_times(effects) - self.time[0]) / self.time_step
        row = np.clip(np.floor(steps + 1e-6).astype(np.intp), 0, len(self.time) - 1)
        if effects & {SAMPLING, DELAY}:
            # Linear between the steps and exact at them.
            share = np.clip(steps - row, 0.0, 1.0)
            share = np.where(share < 1e-6, 0.0, share)
            after = np.minimum(row + 1, len(values) - 1)
            values = values[row] + share[:, None] * (values[after] - values[row])
        if NOISE in effects:
            values = values + self.noise(len(truth))[row]
        if SATURATION in effects:
            limit = np.array([channel.range for channel in self.channels])
            values = np.clip(values, -limit, limit)
        if QUANTISATION in effects:
            values = values.copy()
            for index, channel in enumerate(self.channels):
                if channel.resolution:
                    values[:, index] = np.round(values[:, index] / channel.resolution) * channel.resolution
        return values

    def noise(self, rows: int) -> Array:
        """Noise as it leaves the low-pass, at every step, shape (rows, C)."""
        sigma = np.array([c.noise for c in self.channels]) * math.sqrt(0.5 / self.time_step)
        cutoff = math.inf if self.low_pass is None else self.acquisition.cutoff or math.inf
        early = math.ceil(_SETTLING / (cutoff * self.time_step))
        channels = range(len(self.channels))
        columns = [self._draws(NOISE, index).standard_normal(early + rows) for index in channels]
        white = sigma * np.column_stack(columns)
        return self._filtered(white, start=np.zeros(white.shape[1]))[early:]

    def sample_times(self, effects: Set[str]) -> Array:
        """When the sample was taken that the user holds at the start of each step, shape (K,) [s]."""
        start, rate = self.time[0], self.acquisition.rate
        at = self.time - (self.acquisition.delay if DELAY in effects else 0.0)
        if SAMPLING in effects and rate is not None:
            # Tolerance: rounding of k dt must not lose a sample.
            at = start + np.floor((at - start) * rate + 1e-6) / rate
        return np.maximum(at, start)

    def latency(self) -> float:
        """Mean age of a reading: delay, the low-pass's delay of slow signals, half a sample [s]."""
        delay = self.acquisition.delay
        first = delay + 1.0 / (self.acquisition.rate or math.inf)
        settled = self.time >= self.time[0] + first
        ages = (self.time - self.sample_times({SAMPLING, DELAY}))[settled]
        age = float(np.mean(ages)) if len(ages) else delay
        if self.low_pass is None:
            return age
        # Of each section at frequency zero: mean position of its coefficients, feed-forward less feedback.
        steps = np.arange(3.0)
        samples = sum(
            float(steps @ section[:3] / section[:3].sum() - steps @ section[3:] / section[3:].sum())
            for section in self.low_pass
        )
        return age + samples * self.time_step

    def _filtered(self, values: Array, start: Array) -> Array:
        """Columns after the low-pass, if there is one, in steady state at ``start``."""
        if self.low_pass is None:
            return values
        state = sosfilt_zi(self.low_pass)[:, :, None] * start
        return np.asarray(sosfilt(self.low_pass, values, axis=0, zi=state)[0])

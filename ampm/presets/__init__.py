"""Gaits that come with the package, by name."""

from collections.abc import Mapping

PRESETS: Mapping[str, str] = {
    "normal": "the paper's gait: 0.6 m steps, 1.0 m/s at every switch, no angular momentum about the COM",
    "momentum": "the same with angular momentum about both horizontal axes (c_s 1.2, c_y 0.4)",
    "flat": "an easy gait: 0.3 m steps on flat feet",
    "roll-0.1": "the normal gait with c_y 0.1: large angular momentum about the forward axis (Fig. 11)",
    "roll-0.4": "the same with c_y 0.4, and feet let down 4 ms early",
    "roll-0.7": "the same with c_y 0.7",
    "roll-1.0": "the same with c_y 1: no angular momentum about the forward axis",
    "pitch": "0.65 m steps with c_s 1.6: large angular momentum about the lateral axis (Fig. 12)",
    "pitch-low": "0.7 m steps with c_s 0.33: large angular momentum of the opposite sign",
    "ipm": "the normal gait of the plain inverted pendulum, whose acceleration jumps at every switch",
}
"""Presets and what they are; each is ``ampm/presets/<name>.toml``."""


def preset_names() -> tuple[str, ...]:
    """Names of the presets."""
    return tuple(PRESETS)

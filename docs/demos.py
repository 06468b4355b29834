"""Walk the paper's demos again: ``python docs/demos.py`` writes demos.csv, slopes.csv and momentum-z.csv.

Every row is one trial. With the tuning of the gaits towards the limits of c_s it takes fifteen minutes on an
idle machine. ``python docs/demos.py momentum-z`` writes only that table.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
from trials import AGREEMENT, agreement, ending, walk, write_rows

import validation as val
from ampm.presets import PRESETS
from ampm.run_file import load_run
from validation.judge.profiles import own_profile

COLUMNS = (
    "preset",
    *AGREEMENT,
    "profile, verdict",
    "L_x plan, measured [N m s]",
    "L_y plan, measured [N m s]",
    "constant of L_y [N m s]",
    "trunk roll, pitch [°]",
    "largest torque",
    "time at a limit [%]",
    "friction of 0.8",
    "knee [rad]",
    "cost of transport",
    "QPs with limits, unsolved",
)
FINE = "simulation.time_step=0.0005"
VERTICAL = (
    "preset",
    "L_z",
    "peak of L_z / (m V H)",
    "ZMP RMSE x, y [mm]",
    "maximum x, y [mm]",
    "largest torque",
    "friction of 0.8",
    "slip [mm]",
    "cost of transport",
    "profile, verdict",
)
LIMITS = (
    "step, v0 [m, m/s]",
    "c_s",
    "ZMP RMSE x, y [mm]",
    "L_y plan [N m s]",
    "largest torque",
    "time at a limit [%]",
    "knee [rad]",
    "within the limits",
)
UPWARD = (
    (0.6, 1.3, 1.7),
    (0.65, 1.2, 1.5),
    (0.65, 1.3, 1.5),
    (0.65, 1.4, 1.6),
    (0.7, 1.4, 1.3),
)
"""Step length, v0 and the first c_s that is tried, all other choices found; then tenths more."""
DOWNWARD = (0.5, 0.4, 0.33, 0.315, 0.31)
"""c_s below that of pitch-low."""


def main() -> None:
    """Walk every preset, with L_z free and zero, and every step towards the limits of c_s."""
    vertical = [_vertical(name, choice) for name in PRESETS for choice in ("free", "zero")]
    write_rows("momentum-z", [VERTICAL, *vertical])
    if sys.argv[1:] == ["momentum-z"]:
        return
    write_rows("demos", [COLUMNS, *(_preset(name) for name in PRESETS)])
    upward = [row for step, speed, c_s in UPWARD for row in _climb(step, speed, c_s)]
    write_rows("slopes", [LIMITS, *upward, *(_limit("pitch-low", c_s) for c_s in DOWNWARD)])


def _preset(name: str) -> tuple[str, ...]:
    """Agreement and cost of a preset."""
    profile = own_profile(load_run(name)).name
    trial = walk(name, profile=profile)
    if isinstance(trial, Exception):
        raise trial
    summary = trial.summary
    margins, solver = summary["margins"], summary["solver"]
    swings = [f"{_swing(trial, 'plan', k):.1f}, {_swing(trial, 'measured', k):.1f}" for k in (0, 1)]
    return (
        name,
        *agreement(summary["metrics"]),
        f"{profile}: {ending(summary)}",
        *swings,
        f"{summary['motion']['angular_momentum_y_offset']:.2f}",
        ", ".join(f"{value:.1f}" for value in _trunk(trial)),
        _torque(summary),
        f"{100 * margins['saturated']:.1f}",
        f"{margins['friction']['value']:.2f}",
        f"{margins['knee']['value']:.2f}",
        f"{summary['energy']['cost_of_transport']:.2f}",
        f"{solver['solved_with_limits']}, {solver['unsolved']}",
    )


def _vertical(name: str, choice: str) -> tuple[str, ...]:
    """Angular momentum about the vertical, agreement and cost of a preset with L_z free or zero."""
    profile = own_profile(load_run(name)).name
    trial = walk(name, [f"body.angular_momentum_z={choice}", FINE], profile=profile)
    if isinstance(trial, Exception):
        reason = str(getattr(trial, "reason", "")).replace("_", " ")
        return (name, choice, *["–"] * (len(VERTICAL) - 3), f"refused: {reason}")
    walked, summary = trial.comparison, trial.summary
    peak = np.abs(walked.measured.angular_momentum[walked.inside, 2]).max()
    margins = summary["margins"]
    return (
        name,
        choice,
        f"{peak / walked.scales['mass_height_velocity']:.3f}",
        *list(agreement(summary["metrics"]))[:2],
        _torque(summary),
        f"{margins['friction']['value']:.2f}",
        f"{1e3 * summary['metrics']['slip_maximum']['value']:.1f}",
        f"{summary['energy']['cost_of_transport']:.2f}",
        f"{profile}: {ending(summary)}",
    )


def _climb(step: float, speed: float, c_s: float) -> Iterator[tuple[str, ...]]:
    """Results for c_s in tenths, up to the first that does not walk within the limits."""
    for k in itertools.count():
        settings = f"gait.step_length={step}", f"gait.switching_velocity={speed}"
        yield (row := _limit("normal", round(c_s + 0.1 * k, 1), *settings, tune=True))
        if row[-1] != "yes":
            return


def _limit(preset: str, c_s: float, *settings: str, tune: bool = False) -> tuple[str, ...]:
    """Result for one c_s."""
    chosen = (*settings, f"gait.c_s={c_s}")
    gait = load_run(preset, chosen).gait
    head = (f"{gait.step_length:g}, {gait.switching_velocity:g}", f"{c_s:g}")
    trial = walk(preset, chosen, tune=tune)
    if isinstance(trial, Exception):
        return (*head, "", "", "", "", "", f"refused: {str(trial).split('; ')[0]}")
    summary = trial.summary
    names = [item.name for item in trial.verdict.failed]
    ends = summary["outcome"] == "completed"
    return (
        *head,
        ", ".join(f"{summary['metrics'][f'zmp_{axis}_rmse']['display']['value']:.2f}" for axis in "xy"),
        f"{_swing(trial, 'plan', 1):.1f}",
        _torque(summary),
        f"{100 * summary['margins']['saturated']:.1f}",
        f"{summary['margins']['knee']['value']:.2f}",
        "yes" if ends and not names else f"no: {', '.join(names) if ends else summary['outcome']}",
    )


def _torque(summary: dict[str, Any]) -> str:
    torque = summary["margins"]["torque"]
    return f"{100 * torque['value']:.0f} % ({torque['where'].replace('_', ' ')})"


def _swing(trial: val.Trial, source: str, axis: int) -> float:
    """Angular momentum of plan or measurement after the first step, peak to peak [N m s]."""
    walked = trial.comparison
    of = walked.sample if source == "plan" else walked.measured
    return float(np.ptp(of.angular_momentum[len(walked.time) // 30 :, axis]))


def _trunk(trial: val.Trial) -> tuple[float, float]:
    """Peak to peak of the trunk's roll and pitch in the periodic motion [degrees]."""
    rotation = trial.planned.body.robot.trunk_rotations(trial.planned.motion.q)
    roll = np.arctan2(rotation[:, 2, 1], rotation[:, 2, 2])
    roll = np.concatenate([roll, -roll])  # the next step mirrors this one
    pitch = np.arctan2(rotation[:, 0, 2], rotation[:, 2, 2])
    return float(np.degrees(np.ptp(roll))), float(np.degrees(np.ptp(pitch)))


if __name__ == "__main__":
    main()

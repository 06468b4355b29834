"""Walk the paper's demos again: ``python docs/demos.py`` writes docs/data/demos.csv and docs/data/slopes.csv.

Every row is one ``ampm validate ... --json``; with the tuning of the gaits towards the
limits of c_s, ten minutes on an idle machine.
"""

from __future__ import annotations

import csv
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ampm.run_file import PRESETS
from validation.store.signals import load_signals
from validation.trial.plan import load_request, plan_walk

DATA = Path(__file__).with_name("data")
WIDE = ("roll-0.1", "pitch")
"""Presets that may take twice the limits of the others."""
AGREEMENT = (
    "preset",
    "ZMP RMSE x, y [mm]",
    "maximum x, y [mm]",
    "F RMSE x, y, z [% weight]",
    "L RMSE x, y [N m s]",
    "both ZMPs [mm]",
    "profile, verdict",
)
COST = (
    "preset",
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
LIMITS = (
    "step, v0 [m, m/s]",
    "c_s",
    "ZMP RMSE x, y [mm]",
    "L_y plan [N m s]",
    "largest torque",
    "time at a limit [%]",
    "knee [rad]",
    "within twice the limits",
)
UPWARD = (
    (0.6, 1.3, (1.6, 1.7, 1.8, 1.9)),
    (0.65, 1.2, (1.5, 1.6)),
    (0.65, 1.3, (1.5, 1.6, 1.65, 1.7)),
    (0.65, 1.4, (1.6, 1.7)),
    (0.7, 1.4, (1.3, 1.4, 1.5)),
)
"""Step length, v0 and the c_s that are tried, all other choices found by ``ampm tune``."""
DOWNWARD = (0.5, 0.4, 0.33, 0.315, 0.31)
"""c_s below that of pitch-low."""


def main() -> None:
    """Walk every preset, and every step towards the limits of c_s."""
    presets = [(name, *_preset(name)) for name in PRESETS]
    _write("demos", [(*AGREEMENT, *COST[1:]), *presets])
    upward = [
        _limit("normal", c_s, f"gait.step_length={step}", f"gait.switching_velocity={speed}", tune=True)
        for step, speed, slopes in UPWARD
        for c_s in slopes
    ]
    _write("slopes", [LIMITS, *upward, *(_limit("pitch-low", c_s) for c_s in DOWNWARD)])


def _preset(name: str) -> tuple[str, ...]:
    """Agreement and cost of a preset."""
    profile = "wide" if name in WIDE else "default"
    summary, swing = _trial(name, (), profile)
    return (*_agreement(summary, profile), *_cost(name, summary, swing))


def _write(name: str, rows: Sequence[Sequence[str]]) -> None:
    with DATA.joinpath(f"{name}.csv").open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)


def _agreement(summary: dict[str, Any], profile: str) -> Iterator[str]:
    metrics = summary["metrics"]

    def shown(decimals: int, *names: str) -> str:
        return ", ".join(f"{metrics[name]['display']['value']:.{decimals}f}" for name in names)

    yield shown(2, "zmp_x_rmse", "zmp_y_rmse")
    yield shown(1, "zmp_x_maximum", "zmp_y_maximum")
    yield shown(2, "force_x_rmse", "force_y_rmse", "force_z_rmse")
    yield shown(3, "angular_momentum_x_rmse", "angular_momentum_y_rmse")
    yield shown(2, "zmp_agreement_rmse")
    yield f"{profile}: {summary['verdict'] if summary['outcome'] == 'completed' else summary['outcome']}"


def _cost(name: str, summary: dict[str, Any], swing: dict[str, float]) -> Iterator[str]:
    yield f"{swing['plan_x']:.1f}, {swing['measured_x']:.1f}"
    yield f"{swing['plan_y']:.1f}, {swing['measured_y']:.1f}"
    yield f"{summary['motion']['angular_momentum_y_offset']:.2f}"
    yield ", ".join(f"{value:.1f}" for value in _trunk(name))
    yield _torque(summary)
    yield f"{100 * summary['margins']['saturated']:.1f}"
    yield f"{summary['margins']['friction']['value']:.2f}"
    yield f"{summary['margins']['knee']['value']:.2f}"
    yield f"{summary['energy']['cost_of_transport']:.2f}"
    yield f"{summary['solver']['solved_with_limits']}, {summary['solver']['unsolved']}"


def _limit(preset: str, c_s: float, *settings: str, tune: bool = False) -> tuple[str, ...]:
    """Result for one c_s."""
    chosen = (*settings, f"gait.c_s={c_s}")
    gait = load_request(preset, chosen).run.gait
    head = (f"{gait.step_length:g}, {gait.switching_velocity:g}", f"{c_s:g}")
    summary, swing = _trial(preset, chosen, "wide", tune=tune)
    if "error" in summary:
        message = str(summary["error"]["message"])
        return (*head, "", "", "", "", "", f"refused: {message.split('; ')[0]}")
    metrics = summary["metrics"]
    names = [key for key, metric in metrics.items() if metric["pass"] is False]
    ends = summary["outcome"] == "completed"
    return (
        *head,
        ", ".join(f"{metrics[f'zmp_{axis}_rmse']['display']['value']:.2f}" for axis in "xy"),
        f"{swing['plan_y']:.1f}",
        _torque(summary),
        f"{100 * summary['margins']['saturated']:.1f}",
        f"{summary['margins']['knee']['value']:.2f}",
        "yes" if ends and not names else f"no: {', '.join(names) if ends else summary['outcome']}",
    )


def _torque(summary: dict[str, Any]) -> str:
    torque = summary["margins"]["torque"]
    return f"{100 * torque['value']:.0f} % ({torque['where'].replace('_', ' ')})"


def _trunk(name: str) -> tuple[float, float]:
    """Peak to peak of the trunk's roll and pitch in the periodic motion [degrees]."""
    planned = plan_walk(load_request(name))
    robot, motion = planned.body.robot, planned.motion
    rotation = robot.trunk_rotations(motion.q)
    roll = np.arctan2(rotation[:, 2, 1], rotation[:, 2, 2])
    roll = np.concatenate([roll, -roll])  # the next step mirrors this one
    pitch = np.arctan2(rotation[:, 0, 2], rotation[:, 2, 2])
    return float(np.degrees(np.ptp(roll))), float(np.degrees(np.ptp(pitch)))


def _trial(
    gait: str, settings: Sequence[str], profile: str, *, tune: bool = False
) -> tuple[dict[str, Any], dict[str, float]]:
    """Output of ``ampm validate --json`` for one gait, and its angular momentum, peak to peak [N m s]."""
    program = Path(sys.executable).with_name("ampm")
    with tempfile.TemporaryDirectory() as folder:
        command = [str(program), "validate", gait, "--profile", profile, "--json", "--out", f"{folder}/run"]
        if tune:
            command.append("--tune")
        for setting in settings:
            command += ["--set", setting]
        answer = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        summary = dict(json.loads(answer.stdout))
        swing = {}
        if "error" not in summary:
            signals = load_signals(Path(folder) / "run" / "signals.parquet")
            after = len(signals["time"]) // 30  # the first step
            for source in ("plan", "measured"):
                for axis in "xy":
                    swing[f"{source}_{axis}"] = float(
                        np.ptp(signals[f"{source}_angular_momentum_{axis}"][after:])
                    )
    print(gait, *settings, summary.get("verdict", "refused"), file=sys.stderr, flush=True)  # noqa: T201
    return summary, swing


if __name__ == "__main__":
    main()

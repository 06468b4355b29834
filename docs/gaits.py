"""Walk the gaits of docs/gaits.md again: ``python docs/gaits.py`` writes docs/data/gaits.csv.

Every row is one ``ampm validate ... --json``, about eight seconds; the two long walks take a minute each.
"""

from __future__ import annotations

import csv
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

TABLE = Path(__file__).with_name("data") / "gaits.csv"
PROFILE = "default"
COLUMNS = (
    "steps",
    "gait",
    "ZMP RMSE x, y [mm]",
    "maximum x, y [mm]",
    "F RMSE x, y, z [% weight]",
    "L RMSE x, y [N m s]",
    "both ZMPs [mm]",
    "verdict",
    "feedback on the ZMP x, y [mm]",
    "feedback on F x, y, z [% weight]",
    "torque [% of limit]",
    "friction of 0.8",
    "slip [mm]",
    "knee [rad]",
    "QPs with limits, unsolved",
)
ONE_BY_ONE = [("gait.c_y", value) for value in (0.2, 0.4, 0.7, 1.2)]
ONE_BY_ONE += [("gait.c_s", value) for value in (0.8, 1.2, 1.4)]


def main() -> None:
    """Walk every gait and rewrite the table."""
    gaits: list[tuple[str, tuple[str, ...]]] = [("normal", ()), ("momentum", ()), ("flat", ())]
    gaits += [("normal", ("--set", f"{key}={value}")) for key, value in ONE_BY_ONE]
    rows = [_row(30, gait, *arguments) for gait, arguments in gaits]
    rows += [_row(200, gait) for gait, _ in gaits[:2]]
    with TABLE.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([COLUMNS, *rows])


def _row(steps: int, gait: str, *arguments: str) -> tuple[str, ...]:
    """Agreement and cost of a gait."""
    label = arguments[1] if arguments else gait
    summary = _trial(gait, *arguments, "--steps", str(steps))
    if "error" in summary:
        raise SystemExit(f"{label} was refused: {summary['error']['message']}")
    completed = summary["outcome"] == "completed"
    verdict = summary["verdict"] if completed else summary["outcome"]
    print(label, verdict, file=sys.stderr, flush=True)  # noqa: T201
    return str(steps), label, *_agreement(summary["metrics"]), verdict, *_cost(summary)


def _agreement(metrics: Mapping[str, Any]) -> Iterator[str]:
    def shown(decimals: int, *names: str) -> str:
        return ", ".join(f"{metrics[name]['display']['value']:.{decimals}f}" for name in names)

    yield shown(2, "zmp_x_rmse", "zmp_y_rmse")
    yield shown(1, "zmp_x_maximum", "zmp_y_maximum")
    yield shown(2, "force_x_rmse", "force_y_rmse", "force_z_rmse")
    yield shown(3, "angular_momentum_x_rmse", "angular_momentum_y_rmse")
    yield shown(2, "zmp_agreement_rmse")


def _cost(summary: Mapping[str, Any]) -> Iterator[str]:
    margins, effort, solver = summary["margins"], summary["effort"], summary["solver"]
    weight = summary["scales"]["body_weight"]
    yield ", ".join(f"{1e3 * value:.2f}" for value in effort["zmp"])
    yield ", ".join(f"{100 * value / weight:.2f}" for value in effort["force"])
    yield f"{100 * margins['torque']['value']:.0f}"
    yield f"{margins['friction']['value']:.2f}"
    yield f"{1e3 * margins['slip']['value']:.1f}"
    yield f"{margins['knee']['value']:.2f}"
    yield f"{solver['solved_with_limits']}, {solver['unsolved']}"


def _trial(*arguments: str) -> dict[str, Any]:
    """Output of ``ampm validate --json`` for one gait."""
    program = Path(sys.executable).with_name("ampm")
    with tempfile.TemporaryDirectory() as folder:
        command = [str(program), "validate", *arguments, "--profile", PROFILE, "--json"]
        answer = subprocess.run(
            [*command, "--out", f"{folder}/run"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
    return dict(json.loads(answer.stdout))


if __name__ == "__main__":
    main()

"""Walk the gaits of docs/gaits.md again and write their figures into it: ``python docs/gaits.py``.

Every row is one ``ampm validate ... --json``, about eight seconds; the two long walks take a minute each.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from pages import between

PAGE = Path(__file__).with_suffix(".md")
PROFILE = "default"
AGREEMENT = (
    "gait",
    "ZMP RMSE x, y [mm]",
    "maximum x, y [mm]",
    "F RMSE x, y, z [% weight]",
    "L RMSE x, y [N m s]",
    "both ZMPs [mm]",
    "verdict",
)
COST = (
    "gait",
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
    """Walk every gait and rewrite the tables of the page."""
    page = PAGE.read_text(encoding="utf-8")
    gaits: list[tuple[str, tuple[str, ...]]] = [("normal", ()), ("momentum", ()), ("flat", ())]
    gaits += [("normal", ("--set", f"{key}={value}")) for key, value in ONE_BY_ONE]
    page = between(page, "thirty steps", _tables(gaits))
    page = between(page, "two hundred steps", _tables([(gait, ("--steps", "200")) for gait, _ in gaits[:2]]))
    PAGE.write_text(page, encoding="utf-8")


def _tables(gaits: Sequence[tuple[str, tuple[str, ...]]]) -> str:
    """Agreement and cost of every gait."""
    agreement, cost = [AGREEMENT, ("---",) * len(AGREEMENT)], [COST, ("---",) * len(COST)]
    for gait, arguments in gaits:
        label = f"`{arguments[1] if arguments[:1] == ('--set',) else gait}`"
        summary = _trial(gait, *arguments)
        verdict = summary.get("verdict", "refused")
        print(label, verdict, file=sys.stderr, flush=True)  # noqa: T201
        if "error" in summary:
            raise SystemExit(f"{label} was refused: {summary['error']['message']}")
        completed = summary["outcome"] == "completed"
        agreement.append(
            (label, *_agreement(summary["metrics"]), verdict if completed else summary["outcome"])
        )
        cost.append((label, *_cost(summary)))
    lines = [[f"| {' | '.join(row)} |" for row in table] for table in (agreement, cost)]
    return "\n".join([*lines[0], "", *lines[1]])


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
    """What ``ampm validate --json`` says of one gait."""
    program = Path(sys.executable).with_name("ampm")
    with tempfile.TemporaryDirectory() as folder:
        command = [str(program), "validate", *arguments, "--profile", PROFILE, "--json"]
        answer = subprocess.run(
            [*command, "--out", f"{folder}/run"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
    return dict(json.loads(answer.stdout))


if __name__ == "__main__":
    main()

"""Walk the gaits of docs/gaits.md again: ``python docs/gaits.py`` writes docs/data/gaits.csv.

Every row is one trial, about eight seconds; the two long walks take a minute each.
"""

from __future__ import annotations

from trials import AGREEMENT, agreement, ending, walk, write_rows

COLUMNS = (
    "steps",
    "gait",
    *AGREEMENT,
    "verdict",
    "feedback on the ZMP x, y [mm]",
    "feedback on F x, y, z [% weight]",
    "torque [% of limit]",
    "friction of 0.8",
    "slip [mm]",
    "knee [rad]",
    "QPs with limits, unsolved",
)
ONE_BY_ONE = [f"gait.c_y={value}" for value in (0.2, 0.4, 0.7, 1.2)]
ONE_BY_ONE += [f"gait.c_s={value}" for value in (0.8, 1.2, 1.4)]


def main() -> None:
    """Walk every gait and rewrite the table."""
    rows = [_row(30, gait) for gait in ("normal", "momentum", "flat")]
    rows += [_row(30, "normal", setting) for setting in ONE_BY_ONE]
    rows += [_row(200, gait) for gait in ("normal", "momentum")]
    write_rows("gaits", [COLUMNS, *rows])


def _row(steps: int, gait: str, *settings: str) -> tuple[str, ...]:
    """Agreement and cost of a gait."""
    trial = walk(gait, [*settings, f"gait.steps={steps}"])
    if isinstance(trial, Exception):
        raise trial
    summary = trial.summary
    margins, effort, solver = summary["margins"], summary["effort"], summary["solver"]
    weight = summary["scales"]["body_weight"]
    return (
        str(steps),
        *(settings or [gait]),
        *agreement(summary["metrics"]),
        ending(summary),
        ", ".join(f"{1e3 * value:.2f}" for value in effort["zmp"]),
        ", ".join(f"{100 * value / weight:.2f}" for value in effort["force"]),
        f"{100 * margins['torque']['value']:.0f}",
        f"{margins['friction']['value']:.2f}",
        f"{1e3 * summary['metrics']['slip_maximum']['value']:.1f}",
        f"{margins['knee']['value']:.2f}",
        f"{solver['solved_with_limits']}, {solver['unsolved']}",
    )


if __name__ == "__main__":
    main()

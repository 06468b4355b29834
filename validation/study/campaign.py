"""A hundred gaits drawn at random, tuned and walked: which walk, how well, and why the others do not.

The draw is uniform over :data:`RANGE` and nothing is left out: a gait that no body could walk is refused and
counted as refused, with the limit that says so. The table is written after every gait, so a campaign that was
interrupted goes on where it stopped.
"""

from __future__ import annotations

import json
import math
import multiprocessing
import os
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from ampm.body.posture import periodic_walk
from ampm.exceptions import InputError, RefusedGait
from ampm.parameters import dump_run, load_run
from validation.progress import Progress
from validation.store.environment import describe_environment
from validation.store.machine import one_blas_thread

RANGE: Mapping[str, tuple[float, float]] = {
    "gait.step_length": (0.2, 0.75),
    "gait.switching_velocity": (0.4, 1.4),
    "gait.c_y": (0.05, 1.2),
    "gait.c_s": (0.5, 1.8),
    "body.height": (1.5, 1.9),
    "body.mass": (45.0, 95.0),
}
"""What is drawn, and from where; SI units."""

LANDMARKS: Mapping[str, Mapping[str, float]] = {
    "S 0.7, v0 1.2": {"gait.step_length": 0.7, "gait.switching_velocity": 1.2},
    "S 0.75, v0 1.4": {"gait.step_length": 0.75, "gait.switching_velocity": 1.4},
    "1.5 m human": {"body.height": 1.5, "body.mass": 47.0},
    "1.7 m human": {},
    "1.9 m human": {"body.height": 1.9, "body.mass": 75.0},
}
"""Gaits that every campaign walks beside its draw; what is not named is as in the preset ``normal``."""

TABLE = "campaign.parquet"
PAGE = "campaign.md"
MARKS = ("<!-- campaign -->", "<!-- end of campaign -->")
"""Between these a page holds what a campaign writes."""

_DIGITS = 3  # of a drawn value: the table says exactly what was walked
_COLUMNS = pa.schema(
    [
        ("name", pa.string()),
        *((key, pa.float64()) for key in RANGE),
        ("steps", pa.int64()),
        ("outcome", pa.string()),
        ("steps_completed", pa.int64()),
        ("reason", pa.string()),
        ("cause", pa.string()),
        ("limit", pa.string()),
        ("best", pa.float64()),
        ("bound", pa.float64()),
        ("tried", pa.int64()),
        ("zmp_x_rmse", pa.float64()),
        ("zmp_y_rmse", pa.float64()),
        ("zmp_rmse", pa.float64()),
        ("zmp_x_maximum", pa.float64()),
        ("zmp_y_maximum", pa.float64()),
        ("force_z_rmse", pa.float64()),
        ("torque", pa.float64()),
        ("knee", pa.float64()),
        ("limited_qp", pa.int64()),
        ("unsolved_qp", pa.int64()),
        ("tune_seconds", pa.float64()),
        ("walk_seconds", pa.float64()),
        ("run", pa.string()),
        ("revision", pa.string()),
    ]
)


@dataclass(frozen=True)
class Case:
    """One gait of a campaign.

    Attributes:
        name: number of the draw, or name of the landmark.
        values: by namespaced key.
    """

    name: str
    values: Mapping[str, float]


def draw(runs: int, seed: int) -> list[Case]:
    """Gaits drawn uniformly and independently from :data:`RANGE`."""
    low, high = np.array(list(RANGE.values())).T
    values = low + (high - low) * np.random.default_rng(seed).random((runs, len(RANGE)))
    return [
        Case(str(number), dict(zip(RANGE, (round(float(v), _DIGITS) for v in row), strict=True)))
        for number, row in enumerate(values)
    ]


def landmarks() -> list[Case]:
    """The named gaits."""
    default = load_run("normal")
    full = {
        key: float(getattr(getattr(default, key.partition(".")[0]), key.partition(".")[2])) for key in RANGE
    }
    return [Case(name, {**full, **values}) for name, values in LANDMARKS.items()]


def walk(case: Case, steps: int) -> dict[str, Any]:
    """Tune and walk one gait; a row of the table."""
    # Here, not above: a worker imports what it needs once, and drawing needs none of it.
    from ampm.tune.certificate import Untunable
    from ampm.tune.tuning import tune
    from validation.judge.compare import compare
    from validation.measure.measure import measure
    from validation.trial.bridge import to_pinocchio
    from validation.trial.plan import make_body, motion_cache
    from validation.trial.simulate import simulate

    row: dict[str, Any] = {"name": case.name, **case.values, "steps": steps}
    settings = [f"{key}={value!r}" for key, value in case.values.items()]
    run = load_run(None, [*settings, f"gait.steps={steps}"])
    body = make_body(run)
    start = time.process_time()  # of this process alone: the other workers share the machine
    try:
        tuned = tune(run, body.robot, cache=motion_cache())
    except RefusedGait as error:
        row |= {
            "outcome": "refused",
            "reason": error.reason,
            "cause": str(error),
            "limit": error.reason,
            "best": error.value,
            "bound": error.limit,
            "tune_seconds": time.process_time() - start,
        }
        if isinstance(error, Untunable):
            row |= {"limit": error.certificate.limit, "tried": error.certificate.tried}
        return row
    row |= {"tried": tuned.tried, "tune_seconds": time.process_time() - start, "run": dump_run(tuned.run)}
    start = time.perf_counter()
    record = simulate(periodic_walk(tuned.plan, tuned.motion, body.robot), tuned.run, body.model, steps=steps)
    measured = measure(record, body.robot.model, to_pinocchio)
    comparison = compare(tuned.plan, record, measured, description=body.model.description)
    metrics = {name: metric.value for name, metric in comparison.metrics.items()}
    names = ("zmp_x_rmse", "zmp_y_rmse", "zmp_x_maximum", "zmp_y_maximum")
    row |= {name: metrics[name] for name in names}
    margins = comparison.margins
    row |= {
        "outcome": str(record.outcome.name),
        "cause": record.outcome.cause,
        "steps_completed": record.outcome.steps_completed,
        "zmp_rmse": math.hypot(metrics["zmp_x_rmse"], metrics["zmp_y_rmse"]),
        "force_z_rmse": metrics["force_z_rmse"] / (record.mass * record.gravity),
        "torque": margins.torque.value,
        "knee": margins.knee.value,
        "limited_qp": int((record.qp_status == 1).sum()),
        "unsolved_qp": int((record.qp_status == 2).sum()),
        "walk_seconds": time.perf_counter() - start,
    }
    return row


def run_campaign(
    out: Path,
    *,
    runs: int = 100,
    seed: int = 1,
    steps: int = 30,
    workers: int = 2,
    stages: Progress | None = None,
) -> list[dict[str, Any]]:
    """Walk a campaign, or what is missing of it.

    Args:
        out: folder of the table; rows that it holds are kept.
        runs: number of draws.
        seed: of the draw.
        steps: of every walk.
        workers: processes.
        stages: where to report progress.

    Returns:
        All rows, landmarks first.

    Raises:
        InputError: the folder holds another campaign.
    """
    if runs < 1 or steps < 2 or workers < 1:
        raise InputError("a campaign needs at least one run, two steps and one worker; raise the number.")
    cases = landmarks() + draw(runs, seed)
    revision = _revision()
    out.mkdir(parents=True, exist_ok=True)
    rows = _kept(out / TABLE, cases, seed, steps)
    missing = [case for case in cases if case.name not in rows]
    one_blas_thread()
    with (stages or Progress()).stage("campaign", "gaits") as stage:
        # Workers are started afresh: a fork would share the state of compiled libraries.
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(max_workers=workers, mp_context=context) as pool:
            pending = {pool.submit(walk, case, steps) for case in missing}
            try:
                while pending:
                    done, pending = wait(pending, return_when=FIRST_COMPLETED)
                    for future in done:
                        row = future.result() | {"revision": revision}
                        rows[row["name"]] = row
                    _save(out / TABLE, [rows[case.name] for case in cases if case.name in rows], seed, steps)
                    stage.advance(len(rows), len(cases))
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                raise
    ordered = [rows[case.name] for case in cases]
    (out / PAGE).write_text(page(ordered, seed), encoding="utf-8")
    return ordered


def _revision() -> str:
    """Short name of the code that walks: its commit, with a plus sign if it has been changed since."""
    environment = describe_environment()
    commit = environment["revision"]
    return "unknown" if commit is None else commit[:10] + ("+" if environment["modified"] else "")


def _kept(path: Path, cases: Sequence[Case], seed: int, steps: int) -> dict[str, dict[str, Any]]:
    """Rows of an earlier call by name.

    Raises:
        InputError: they belong to another campaign.
    """
    if not path.exists():
        return {}
    table = pq.read_table(path)
    meta = json.loads((table.schema.metadata or {}).get(b"ampm_campaign", b"{}"))
    if meta != {"seed": seed, "steps": steps}:
        raise InputError(
            f"{path} holds a campaign of {meta}, not of seed {seed} and {steps} steps; give another folder."
        )
    wanted = {case.name: case.values for case in cases}
    return {
        row["name"]: row
        for row in table.to_pylist()
        if row["name"] in wanted and all(row[key] == value for key, value in wanted[row["name"]].items())
    }


def _save(path: Path, rows: Sequence[Mapping[str, Any]], seed: int, steps: int) -> None:
    """Write the table beside itself and rename it, so that an interrupt leaves a whole one."""
    table = pa.Table.from_pylist(
        [{name: row.get(name) for name in _COLUMNS.names} for row in rows], schema=_COLUMNS
    )
    meta = {"ampm_campaign": json.dumps({"seed": seed, "steps": steps})}
    partial = path.with_suffix(".partial")
    pq.write_table(table.replace_schema_metadata(meta), partial, compression="zstd")
    os.replace(partial, path)


# ------------------------------------------------------------------------- words


def summary(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Counts and quantiles of the drawn gaits (landmarks apart): lengths in m."""
    drawn = [row for row in rows if row["name"] not in LANDMARKS]
    refused = [row for row in drawn if row["outcome"] == "refused"]
    accepted = [row for row in drawn if row["outcome"] != "refused"]
    completed = [row for row in accepted if row["outcome"] == "completed"]
    answer: dict[str, Any] = {
        "drawn": len(drawn),
        "refused": len(refused),
        "refused_by_formula": sum(row["reason"] == "switching_velocity_too_low" for row in refused),
        "accepted": len(accepted),
        "completed": len(completed),
        "fell": [row["name"] for row in accepted if row["outcome"] != "completed"],
    }
    for name in ("zmp_rmse", "zmp_x_rmse", "zmp_y_rmse"):
        values = np.array([row[name] for row in completed])
        for label, share in (("median", 0.5), ("p90", 0.9), ("maximum", 1.0)):
            answer[f"{name}_{label}"] = float(np.quantile(values, share)) if values.size else None
    return answer


def page(rows: Sequence[Mapping[str, Any]], seed: int) -> str:
    """The tables as Markdown."""
    told = summary(rows)

    def mm(value: float | None) -> str:
        return "-" if value is None or math.isnan(value) else f"{1000 * value:.1f}"

    steps = rows[0]["steps"]
    revisions = sorted({row.get("revision") or "unknown" for row in rows})
    tuning = [row["tune_seconds"] for row in rows if row["tune_seconds"] is not None]
    lines = [
        f"{told['drawn']} gaits drawn (seed {seed}), {steps} steps each: {told['refused']} refused, "
        f"{told['refused_by_formula']} of them by the formula alone; {told['completed']} of the "
        f"{told['accepted']} accepted complete. Walked at revision {', '.join(revisions)}; tuning took "
        f"{np.median(tuning):.0f} s of processor time in the median, {max(tuning):.0f} s at most.",
        "",
        "| ZMP RMSE of those that complete [mm] | median | 90th percentile | largest |",
        "|---|---|---|---|",
    ]
    for label, name in (
        ("x", "zmp_x_rmse"),
        ("y", "zmp_y_rmse"),
        ("both, root of the sum of squares", "zmp_rmse"),
    ):
        cells = " | ".join(mm(told[f"{name}_{part}"]) for part in ("median", "p90", "maximum"))
        lines.append(f"| {label} | {cells} |")
    accepted = [row for row in rows if row["outcome"] != "refused"]
    lines += [
        "",
        "| gait | step [m] | v0 [m/s] | c_y | c_s | body [m] | body [kg] | outcome | ZMP RMSE x, y [mm] "
        "| maximum x, y [mm] | torque | knee [rad] | QPs at a limit |",
        "|---" * 13 + "|",
    ]
    for row in accepted:
        what = row["outcome"]
        if what != "completed":
            what += f" after {row['steps_completed']} steps"
        lines.append(
            f"| {row['name']} | {_drawn(row)} | {what} | {mm(row['zmp_x_rmse'])}, {mm(row['zmp_y_rmse'])} "
            f"| {mm(row['zmp_x_maximum'])}, {mm(row['zmp_y_maximum'])} | {row['torque']:.2f} "
            f"| {row['knee']:.2f} | {row['limited_qp']} |"
        )
    fallen = [row for row in accepted if row["outcome"] != "completed"]
    if fallen:
        lines += ["", "First causes of those that do not complete:", ""]
        lines += [f"- {row['name']}: {row['cause']}" for row in fallen]
    refused = [row for row in rows if row["outcome"] == "refused"]
    if refused:
        lines += [
            "",
            "| refused | step [m] | v0 [m/s] | c_y | c_s | body [m] | body [kg] | certificate |",
            "|---" * 8 + "|",
        ]
        lines += [f"| {row['name']} | {_drawn(row)} | {row['cause']} |" for row in refused]
    return "\n".join(lines) + "\n"


def _drawn(row: Mapping[str, Any]) -> str:
    """Cells of what was drawn."""
    return " | ".join(f"{row[key]:g}" for key in RANGE)


def publish(text: str, path: Path) -> None:
    """Put the tables into a page, between its marks.

    Raises:
        InputError: the page cannot be read or has no marks.
    """
    try:
        old = path.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(
            f"{path} cannot be read ({error.strerror}); give a page that has the marks {MARKS}."
        ) from None
    head, first, rest = old.partition(MARKS[0])
    _, last, tail = rest.partition(MARKS[1])
    if not (first and last):
        raise InputError(
            f"{path} lacks the marks {MARKS[0]} and {MARKS[1]}; put them where the tables belong."
        )
    path.write_text(f"{head}{first}\n{text}{last}{tail}", encoding="utf-8")

"""Golden values: every number that the project computed before it was re-arranged.

    python -m tests.golden                                 # check all, exit status 1 on a difference
    python -m tests.golden --only presets --preset normal  # in seconds
    python -m tests.golden --write                         # record the present values

Numbers are compared bit for bit. On another processor, or with other versions of what computes, arithmetic
rounds differently: values are then held to a relative tolerance of 1e-6, digests are not compared, and the
output says so. ``--bits`` compares bits all the same.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import json
import math
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import fields, is_dataclass
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import Any

FILE = Path(__file__).with_suffix(".json")
PRESETS = "normal momentum flat ipm pitch pitch-low roll-0.1 roll-0.4 roll-0.7 roll-1.0".split()
STEPS = 6
RELATIVE, ABSOLUTE = 1e-6, 1e-9  # on another processor; the second is for what is zero but for rounding
CORE = {"OPENBLAS_CORETYPE": "Haswell", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
CORE |= {"MUJOCO_GL": "disable"}
"""Of the environment: one kernel of linear algebra for all x86 machines, one thread, no display."""
VERSIONS = ("numpy", "scipy", "mujoco", "pin", "osqp", "daqp", "numba")
RECORD_FILES = ("joints.parquet", "ticks.parquet")
NOT_REPRODUCIBLE = tuple(
    "qp_time time_median time_p timing seconds memory_peak environment directory revision source "
    "files".split()
)
"""Beginnings of the names of what differs between equal runs: wall clock, memory, host, paths."""
BULKY = (
    "parameters statistics motion torque_by_joint display normalised margin tolerance by_study "
    "first_step effort_first_step measured_single_support measured_double_support sole"
).split()
"""Branches of JSON of which only digests are kept."""
TEXTS = ("outcome", "verdict", "pass", "text", "failed", "regression", "better")
"""Texts and flags that are kept as they are; of all others a digest."""
Values = dict[str, Any]


# ----------------------------------------------------------------------------------- calls, digests, tables


def ampm(*arguments: str | Path, json_out: bool = True) -> tuple[int, Any]:
    """Run ``ampm``: exit status, and its JSON or its text."""
    from validation.cli.app import call

    texts = [str(item) for item in arguments] + (["--json"] if json_out else [])
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        status = int(call(texts))
    if status not in (0, 1, 2, 3):
        raise RuntimeError(f"ampm {' '.join(texts)} ended with status {status}: {err.getvalue()[-2000:]}")
    return status, json.loads(out.getvalue()) if json_out else {"text": out.getvalue().strip()}


def values_of(*arguments: str | Path) -> Values:
    status, answer = ampm(*arguments)
    return {"status": status, **leaves(answer)}


def digest(array: Any) -> str:
    import numpy as np

    array = np.ascontiguousarray(array)
    if array.dtype.kind in "OU":
        return text_digest(array.tolist())
    return "#" + hashlib.sha256(f"{array.dtype.str}{array.shape}".encode() + array.tobytes()).hexdigest()[:12]


def text_digest(value: Any) -> str:
    return "#" + hashlib.sha256(json.dumps(value).encode()).hexdigest()[:12]


def columns(path: Path) -> Values:
    """Digest of each column of a Parquet file, the nulls with it, and its root mean square if it is real."""
    import numpy as np
    import pyarrow.parquet as pq

    found: Values = {}
    for name, column in zip((table := pq.read_table(path)).column_names, table.columns, strict=True):
        if skipped(name):
            continue
        array = column.to_numpy()  # a null among numbers is NaN
        found[name] = digest(array)
        if array.dtype.kind == "f" and not np.isnan(array).all():
            rms = np.sqrt(np.nanmean(np.square(array)))
            found[f"{name} rms"] = float(f"{rms:.10g}")
    return found


def record_values(folder: Path) -> Values:
    """Every field of the record, and each of its files as one."""
    import numpy as np

    from validation.store.record import load_record

    found: Values = {name: text_digest(columns(folder / name)) for name in RECORD_FILES}
    record = load_record(folder)
    for name in (field.name for field in fields(record)):
        value = getattr(record, name)
        if skipped(name) or name.startswith("external_"):
            continue
        if isinstance(value, Mapping):
            found[name] = text_digest([[key, digest(item)] for key, item in value.items()])
        elif isinstance(value, np.ndarray):
            found[name] = digest(value)
        else:
            found[name] = leaves(vars(value)) if is_dataclass(value) else plain(value)
    return found


def plain(value: Any) -> Any:
    """A scalar that JSON keeps to the bit."""
    finite = not isinstance(value, float) or math.isfinite(value)
    return value if finite and isinstance(value, bool | int | float | None) else str(value)


def is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def skipped(name: str) -> bool:
    return name.startswith(NOT_REPRODUCIBLE)


def flat(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Leaves of nested JSON by their path, without what differs between equal runs."""
    if isinstance(value, list) and value and all(is_number(item) for item in value):
        yield path, value
    elif isinstance(value, Mapping | list):
        for key, item in value.items() if isinstance(value, Mapping) else enumerate(value):
            if not skipped(str(key)):
                yield from flat(item, f"{path}.{key}" if path else str(key))
    else:
        yield path, plain(value)


def leaves(value: Any) -> Values:
    """Every number and the texts that matter; one digest of each bulky branch, and one of all other words."""
    kept: Values = {}
    bulk: dict[str, list[Any]] = {}
    for path, leaf in flat(value):
        keys = path.split(".")
        branch = next((key for key in keys if key in BULKY), "")
        if branch in ("parameters", "statistics"):
            branch = ".".join(keys[keys.index(branch) :][:2])
        if not branch and (
            (keys[-1] in TEXTS and leaf is not None) or is_number(leaf) or isinstance(leaf, list)
        ):
            kept[path] = leaf
        else:
            bulk.setdefault(branch or "words", []).append([path, leaf])
    return kept | {path: text_digest(items) for path, items in bulk.items()}


# --------------------------------------------------------------------------------------------------- parts


def preset(name: str, folder: Path) -> Values:
    steps, run = f"gait.steps={STEPS}", folder / "run"
    samples, motion = folder / "plan.parquet", folder / "motion.parquet"
    plan = values_of("plan", name, "--set", steps, "--samples", samples, "--motion", motion)
    status, said = ampm("validate", name, "--set", steps, "--out", run)
    saved = json.loads((run / "summary.json").read_text(encoding="utf-8"))
    for entry in (*saved["metrics"].values(), *said["metrics"].values()):
        del entry["label"], entry["kind"]  # written since the values were recorded
    summary = leaves(saved)
    if summary != leaves(said):
        raise RuntimeError(f"{name}: summary.json is not what validate --json says")
    return {
        "plan": plan,
        "plan table": columns(samples),
        "motion table": text_digest(columns(motion)),
        "summary": {"status": status, **summary},
        "files": {file: text_digest((run / file).read_text("utf-8")) for file in ("run.toml", "model.xml")},
        "record": record_values(run),
        "signals": columns(run / "signals.parquet"),
        "replay": leaves(ampm("replay", run, json_out=False)[1]),
    }


def walk_sweep(folder: Path, text: str) -> Values:
    import pyarrow.parquet as pq

    folder.mkdir()
    (folder / "sweep.toml").write_text(text, encoding="utf-8")
    status, _ = ampm("sweep", folder / "sweep.toml", "--out", folder / "out", "--workers", "2")
    (path,) = (folder / "out").glob("*.parquet")
    rows = pq.read_table(path).to_pylist()
    table: Values = {"status": status, "rows": len(rows)}
    for name in rows[0]:
        if not skipped(name):
            values = [plain(row[name]) for row in rows]  # as one, where all rows have the same
            table[name] = values[0] if len({repr(value) for value in values}) == 1 else values
    return table


def sweep(folder: Path) -> Values:
    """A grid, of which one corner is refused, crossed with a sampled block."""
    text = """
        sweep = { gait = "normal", steps = 3, profile = "wide", recordings = "none" }
        [[vary]]
        method = "grid"
        gait.c_s = [0.9, 1.2]
        gait.switching_velocity = [0.7, 1.0]
        [[vary]]
        method = "sobol"
        count = 2
        body.mass = { from = 50, to = 90, scale = "log" }
        gait.c_y = { from = 0.4, to = 1.0 }
        """
    return walk_sweep(folder / "sweep", text)


def diff(folder: Path) -> Values:
    """Two sweeps that differ in a gain of the controller."""
    text = """
        sweep = { gait = "normal", steps = 2, recordings = "none" }
        set = { controller.com_stiffness = GAIN }
        vary = [{ method = "list", gait.c_y = [0.6, 0.9] }]
        """
    for name, gain in (("a", "60.0"), ("b", "20.0")):
        walk_sweep(folder / name, text.replace("GAIN", gain))
    return values_of("diff", folder / "a" / "out", folder / "b" / "out")


def convergence(folder: Path) -> Values:
    options = "--steps 2 --levels 4 --study time_step --workers 2"
    return values_of("convergence", "normal", *options.split())


def compare(folder: Path) -> Values:
    return values_of("compare", "normal", "ipm", "--steps", "3", "--out", folder / "pair")


PARTS: dict[str, Callable[[Path], Values]] = {
    "sweep": sweep,
    "convergence": convergence,
    "diff": diff,
    "compare": compare,
}


# --------------------------------------------------------------------------------------- checking, writing


def host() -> dict[str, str]:
    """Processor and versions that bits depend on."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return {
        "processor": models[0] if models else "unknown",
        **{name: metadata.version(name) for name in VERSIONS},
    }


def differences(was: Any, now: Any, path: str, *, bits: bool) -> Iterator[str]:
    """Every leaf that differs, in words."""
    if isinstance(was, list) and isinstance(now, list) and len(was) == len(now):
        was, now = dict(enumerate(was)), dict(enumerate(now))
    if isinstance(was, Mapping) and isinstance(now, Mapping):
        for key in [*was, *(key for key in now if key not in was)]:
            pair = was.get(key, "absent"), now.get(key, "absent")
            yield from differences(*pair, f"{path} / {key}", bits=bits)
    elif not same(was, now, bits=bits):
        yield f"{path}: {was!r} -> {now!r}"


def same(was: Any, now: Any, *, bits: bool) -> bool:
    """To the bit, or as far as another processor computes the same."""
    if bits or type(was) is not type(now):
        return type(was) is type(now) and repr(was) == repr(now)
    if isinstance(was, float):
        return math.isclose(was, now, rel_tol=RELATIVE, abs_tol=ABSOLUTE)
    return was == now or (isinstance(was, str) and was.startswith("#") and now.startswith("#"))


def compute(parts: Sequence[str], presets: Sequence[str], folder: Path) -> Values:
    """Values of the requested parts, each with its time on stderr."""
    tasks: dict[str, Callable[[Path], Values]] = {
        f"preset {name}": partial(preset, name) for name in presets if "presets" in parts
    }
    tasks |= {name: part for name, part in PARTS.items() if name in parts}
    found: Values = {}
    for name, part in tasks.items():
        start = time.perf_counter()
        (at := folder / name.replace(" ", "-")).mkdir()
        found[name] = part(at)
        print(f"{name}: {time.perf_counter() - start:.1f} s", file=sys.stderr, flush=True)
    return json.loads(json.dumps(found, allow_nan=False))


def main() -> int:
    """Check or write; the exit status."""
    parser = argparse.ArgumentParser(description="Check the golden values.")
    parser.add_argument("--write", action="store_true", help="record the present values")
    parser.add_argument("--only", default="", help=f"presets,{','.join(PARTS)}")
    parser.add_argument("--preset", action="append", choices=PRESETS, help="repeatable; all by default")
    parser.add_argument("--bits", action="store_true", help="compare bits whatever the processor")
    options = parser.parse_args()
    parts = options.only.split(",") if options.only else ["presets", *PARTS]
    if unknown := set(parts) - {"presets", *PARTS}:
        parser.error(f"there is no part {', '.join(sorted(unknown))}")
    if any(os.environ.get(key) != value for key, value in CORE.items()):  # numpy reads it when it is loaded
        again = [sys.executable, "-m", "tests.golden", *sys.argv[1:]]
        os.execve(sys.executable, again, {**os.environ, **CORE})
    with tempfile.TemporaryDirectory() as folder:
        os.environ["XDG_CACHE_HOME"] = f"{folder}/cache"  # no solved motion of the user's
        found = compute(parts, options.preset or PRESETS, Path(folder))
    here, known = host(), json.loads(FILE.read_text(encoding="utf-8")) if FILE.exists() else {}
    values, comparable = known.get("values", {}), known.get("host") == here
    if options.write:
        values = {"host": here, "values": (values if comparable else {}) | found}
        FILE.write_text(json.dumps(values, indent=0, ensure_ascii=False) + "\n", encoding="utf-8")
        return 0
    bits = comparable or options.bits
    pairs = [(values.get(name), now, name) for name, now in found.items()]
    lines = [line for pair in pairs for line in differences(*pair, bits=bits)]
    print("\n".join([*lines, f"{len(lines)} differences in {', '.join(found)}"]))
    if not bits:
        print(f"recorded on {known.get('host')}, run on {here}:")
        print(f"values are held to a relative tolerance of {RELATIVE:g}, digests are not compared")
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())

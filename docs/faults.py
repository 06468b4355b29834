"""Seed faults in healthy walks and explain each; rewrite data/faults.csv, which docs/explain.md counts.

    python docs/faults.py [NUMBER ...]

Half an hour of two cores. Needs the extra ``robots``; with ``drake`` that engine is tried, too.
"""

import json
import re
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from trials import write_rows

import validation as val
from ampm.exceptions import InputError
from ampm.run_file import dump_run
from models.source import FOLDER, body_path, read_body_file, source_path
from validation.cli.console import Narrator
from validation.trial.plan import complete, load_request

KEPT = Path(__file__).parents[1] / "build" / "faults"
HUMAN, G1, OWN = "human", "G1", "own planner and controller"
OWN_PARTS = ("gait.planner='fault_parts:OwnPlanner'", "controller.name='fault_parts:OwnController'")


WALK = ("simulation.time_step=1e-3", "gait.steps=8")
"""Of all walks."""
WEAK = '[body.effort]\n".*_knee_joint" = 40.0'


class Fault(NamedTuple):
    """One fault.

    Attributes:
        name: in words.
        walk: healthy walk that gets it.
        layer: that is to be named; several where the fault is of both.
        settings: ``key=value`` texts.
    """

    name: str
    walk: str
    layer: str
    settings: Sequence[str]


def gait(walk: str) -> str:
    """Gait of a healthy walk; that of the G1 is found once, so that no fault changes it."""
    if walk != G1:
        return "normal"
    path = KEPT / "g1.toml"
    if not path.is_file():
        KEPT.mkdir(parents=True, exist_ok=True)
        path.write_text(dump_run(complete(load_request(None, ["body.source=g1"])).run), encoding="utf-8")
    return str(path)


def body(name: str, more: str = "", source: str = "") -> Path:
    """Description of a body like the G1 with further lines, or another source."""
    KEPT.mkdir(parents=True, exist_ok=True)
    lines = body_path("g1").read_text(encoding="utf-8")
    if source:
        lines = re.sub('source = ".*"', f'source = "{source}"', lines)
    path = KEPT / f"{name}.toml"
    path.write_text(f"{lines}\n{more}", encoding="utf-8")
    return path


def short_legs(metres: float) -> list[str]:
    """A planner and a controller that read another description, of a G1 with shorter shanks."""
    known = source_path(read_body_file(body_path("g1")).source, FOLDER)
    text = known.read_text(encoding="utf-8").replace("-0.30001", f"{metres - 0.30001:.5f}")
    (KEPT / "short-legs.urdf").write_text(
        text.replace("meshes/", f"{known.parents[1]}/meshes/"), encoding="utf-8"
    )
    file = body("short-legs", source="short-legs.urdf")
    return [*OWN_PARTS, f"planner.options.file='{file}'", f"controller.options.file='{file}'"]


def faults() -> list[Fault]:
    """All faults; every other one, from the first on, was seen while constants were chosen."""
    return [
        Fault("sensing 2 ms late", HUMAN, "sensing", ["sensors.delay=0.002"]),
        Fault("noisy joint rates", G1, "sensing", ["sensors.rate_noise=0.02"]),
        Fault("encoder offset of 5 mrad", HUMAN, "sensing", ["sensors.angle_bias=0.005"]),
        Fault("weak knees", G1, "motors", [f"body.source='{body('weak-knees', WEAK)}'"]),
        Fault("wrong mass", HUMAN, "body", ["disturbance.mass_change=0.03"]),
        Fault(
            "wrong centre of mass",
            G1,
            "body",
            ["disturbance.mass_segment=torso_link", "disturbance.mass_change=0.2"],
        ),
        Fault("dry friction in the joints", HUMAN, "body", ["disturbance.joint_friction=2.0"]),
        Fault("slippery floor", G1, "friction", ["disturbance.friction_factor=0.1"]),
        Fault("slope", HUMAN, "floor", ["disturbance.slope_along=0.02"]),
        Fault("soft floor", OWN, "floor", ["disturbance.softness_factor=4"]),
        Fault("stone", G1, "floor", ["disturbance.step_height=0.01", "disturbance.step_number=5"]),
        Fault(
            "two joints swapped",
            OWN,
            "controller",
            [
                "controller.options.fault=swapped",
                "controller.options.joints='left_ankle_pitch,left_ankle_roll'",
            ],
        ),
        Fault(
            "wrong sign of a joint",
            OWN,
            "controller",
            ["controller.options.fault=sign", "controller.options.joints=left_ankle_roll"],
        ),
        Fault(
            "gains too low",
            OWN,
            "controller",
            ["controller.options.fault=soft", "controller.options.share=0.05"],
        ),
        Fault("late plan", OWN, "planner", ["planner.options.fault=late", "planner.options.size=0.02"]),
        Fault(
            "plan of another height",
            OWN,
            "planner",
            ["planner.options.fault=other_height", "planner.options.size=0.1"],
        ),
        Fault(
            "plan of another mass",
            OWN,
            "planner",
            ["planner.options.fault=other_mass", "planner.options.size=0.05"],
        ),
        Fault(
            "ZMP 5 mm ahead",
            OWN,
            "planner",
            ["planner.options.fault=shifted_zmp", "planner.options.size=0.005"],
        ),
        Fault("feet too close", OWN, "planner", ["planner.options.fault=narrow", "planner.options.size=0.1"]),
        Fault(
            "feet 20 ms late",
            OWN,
            "planner",
            ["planner.options.fault=late_feet", "planner.options.size=0.02"],
        ),
        Fault(
            "time step of 7.5 ms",
            G1,
            "numerics",
            ["simulation.time_step=0.0075", "controller.frequency=133.33333333333334"],
        ),
        Fault("push", G1, "pushes", ["disturbance.push_y=80", "disturbance.push_at=1.5"]),
        Fault("short legs in the description", G1, "controller", short_legs(0.01)),
        Fault("torque bias", HUMAN, "motors", ["disturbance.torque_bias=0.5"]),
        Fault("foot flat early", HUMAN, "feet", ["foot.full_contact=0.2"]),
        Fault("foot flat early", G1, "feet", ["foot.full_contact=0.15"]),
        Fault("ten iterations of a QP", HUMAN, "numerics", ["solver.max_iterations=10"]),
        Fault("control at 40 Hz", G1, "controller", ["controller.frequency=40"]),
    ]


HEALTHY = tuple(Fault("none", walk, "", ()) for walk in (HUMAN, G1, OWN))
COLUMNS = (
    "number",
    "fault",
    "walk",
    "half",
    "settings",
    "seeded",
    "named",
    "right",
    "sentence",
    "walks",
    "seconds",
)


def main() -> None:
    """Explain what is missing, and write the data."""
    cases = [*faults(), *HEALTHY]
    wanted = [int(text) for text in sys.argv[1:] if text.isdigit()] or range(len(cases))
    for number in wanted:
        explained(number, cases[number])
    if len(wanted) == len(cases):
        write_rows("faults", [COLUMNS, *(row(number, fault) for number, fault in enumerate(cases))])


def explained(number: int, fault: Fault) -> None:
    """Explain a fault and keep the explanation."""
    start = time.monotonic()
    own = OWN_PARTS if fault.walk == OWN else ()
    settings = [*WALK, *own, *fault.settings]
    kept: dict[str, Any]
    try:
        kept = val.explain(gait(fault.walk), settings, workers=0, progress=Narrator()).as_dict()
    except InputError as error:
        if "contradicts itself" not in str(error):
            raise
        kept = {"named": "planner", "said": f"Refused: {str(error).partition(';')[0]}.", "changes": []}
    kept["seconds"] = time.monotonic() - start
    (KEPT / f"{number}.json").write_text(json.dumps(kept), encoding="utf-8")
    print(number, fault.name, fault.layer, kept["named"], kept["said"], kept["seconds"], flush=True)  # noqa: T201


def row(number: int, fault: Fault) -> tuple[str, ...]:
    """Row of the data for a fault."""
    found = json.loads((KEPT / f"{number}.json").read_text(encoding="utf-8"))
    right = found["named"] == fault.layer
    half = "" if not fault.layer else "shown" if number % 2 else "seen"
    return (
        str(number + 1),
        fault.name,
        fault.walk,
        half,
        "; ".join(fault.settings).replace(f"{KEPT}/", ""),
        fault.layer,
        found["named"],
        "yes" if right else "no",
        found["said"].replace(f"{KEPT}/", ""),
        str(1 + sum("metrics" in change for change in found["changes"])),
        f"{found['seconds']:.0f}",
    )


if __name__ == "__main__":
    main()

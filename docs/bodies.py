"""Walk the bodies of docs/body.md again: ``python docs/bodies.py`` writes docs/data/bodies.csv.

Every row is a body with the description that ``ampm body new`` proposes from its model and the keys that its
refusals name, or with a description of the project. It walks thirty steps of the gait of its size with
defaults, in up to a minute. Needs ``example-robot-data``, ``dm_control`` and ``playground``.
"""

from __future__ import annotations

import re
import tempfile
import tomllib
from pathlib import Path

import tomli_w
from trials import ending, write_rows

import ampm
import validation as val
from models.propose import propose
from models.source import body_path, known_bodies

_DATA, _PLAYGROUND = "example-robot-data:robots/", "playground:"
_OP3 = {
    "lock": ["head_tilt"],
    "range": {
        "l_(hip_yaw|hip_roll|hip_pitch|ank_pitch|ank_roll)": [-1.6, 1.6],
        "l_knee": [0.0, 2.3],
    },
    "damping": {".*": 0.1},  # a tenth of the model's
}
_H1 = {
    "sole": {
        "heel": -0.05,
        "front": 0.15,
        "bottom": -0.07,
        "heel_half_width": 0.03,
        "front_half_width": 0.03,
    }
}  # its foot is of capsules
_ICUB = {"gyration": {"._wrist_1": 0.05}, "armature": {"._wrist_prosup": 0.0005}}
_ROMEO = {
    "sole": tomllib.loads(body_path("romeo").read_text(encoding="utf-8"))["body"]["sole"]
}  # without toes
MODELS = {
    "alex": (f"{_DATA}alex_description/urdf/alex_nub_hands.urdf", {}),
    "alexander-proposed": (f"{_DATA}alexander_description/urdf/alexander_v1.lowerBodyOnly.urdf", {}),
    "apollo": (f"{_PLAYGROUND}apollo/xmls/apollo_mjx_feetonly.xml", {}),
    "berkeley": (f"{_PLAYGROUND}berkeley_humanoid/xmls/berkeley_humanoid_mjx_feetonly.xml", {}),
    "bolt": (f"{_DATA}bolt_description/robots/bolt.urdf", {}),
    "cmu": ("dm_control:suite/humanoid_CMU.xml", {}),
    "g1-playground": (f"{_PLAYGROUND}g1/xmls/g1_mjx_feetonly.xml", {}),
    "g1-proposed": (f"{_DATA}g1_description/urdf/g1_29dof_rev_1_0.urdf", {}),
    "h1": (f"{_PLAYGROUND}h1/xmls/h1_mjx_feetonly.xml", _H1),
    "human-urdf": (f"{_DATA}human_description/robots/human.urdf", {}),
    "icub-proposed": (f"{_DATA}icub_description/robots/icub_reduced.urdf", _ICUB),
    "op3": (f"{_PLAYGROUND}op3/xmls/op3_mjx_feetonly.xml", _OP3),
    "romeo-small": (f"{_DATA}romeo_description/urdf/romeo_small.urdf", _ROMEO),
    "talos-full": (f"{_DATA}talos_data/robots/talos_full_v2.urdf", {}),
    "talos-proposed": (f"{_DATA}talos_data/robots/talos_reduced.urdf", {}),
    "t1-proposed": (f"{_PLAYGROUND}t1/xmls/t1_mjx_feetonly.xml", {}),
}
"""Model of a body, and keys beside those that are proposed."""
BODIES = (*(name for name in known_bodies() if name != "human"), *MODELS)
WHERE = re.compile(r"'[^']*/(?=[^/']+')")
"""Folders of files in a sentence, which differ from machine to machine."""
COLUMNS = (
    "body",
    "joints",
    "mass [kg]",
    "result",
    "tolerances met",
    "ZMP RMSE x, y [% of sole]",
    "furthest metric",
    "of its limit [%]",
    "tilt [rad]",
    "c_s, c_y",
    "refused because",
)


def describe(name: str, folder: Path) -> str:
    """Description of a body: its name, or a file that is written."""
    if name not in MODELS:
        return name
    model, keys = MODELS[name]
    description = tomllib.loads(propose(model, folder))
    path = folder / f"{name}.toml"
    path.write_text(tomli_w.dumps({"body": description["body"] | keys}), encoding="utf-8")
    return str(path)


def row(name: str, steps: int = 30) -> dict[str, str]:
    """Walk a body; its cells by column."""
    cells = dict.fromkeys(COLUMNS, "") | {"body": name}
    with tempfile.TemporaryDirectory() as folder:
        try:
            run = ampm.load_run(body={"source": describe(name, Path(folder))}, gait={"steps": steps})
            trial = val.walk(run)
        except ampm.AmpmError as error:
            why = str(error).replace(folder, ".")
            return cells | {"result": "refused", "refused because": WHERE.sub("'", why)}
    description, judged = trial.planned.body.model.description, trial.verdict.judged
    tilt, gait = trial.comparison.costs["margins"]["tilt"].value, trial.planned.run.gait
    worst = max(judged, key=lambda item: item.value / max(item.tolerance or 0.0, 1e-9))
    share = 100.0 * worst.value / worst.tolerance if worst.tolerance else float("inf")
    zmp = (100.0 * trial.metrics[f"zmp_{axis}_rmse"].value / description.sole.length for axis in "xy")
    return cells | {
        "joints": str(len(description.mirror)),
        "mass [kg]": f"{description.mass:.1f}",
        "result": ending(trial.summary),
        "tolerances met": f"{len(judged) - len(trial.verdict.failed)} of {len(judged)}",
        "ZMP RMSE x, y [% of sole]": ", ".join(f"{value:.2f}" for value in zmp),
        "furthest metric": worst.label,
        "of its limit [%]": f"{share:.0f}",
        "tilt [rad]": f"{tilt:.2f}",
        "c_s, c_y": f"{gait.c_s:g}, {gait.c_y:g}",
    }


def main() -> None:
    """Walk every body and rewrite the table."""
    write_rows("bodies", [COLUMNS, *(tuple(row(name).values()) for name in BODIES)])


if __name__ == "__main__":
    main()

"""Draw the picture of docs/fit.md again: ``python docs/images/fit.py FILE``.

``FILE`` is ``Tutorials/Estimating_Joint_Reaction_Loads/subject01_walk1_grf.mot`` of the repository
opensim-org/opensim-models (CC BY 3.0), 15 s of subject 01 on a treadmill.
"""

import io
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

import validation as val
from validation.judge.fit import EXPLAINED, explained
from validation.show.chart import DASHED, WIDTH, Picture
from validation.show.fit import LOOKS, draw_fit
from validation.show.style import MEASURED, SHADE

PICTURE = Path(__file__).with_name("fit.png")
SPEED, HEIGHT = 1.12, 1.0
"""Of the belt [m/s]; of the COM [m]."""
SHOWN = ("zmp_x", "force_x", "zmp_y", "angular_momentum_y")
"""From left to right and from above; axes of the file: x forward, y up, z to the right."""


def read_plates(path: Path) -> dict[str, np.ndarray]:
    """Columns of a log of both feet."""
    header, _, body = path.read_text(encoding="utf-8").partition("endheader")[2].lstrip().partition("\n")
    found = dict(zip(header.split(), np.loadtxt(io.StringIO(body)).T, strict=True))
    table = {"time": found["time"], "belt_speed": np.full(len(found["time"]), SPEED)}
    for foot in ("left", "right"):
        force, cop = ([found[f"{foot}_foot_force_{kind}{axis}"] for axis in "xyz"] for kind in "vp")
        table |= {f"{foot}_force_x": force[0], f"{foot}_force_y": -force[2], f"{foot}_force_z": force[1]}
        table |= {f"{foot}_cop_x": cop[0], f"{foot}_cop_y": -cop[2]}
    return table


def main(path: Path) -> None:
    """Fit the walk, and draw four signals with two legends."""
    strides = val.fit_log(read_plates(path), com_height=HEIGHT).strides
    charts = []
    for place, name in enumerate(SHOWN):
        (chart,) = draw_fit(strides, explained(strides), EXPLAINED.index(name)).charts
        right, down = 72.0 * WIDTH * (place % 2), 190.0 * (place // 2)
        label_at = chart.label_at + right
        charts.append(replace(chart, left=chart.left + right, top=chart.top + down, label_at=label_at))
    nowhere = [np.nan], [np.nan]
    charts[0].line(*nowhere, MEASURED, 2.2, label="measured")
    for model, (label, color) in LOOKS.items():
        charts[0].line(*nowhere, color, 1.2, dash="" if model == "ampm" else DASHED, label=label)
    charts[1].area(*nowhere, MEASURED, opacity=0.25, label="95 % of the strides")
    charts[1].area(*nowhere, SHADE, label="double support")
    drawn = Picture(charts, "mean stride of a person").as_file("png")
    image = Image.open(io.BytesIO(drawn)).convert("RGB")
    image.quantize(64, dither=Image.Dither.NONE).save(PICTURE, optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))

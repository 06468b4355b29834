"""Run the scripts that draw in examples/, keep the pictures: ``python docs/images/examples.py``, a minute."""

from __future__ import annotations

import os
import runpy
import tempfile
from pathlib import Path

from PIL import Image

HERE = Path(__file__).resolve().parent


def main() -> None:
    """Draw the pictures again, in few colours."""
    for script in sorted((HERE.parents[1] / "examples").glob("*.py")):
        if script.stem == "tour":  # walks for an hour, and draws nothing
            continue
        with tempfile.TemporaryDirectory() as folder:
            os.chdir(folder)
            runpy.run_path(str(script), run_name="__main__")
            os.chdir(HERE)
            for picture in Path(folder).glob("*.png"):
                image = Image.open(picture).convert("RGB")
                image.quantize(128, dither=Image.Dither.NONE).save(HERE / picture.name, optimize=True)


if __name__ == "__main__":
    main()

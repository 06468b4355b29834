"""Write ``models/human.xml``: the default body as MJCF, committed so that a change shows as a diff."""

import sys
from pathlib import Path

from ampm.parameters import RunParameters
from models.human import build

TARGET = Path(__file__).with_name("human.xml")


def default_xml() -> str:
    """MJCF of the default body."""
    run = RunParameters()
    return build(run.body, run.contact, run.simulation).xml


if __name__ == "__main__":
    TARGET.write_text(default_xml(), encoding="utf-8")
    sys.stdout.write(f"wrote {TARGET}\n")

"""Draw the pictures of the documentation again: ``python docs/images/make.py RUN_FOLDER [TIME]``.

Needs a Vulkan driver; Mesa's software one will do (``mesa-vulkan-drivers`` on Debian).
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

from PIL import Image
from rerun.experimental import ViewerClient

from validation.console import Silent
from validation.planning import plan, request, write_picture

HERE = Path(__file__).resolve().parent
MENU_BAR = 36
"""Height of the viewer's menu bar [px], which says more of the machine than of the walk."""


def picture_of_recording(run_dir: Path, seconds: float, target: Path, *, port: int = 9911) -> None:
    """Save what the viewer shows of a run's recording at one time.

    Args:
        run_dir: folder of a run.
        seconds: simulated time [s].
        target: PNG to write.
        port: a free TCP port.
    """
    rerun = Path(sys.executable).with_name("rerun")
    with (
        tempfile.TemporaryDirectory() as folder,
        ViewerClient.spawn(
            headless=True, port=port, hide_welcome_screen=True, executable_path=str(rerun)
        ) as viewer,
    ):
        shot = Path(folder) / "shot.png"
        viewer.open(str((run_dir / "recording.rrd").resolve()))
        time.sleep(2.0)
        viewer.set_time("sim_time", duration=seconds, play_state="paused")
        time.sleep(2.5)
        viewer.save_screenshot(str(shot))
        image = Image.open(shot).convert("RGB")
        image = image.crop((0, MENU_BAR, image.width, image.height - MENU_BAR))
        image.quantize(192, dither=Image.Dither.NONE).save(target, optimize=True)


def picture_of_plan(gait: str, target: Path) -> None:
    """Save the picture that ``ampm plan --plot`` draws, in few colours."""
    with tempfile.TemporaryDirectory() as folder:
        drawn = Path(folder) / "plan.png"
        write_picture(plan(request(gait, ()), with_body=True, stages=Silent()), drawn)
        image = Image.open(drawn).convert("RGB")
        image.quantize(64, dither=Image.Dither.NONE).save(target, optimize=True)


if __name__ == "__main__":
    picture_of_plan("momentum", HERE / "plan.png")
    picture_of_recording(
        Path(sys.argv[1]), float(sys.argv[2]) if len(sys.argv) > 2 else 5.0, HERE / "recording.png"
    )

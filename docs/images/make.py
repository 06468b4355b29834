"""Draw the pictures of the documentation again: ``python docs/images/make.py MOMENTUM TIME RUN RUN``.

The first folder is a run of this preset; the time is the end of a single support of it [s]. The other two are
shown together: ``normal`` with 8 steps and ``controller.hold`` ``zero-order`` and ``first-order``.

Needs a Vulkan driver; Mesa's software one will do (``mesa-vulkan-drivers`` on Debian).
"""

import contextlib
import sys
import tempfile
import time
from pathlib import Path

from PIL import Image
from rerun.experimental import ViewerClient

from validation.cli.validate import recording_of
from validation.show.plan import plot_plan
from validation.show.rerun.views import PHASE
from validation.trial.plan import load_request, plan_walk

HERE = Path(__file__).resolve().parent
MENU_BAR, TIME_PANEL = 36, 29
"""Heights of the viewer's menu bar and time panel [px], which are cut off."""


def picture_of_recording(
    recording: Path,
    time_at: float,
    target: Path,
    *,
    timeline: str = "sim_time",
    port: int = 9911,
) -> None:
    """Save the viewer's picture of a recording at one time.

    Args:
        recording: the file.
        time_at: place on the timeline [s].
        target: PNG to write.
        timeline: name of the timeline.
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
        viewer.open(str(recording.resolve()))
        time.sleep(4.0)
        viewer.set_time(timeline, duration=time_at, play_state="paused")
        time.sleep(4.0)
        for _ in range(5):  # software rendering on a busy machine may take longer than the viewer waits
            with contextlib.suppress(TimeoutError):
                viewer.save_screenshot(str(shot))
                break
        image = Image.open(shot).convert("RGB")
        image = image.crop((0, MENU_BAR, image.width, image.height - TIME_PANEL))
        in_few_colours(image).save(target, optimize=True)


def in_few_colours(image: Image.Image) -> Image.Image:
    """An image with a palette of its commonest colours and of rare ones, such as those of a legend."""
    common = image.quantize(160, dither=Image.Dither.NONE).getpalette() or []
    rare = image.quantize(96, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).getpalette() or []
    both = Image.new("P", (1, 1))
    both.putpalette([*common, *rare])
    return image.quantize(palette=both, dither=Image.Dither.NONE)


def picture_of_several(folders: list[Path], phase: float, target: Path) -> None:
    """Save the viewer's picture of several runs of one gait at one phase."""
    with tempfile.TemporaryDirectory() as folder:
        picture_of_recording(recording_of(folders, Path(folder)), phase, target, timeline=PHASE, port=9912)


def picture_of_plan(gait: str, target: Path) -> None:
    """Save the picture that ``ampm plan --plot`` draws, in few colours."""
    with tempfile.TemporaryDirectory() as folder:
        drawn = Path(folder) / "plan.png"
        plot_plan(plan_walk(load_request(gait)).plan, drawn, title=f"plan of {gait}")
        image = Image.open(drawn).convert("RGB")
        in_few_colours(image).save(target, optimize=True)


if __name__ == "__main__":
    picture_of_plan("momentum", HERE / "plan.png")
    momentum, *overlaid = (Path(argument) for argument in (sys.argv[1], *sys.argv[3:]))
    picture_of_recording(momentum / "recording.rrd", float(sys.argv[2]), HERE / "recording.png")
    picture_of_several(overlaid, 4.3, HERE / "overlay.png")

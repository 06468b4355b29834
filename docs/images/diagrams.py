"""Draw the diagrams of architecture.md and controller.md again: ``python docs/images/diagrams.py``."""

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).resolve().parent
FONT = "system-ui, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif"
INK, LINE, GROUND = "#1d2733", "#5b6775", "#ffffff"
FILLS = {
    "plan": ("#e3eefb", "#1f6fb4"),
    "body": ("#e5f4ea", "#2a8c4a"),
    "world": ("#fdebdc", "#c2571a"),
    "judge": ("#f0e8f8", "#7a3fa0"),
    "plain": ("#f4f6f8", "#8a93a3"),
}


class Box(NamedTuple):
    """A box: its middle and size [px], a title, lines below it, and its kind of fill."""

    x: float
    y: float
    width: float
    height: float
    title: str
    lines: Sequence[str] = ()
    kind: str = "plain"

    def draw(self) -> str:
        """SVG of the box."""
        fill, edge = FILLS[self.kind]
        left, top = self.x - self.width / 2, self.y - self.height / 2
        first = self.y - 9.5 * len(self.lines) + 5
        parts = [
            f'<rect x="{left:g}" y="{top:g}" width="{self.width:g}" height="{self.height:g}" rx="8" '
            f'fill="{fill}" stroke="{edge}" stroke-width="1.4"/>',
            text(self.x, first, self.title, weight=600),
        ]
        parts += [
            text(self.x, first + 19 * number, line, size=14.5, color=LINE)
            for number, line in enumerate(self.lines, start=1)
        ]
        return "".join(parts)


def text(x: float, y: float, words: str, **look: object) -> str:
    """SVG of one line of text about a middle [px]; look: size, weight, color, anchor."""
    size, weight = look.get("size", 16.5), look.get("weight", 400)
    color, anchor = look.get("color", INK), look.get("anchor", "middle")
    style = f'font-size="{size}" font-weight="{weight}" fill="{color}" text-anchor="{anchor}"'
    return f'<text x="{x:g}" y="{y:g}" {style}>{escape(words)}</text>'


def arrow(*points: tuple[float, float], label: str = "", at: tuple[float, float] | None = None) -> str:
    """SVG of a line through points [px] with a head at its end; ``at`` is the middle of its label."""
    path = " ".join(f"{x:g},{y:g}" for x, y in points)
    drawn = (
        f'<polyline points="{path}" fill="none" stroke="{LINE}" stroke-width="1.6" marker-end="url(#head)"/>'
    )
    if label and at:
        drawn += text(*at, label, size=14.5)
    return drawn


def group(left: float, top: float, width: float, height: float, title: str, indent: float = 14) -> str:
    """SVG of a dashed frame with a title in its upper part."""
    frame = (
        f'<rect x="{left:g}" y="{top:g}" width="{width:g}" height="{height:g}" rx="12" fill="none" '
        f'stroke="#b4bcc8" stroke-width="1.2" stroke-dasharray="6 5"/>'
    )
    return frame + text(left + indent, top + 21, title, size=15, color=LINE, anchor="start", weight=600)


def write(name: str, width: int, height: int, about: str, parts: Sequence[str]) -> None:
    """Write ``NAME.svg`` on its own white ground, legible on light and dark pages."""
    head = (
        '<marker id="head" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="7.5" markerHeight="7.5" '
        f'orient="auto-start-reverse"><path d="M0 0 10 5 0 10z" fill="{LINE}"/></marker>'
    )
    svg = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" '
        f'height="{height}" role="img" font-family="{FONT}"><title>{escape(about)}</title><defs>{head}</defs>'
        f'<rect width="{width}" height="{height}" rx="10" fill="{GROUND}"/>' + "\n".join(parts) + "</svg>\n"
    )
    HERE.joinpath(f"{name}.svg").write_text(svg, encoding="utf-8")


def architecture() -> None:
    """From a run to a verdict, and who owns what."""
    boxes = [
        Box(110, 105, 150, 66, "run", ["parameters, TOML"]),
        Box(110, 215, 150, 66, "body", ["URDF, MJCF"], "body"),
        Box(330, 160, 150, 84, "Planner", ["AMPM, table,", "your class"], "plan"),
        Box(560, 160, 160, 84, "WalkPlan", ["COM, ZMP, feet,", "momentum, posture"], "plan"),
        Box(330, 390, 150, 84, "Controller", ["tracking QP,", "your class"], "body"),
        Box(560, 390, 160, 84, "Engine", ["MuJoCo or Drake,", "disturbances"], "world"),
        Box(445, 510, 200, 66, "sensors, estimator", ["exact, Kalman, own class"], "body"),
        Box(800, 390, 160, 84, "record", ["states, forces,", "torques"], "world"),
        Box(800, 275, 160, 66, "measurement", ["without the plan"], "judge"),
        Box(800, 160, 160, 84, "comparison", ["measurement", "minus plan"], "judge"),
        Box(1000, 160, 130, 84, "verdict", ["metrics, cost,", "limits"], "judge"),
        Box(1000, 290, 130, 84, "files", ["report, data,", "recording"]),
    ]
    lines = [
        group(20, 30, 640, 240, "ampm: plans, and imports no simulator"),
        group(200, 305, 460, 255, "the closed loop, once a control tick", 146),
        group(700, 30, 385, 420, "validation: records, measures, judges"),
        arrow((185, 105), (220, 105), (220, 145), (254, 145)),
        arrow((185, 215), (220, 215), (220, 175), (254, 175)),
        arrow((405, 160), (479, 160)),
        arrow((560, 202), (560, 294), (330, 294), (330, 347), label="Reference: one instant", at=(445, 288)),
        arrow((405, 390), (479, 390), label="torque", at=(440, 381)),
        arrow((610, 432), (610, 510), (546, 510), label="readings", at=(585, 527)),
        arrow((345, 510), (280, 510), (280, 433), label="State, Touch", at=(281, 530)),
        arrow((640, 390), (719, 390)),
        arrow((800, 348), (800, 309)),
        arrow((800, 242), (800, 203)),
        arrow((640, 160), (719, 160)),
        arrow((880, 160), (934, 160)),
        arrow((1000, 202), (1000, 247)),
    ]
    about = "Architecture: run and body, planner, plan, closed loop, record, measurement, comparison, verdict"
    write("architecture", 1105, 580, about, [*lines, *(box.draw() for box in boxes)])


def tick() -> None:
    """The steps of a control tick in their order, as ``ampm.control.tick`` has them."""
    x, top, upper, lower = (180, 410, 640, 870), 62, 205, 375
    boxes = [
        Box(235, top, 290, 66, "State, Touch", ["q, v; force on every sole point"], "world"),
        Box(
            685, top, 550, 66, "Reference", ["one instant of the plan: COM, momentum, feet, posture"], "plan"
        ),
        Box(x[0], upper, 180, 84, "kinematics", ["Jacobians, drift,", "COM, momentum"], "body"),
        Box(x[1], upper, 180, 84, "contacts", ["which sole points", "may carry force"], "body"),
        Box(x[2], upper, 180, 84, "command", ["wrench: the plan's", "plus feedback"], "body"),
        Box(x[3], upper, 180, 84, "tasks", ["accelerations of feet,", "toes, posture"], "body"),
        Box(x[3], lower, 180, 84, "elimination", ["accelerations by", "contact forces"], "judge"),
        Box(x[2], lower, 180, 84, "QP", ["contact forces near", "the command"], "judge"),
        Box(x[1], lower, 180, 84, "accelerations", ["of all joints,", "from the forces"], "body"),
        Box(x[0], lower, 180, 84, "torques", ["by inverse", "dynamics"], "body"),
    ]
    low, high = upper - 43, top + 33
    lines = [
        *(arrow((at, high), (at, low)) for at in (x[0], x[1] - 50, x[1] + 50, x[2], x[3])),
        *(arrow((left + 90, upper), (left + 139, upper)) for left in x[:3]),
        arrow((x[3], upper + 42), (x[3], lower - 43)),
        *(arrow((right - 90, lower), (right - 139, lower)) for right in x[:0:-1]),
        arrow((x[0] - 90, lower), (28, lower), label="motors", at=(50, lower - 10)),
        arrow((x[0], lower + 42), (x[0], lower + 80), (x[2], lower + 80), (x[2], lower + 43)),
        text(x[1], lower + 98, "if a torque or joint limit is broken: once more, with limits", size=14.5),
    ]
    write("tick", 990, 495, "Block diagram of one control tick", [*lines, *(box.draw() for box in boxes)])


if __name__ == "__main__":
    architecture()
    tick()

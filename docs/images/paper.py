"""Draw the figures of docs/paper.md again and rewrite its tables: ``python docs/images/paper.py``.

Takes some minutes; ``python docs/images/paper.py human`` draws only these. Light blue is the plan, dark
blue the whole-body motion of the inverse kinematics (IK), orange the simulation: every stride but the first.
"""

import re
import sys
from functools import cache
from pathlib import Path

import matplotlib as mpl
import mujoco
import numpy as np
from matplotlib.figure import Figure

import ampm
import validation as val

HERE = Path(__file__).resolve().parent
PAGE = HERE.parent / "paper.md"
PEOPLE = HERE.parent / "data" / "walking-ground-force.csv"

INK, FAINT, SHADE, BAND = "#1d2126", "#6c737d", "#eceef1", "#f4cfb2"
PLAN, MOTION, MEASURED, FORCE = "#8ec1dd", "#00507d", "#d55e00", "#009e73"
SIDES = {"left": "#8f2a62", "right": "#a67c00", "trunk": "#3e4c59"}
STYLE = {
    "svg.hashsalt": "ampm",
    "axes.titlesize": 9,
    "axes.titlelocation": "left",
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e4e7eb",
    "figure.constrained_layout.use": True,
}


class Walk:
    """A trial, cut into strides, each from the start of a left single support; the first one is left out."""

    def __init__(self, trial):
        self.trial, self.plan, self.gait = trial, trial.plan, trial.run.gait
        self.robot = trial.planned.body.robot
        self.single = self.plan.constants.single_support_duration
        self.double = self.plan.constants.double_support_duration
        self.stride = 2.0 * (self.single + self.double)
        self.phase = np.arange(0.0, self.stride, 0.002)
        self.starts = self.stride * np.arange(1, round(trial.record.time[-1] / self.stride))
        self.planned = self.plan.sample(self.starts[0] + self.phase)
        self.posture = self.plan.posture.sample(self.starts[0] + self.phase)

    def folded(self, values, time=None):
        """Recorded values, shape (K, d), of every stride at its own times, shape (strides, n, d)."""
        time = self.trial.record.time[: len(values)] if time is None else time
        at = self.starts[:, None] + self.phase
        return np.stack([np.interp(at, time, column) for column in values.T], axis=-1)

    def against(self, name, component):
        """Plan over a stride, shape (n,), and simulated strides, (strides, n): plan plus measured error."""
        measured = self.trial.measured
        target = getattr(self.plan.sample(measured.time), name)
        error = self.folded(getattr(measured, name)[:, : target.shape[1]] - target)
        planned = getattr(self.planned, name)[:, component]
        return planned, planned + error[..., component]

    def joint(self, name):
        """Acceleration of a hinge [rad/s^2]: of the motion, of the simulation over 10 ms."""
        record, model = self.trial.record, self.robot.model
        velocity = record.qd[:, 6 + record.joint_names.index(name)]
        n = round(0.01 / record.time_step)
        change = (velocity[n:] - velocity[:-n]) / (n * record.time_step)
        simulated = self.folded(change[:, None], 0.5 * (record.time[n:] + record.time[:-n]))
        return self.posture.acceleration[:, model.joints[model.getJointId(name)].idx_v], simulated[..., 0]

    def simulated(self, times):
        """The simulated body at each of some times, as MuJoCo's data."""
        record, model = self.trial.record, self.trial.planned.body.model.compile()
        data = mujoco.MjData(model)
        for row in np.searchsorted(record.time, times):
            data.qpos[:] = record.q[row]
            mujoco.mj_kinematics(model, data)
            yield data

    def trunk(self, component):
        """Roll (0) or pitch (1) of the trunk: of the motion, of the simulation [deg]."""
        times = np.arange(self.starts[0], self.trial.record.time[-1], 0.002)
        trunk = self.robot.description.trunk_segment
        up = np.array([data.body(trunk).xmat[2::3].copy() for data in self.simulated(times)])
        simulated = self.folded(lean(up, component)[:, None], times)
        return lean(self.posture.trunk[:, :, 2], component), simulated[..., 0]


def lean(up, component):
    """Roll (0) or pitch (1) from the trunk's own vertical axis, shape (n, 3) [deg]."""
    return np.degrees(np.arctan2((-up[:, 1], up[:, 0])[component], up[:, 2]))


@cache
def walk(gait, *settings, steps=12):
    """A walk of a preset, as it is."""
    trial = val.walk(ampm.load_run(gait, [*settings, f"gait.steps={steps}"]).as_is())
    if not trial.record.outcome.completed:
        raise SystemExit(f"{gait}: {trial.record.outcome.summary}")
    return Walk(trial)


def planned(*settings):
    """A walk of ``normal`` with some settings, planned but not walked."""
    run = ampm.load_run("normal", settings).as_is()
    return ampm.PeriodicPlanner().plan(run, walk("normal").robot)


def shade(axis, walk, line="-", label=""):
    """Axis of a stride; its double supports are shaded, or between dashes for a walk with dashed curves."""
    for start in (walk.single, 0.5 * walk.stride + walk.single):
        name = label if start == walk.single else ""
        if line == "-":
            axis.axvspan(start, start + walk.double, color=SHADE, linewidth=0, zorder=0, label=name)
        else:
            axis.axvline(start, color=FAINT, linewidth=0.8, linestyle=line, label=name)
            axis.axvline(start + walk.double, color=FAINT, linewidth=0.8, linestyle=line)
    axis.set(xlim=(0.0, walk.stride), xlabel="time in the stride [s]")


def curves(axis, walk, reference, simulated, color=PLAN, label="", line="-"):
    """Plan (light) or motion (dark), and simulation: mean and spread of the strides."""
    shade(axis, walk, line, f"double support{label}")
    axis.fill_between(walk.phase, simulated.min(axis=0), simulated.max(axis=0), color=BAND, linewidth=0)
    name = "plan" if color == PLAN else "IK"
    axis.plot(walk.phase, reference, line, color=color, linewidth=3, label=f"{name}{label}")
    axis.plot(
        walk.phase, simulated.mean(axis=0), line, color=MEASURED, linewidth=0.9, label=f"simulation{label}"
    )


def errors(axis, walk, against, simulated, what, scale, unit):
    """Every stride of the simulation less the plan or the motion."""
    shade(axis, walk)
    off = scale * (simulated - against)
    axis.plot(walk.phase, off.T, color=MEASURED, linewidth=0.5, alpha=0.6)
    said = f"RMSE {np.sqrt(np.mean(off**2)):.2g}, largest {np.abs(off).max():.2g} {unit}"
    axis.set_title(f"{what}: {said}", fontsize=8.5)
    axis.set_ylabel(f"[{unit}]")


def support(axis, its, component, start, span, origin):
    """Draw COM, ZMP and ground force during one support, from an origin."""
    plan, height = its.plan, its.gait.com_height
    at = (start <= its.phase) & (its.phase <= start + span)
    travel = its.planned.com[0, component] - plan.sample(0.0).com[0, component]
    for name, level in (("com", height), ("zmp", 0.0)):
        planned, simulated = its.against(name, component)
        for values, color, width in ((planned, PLAN, 5.0), (simulated.mean(axis=0), MEASURED, 0.9)):
            x = values[at] - travel - origin
            axis.plot(x, np.full(len(x), level), color=color, linewidth=width)
    sample = plan.sample(start + span * np.linspace(1e-9, 1.0 - 1e-9, 5))
    com, zmp = sample.com[:, component] - origin, sample.zmp[:, component] - origin
    axis.locator_params(axis="x", nbins=5)
    axis.plot([zmp, com], [[0.0] * 5, [height] * 5], "o--", color=FAINT, linewidth=0.7)
    for x, force in zip(zmp, sample.force / plan.weight, strict=True):
        arrow(axis, x, force[[component, 2]])


def plane(component):
    """Fig. 4 (0) and 5 (1): sagittal and frontal plane of ``momentum``, and the simulation less the plan."""
    its, letter, figure = walk("momentum"), "xy"[component], Figure(figsize=(8.6, 9.0))
    axes, k = figure.subplot_mosaic("sd;CC;ZZ", height_ratios=(3.2, 1, 1)), its.plan.constants
    foot = its.plan.contacts.footsteps[1].position[component]
    middle = foot + 0.5 * its.gait.step_length if component == 0 else 0.0
    support(axes["s"], its, component, 0.0, its.single, foot)
    support(axes["d"], its, component, its.single, its.double, middle)
    lengths = (
        f"l_s = {k.l_s:.3f}, l_d = {k.l_d:.3f} m" if component == 0 else f"s = {k.s:.3f}, β = {k.beta:.3f} m"
    )
    axes["s"].set(title=f"single support; {lengths}", xlabel=f"{letter} from the stance foot [m]")
    axes["s"].set_ylabel("z [m]")
    axes["d"].set(title="double support", xlabel=f"{letter} from the middle of the feet [m]")
    for row, name in (("C", "com"), ("Z", "zmp")):
        errors(axes[row], its, *its.against(name, component), f"{name.upper()} {letter} less plan", 1e3, "mm")
    return figure, {}


def arrow(axis, foot, force):
    """A ground force in body weights, from the floor."""
    head = {"arrowstyle": "-|>", "color": FORCE, "linewidth": 1.5, "shrinkA": 0, "shrinkB": 0}
    axis.annotate("", (foot + 0.6 * force[0], 0.6 * force[1]), (foot, 0.0), arrowprops=head, zorder=6)


def figure_7():
    """The foot's key-frames."""
    its = walk("normal")
    figure = Figure(figsize=(9.6, 5.0))
    axes = figure.subplot_mosaic("aa;bc", height_ratios=(1.2, 1))
    time = np.linspace(-its.double, its.single + its.double, 1200)
    foot, sole = its.plan.feet.sample(its.stride + time)[1], its.robot.description.sole
    heel, ball, tip = (foot.sole_points[:, k : k + 2].mean(axis=1)[:, [0, 2]] for k in (0, 2, 4))
    axes["a"].plot(*ball.T, color=MOTION, label="path of the ball")
    frames = (-its.double, 0.0, 0.5 * its.single, its.single, its.single + 0.9 * its.double)
    for k in np.searchsorted(time, frames):
        axes["a"].plot(*np.transpose([heel[k], ball[k], tip[k]]), "o-", color=MOTION, linewidth=2.2)
    speed = foot.velocity[:, 0] - sole.ball_x * np.sin(foot.pitch) * foot.pitch_velocity
    axes["b"].plot(time, speed, color=MOTION)
    plan, zmp = its.against("zmp", 0)
    axes["c"].plot(its.phase, 1e3 * (zmp - plan).T, color=MEASURED, linewidth=0.5, alpha=0.5)
    axes["a"].set(title="(a) key-frames of the right foot [m]", aspect="equal")
    axes["b"].set(title="(b) speed of the ball [m/s]", xlabel="time from lift-off [s]")
    axes["c"].set(title="(c) ZMP x less plan [mm]")
    shade(axes["c"], its)
    axes["a"].legend(loc="upper right")
    return figure, {}


def chains(body, data):
    """Segments of a simulated body: side, width [pt], points, shape (k, 3) [m]."""

    def joint(name):
        return data.joint(name).xanchor.copy()

    def sole(leg, first):
        return np.mean([data.site(name).xpos for name in leg.sole_points[first : first + 2]], axis=0)

    girdle = [joint(arm[0]) for arm in (body.left_arm, body.right_arm)]
    sockets = [joint(leg.hip[0]) for leg in body.legs]
    waist, chest = map(joint, body.trunk[::3])  # three hinges each
    shoulders = np.mean(girdle, axis=0)
    head = shoulders + 0.8 * (shoulders - chest)
    trunk = [np.mean(sockets, axis=0), waist, chest, shoulders]
    yield from (("trunk", 4.0, sockets), ("trunk", 8.0, trunk), ("trunk", 4.0, girdle))
    yield "trunk", 11.0, [head, head]
    for side, leg, arm in (("right", body.right_leg, body.right_arm), ("left", body.left_leg, body.left_arm)):
        heel, ball, tip, ankle = *(sole(leg, first) for first in (0, 2, 4)), joint(leg.ankle[0])
        yield side, 5.0, [joint(leg.hip[0]), joint(leg.knee), ankle]
        yield side, 2.2, [ankle, heel, ball, ankle]
        yield side, 1.8, [ball, tip]
        yield side, 3.0, [joint(arm[0]), joint(arm[3]), joint(arm[-1])]


def strip(axis, its, view, title):
    """A stride in nine frames; view 0 is from the right, 1 from the front."""
    measured, body = its.trial.measured, its.robot.description
    step, start = 0.5 * its.stride, its.starts[len(its.starts) // 2]
    instants = (0.0, 0.35 * its.single, 0.7 * its.single, its.single + 0.5 * its.double)
    instants = start + np.array([*instants, *(step + at for at in instants), its.stride - 0.01])
    for frame, (time, state) in enumerate(zip(instants, its.simulated(instants), strict=True)):
        row, com = np.searchsorted(measured.time, time), its.plan.sample([time]).com[0]
        shift = 0.95 * frame - (com[0] if view == 0 else 0.0)
        for side, width, points in chains(body, state):
            along, up = np.transpose(points)[[view, 2]]
            axis.plot(along + shift, up, color=SIDES[side], linewidth=width, solid_capstyle="round")
        axis.plot(com[view] + shift, com[2], "o", color="white", markeredgecolor=INK, markersize=6, zorder=5)
        for foot, force in enumerate(measured.foot_force[row]):
            if force[2] > 0.08 * measured.weight:
                turn = measured.foot_torque[row, foot]
                centre = (-turn[1], turn[0])[view] / force[2] + shift
                arrow(axis, centre, force[[view, 2]] / measured.weight)
        axis.text(0.95 * frame, -0.05, f"{100 * (time - start) / its.stride:.0f} %", ha="center", va="top")
    axis.set(aspect="equal", title=title, xticks=[], yticks=[0.0, 1.0], ylim=(-0.2, 1.85), ylabel="z [m]")


def figure_8():
    """Side view of the normal gait, and its COM less the plan."""
    its, figure = walk("normal"), Figure(figsize=(9.6, 4.6))
    axes = figure.subplot_mosaic("AAA;xyz", height_ratios=(1.7, 1))
    strip(axes["A"], its, 0, "one stride of the simulation; ring: COM of the plan")
    for k, name in enumerate("xyz"):
        errors(axes[name], its, *its.against("com", k), f"COM {name}", 1e3, "mm")
    return figure, {}


def stacked(values, unit, against, color):
    """Two pairs of curves, each over its error."""
    its, figure = walk("normal"), Figure(figsize=(8.4, 8.0))
    axes = figure.subplots(4, 1, height_ratios=(2, 0.9, 2, 0.9))
    for upper, lower, (title, pair) in zip(axes[::2], axes[1::2], values.items(), strict=True):
        curves(upper, its, *pair, color)
        upper.set(title=f"acceleration of {title}", ylabel=f"[{unit}]")
        errors(lower, its, *pair, f"less {against}", 1.0, unit)
    axes[0].legend()
    return figure, {}


def figure_9():
    """COM acceleration; that of the simulation is contact force over mass."""
    its, measured = walk("normal"), walk("normal").trial.measured
    simulated = its.folded(measured.force / measured.mass)
    pairs = {f"the COM, {'xy'[k]}": (its.planned.com_acceleration[:, k], simulated[..., k]) for k in (0, 1)}
    return stacked(pairs, "m/s²", "plan", PLAN)


def figure_10():
    """Flexion accelerations of the left hip and knee, which no plan has."""
    its, leg = walk("normal"), walk("normal").robot.description.left_leg
    hip = [-values for values in its.joint(leg.hip[0])]
    return stacked({"the left hip": hip, "the left knee": its.joint(leg.knee)}, "rad/s²", "IK", MOTION)


def turned(names, component, height):
    """Fig. 11 (0) and 12 (1): bodies, trunk angle and angular momentum of two gaits."""
    pair = [walk(name) for name in names]
    figure, key = Figure(figsize=(9.6, height)), ("c_y", "c_s")[component]
    mosaic, heights = (("AA;BB;LR", (3, 3, 2)), ("AA;LR", (3, 2)))[component]
    axes = figure.subplot_mosaic(mosaic, height_ratios=heights)
    for row, its in zip("AB" if component == 0 else "A", pair, strict=False):
        strip(axes[row], its, 1 - component, f"${key}$ = {getattr(its.gait, key):g}")
    for its, line in zip(pair, ("-", "--"), strict=True):
        label = f", ${key}$ = {getattr(its.gait, key):g}"
        curves(axes["L"], its, *its.trunk(component), MOTION, label, line)
        curves(axes["R"], its, *its.against("angular_momentum", component), PLAN, label, line)
    axes["L"].set_title(f"{('roll', 'pitch')[component]} of the trunk [°]")
    axes["R"].set(title=f"$L_{'xy'[component]}$ about the COM [N m s]")
    figure.legend(*axes["R"].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure


def figure_11():
    """Front view of two values of c_y; momentum and swing of the trunk against c_y."""
    rows = []
    for value in (0.1, 0.7, 0.9, 1.0):
        plan = planned(f"gait.c_y={value}")
        times = np.linspace(0.0, 2.0 * plan.constants.step_duration, 200)
        roll = np.ptp(lean(plan.posture.sample(times).trunk[:, :, 2], 0))
        momentum = np.abs(plan.sample(times).angular_momentum[:, 0]).max()
        rows.append((f"{value:g}", f"{momentum:.2f}", f"{roll:.1f}"))
    header = ("`gait.c_y`", "planned peak of L_x [N m s]", "roll of the trunk, peak to peak [°]")
    return turned(("roll-0.1", "roll-0.7"), 0, 7.9), {"figure-11-swing": table(header, rows)}


BOUNDS = {"x": 0.03, "y": 0.05, "z": 0.01}
"""Of |L| / (m V H) over the stride of ten people, mean plus one standard deviation [1]: Herr & Popovic
(2008), J. Exp. Biol. 211:467-481, whose x is medio-lateral and whose y is anterior-posterior."""
DEMOS = {"normal": (), "normal, L_z = 0": ("body.angular_momentum_z=zero",)}
DEMOS |= dict.fromkeys(("momentum", "roll-0.1", "roll-0.4", "roll-0.7", "pitch", "pitch-low"), ())


def peaks(its):
    """Largest simulated |L| / (m V H) about x, y and z."""
    scale = its.plan.mass * its.plan.constants.mean_velocity * its.plan.com_height
    return np.abs(its.folded(its.trial.measured.angular_momentum)).max(axis=(0, 1)) / scale


def human_range(axis, key, component):
    """Draw the momentum against c_y or c_s; return a row of the table of ranges."""
    letter, bound, ends = "xy"[component], tuple(BOUNDS.values())[component], []
    for values in ((0.86, 0.9), (1.12, 1.19)):  # the peak grows almost linearly with the distance from 1
        walked = [peaks(walk("normal", f"gait.{key}={value}", steps=6))[component] for value in values]
        axis.plot(values, walked, "o-", color=MEASURED)
        ends.append(100.0 * np.polyval(np.polyfit(walked, values, 1), bound))
    axis.axhspan(0.0, bound, color=BAND, alpha=0.45)
    axis.set(title=f"largest |L_{letter}| / (m V H)", xlabel=key, ylim=(0.0, 2.0 * bound))
    shown = f"{np.ceil(ends[0]) / 100:.2f} to {np.floor(ends[1]) / 100:.2f}"
    return f"`gait.{key}`", f"L_{letter} / (m V H) ≤ {bound:g}", shown


def human():
    """Momentum of the demos, the range of c_y and c_s nearest to people, and the force on one foot."""
    figure = Figure(figsize=(9.6, 9.9))
    axes = figure.subplot_mosaic("xxyyzz;cccsss;vvffmm", height_ratios=(1.2, 1, 1.2))
    found = {name: peaks(walk(name.split(",")[0], *more)) for name, more in DEMOS.items()}
    for k, letter in enumerate("xyz"):
        axes[letter].barh(list(found), [peak[k] for peak in found.values()], color=MEASURED)
        axes[letter].axvspan(0.0, BOUNDS[letter], color=BAND, zorder=0)
        axes[letter].set_title(f"largest |L_{letter}| / (m V H)")
        axes[letter].tick_params(labelleft=k == 0)
    ranges = [human_range(axes["c"], "c_y", 0), human_range(axes["s"], "c_s", 1)]
    forces(axes)
    return figure, {"ranges": table(("parameter", "bound on people", "within"), ranges)}


def forces(axes):
    """Draw one foot's ground force over its stance beside people's."""
    its, share = walk("normal"), np.linspace(0.0, 1.0, 501)
    measured = its.trial.measured
    times = its.starts[:, None] - its.double + share * (its.single + 2.0 * its.double)
    lines = [line for line in PEOPLE.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    people = np.genfromtxt(lines, delimiter=",", names=True)
    for name, k, sign in (("vertical", 2, 1.0), ("forward", 0, 1.0), ("medial", 1, -1.0)):
        axis = axes[name[0]]
        ours = sign * np.interp(times, measured.time, measured.foot_force[:, 0, k] / measured.weight)
        means = [people[f"{name}_mean_{end}"] for end in ("0p8", "1p3")]
        for mean, end, line in zip(means, ("0p8", "1p3"), ("--", "-"), strict=True):
            spread, at = people[f"{name}_sd_{end}"], people["stance_percent"]
            axis.fill_between(at, mean - spread, mean + spread, color=BAND, alpha=0.5, linewidth=0)
            axis.plot(at, mean, line, color=INK, label=f"people, {end.replace('p', '.')} m/s")
        axis.plot(100.0 * share, ours.mean(axis=0), color=MEASURED, label="simulation")
        axis.set(title=f"{name} force on one foot / weight", xlabel="share of the stance [%]")
    axes["v"].legend()


def table(header, rows):
    """A table in Markdown."""
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (header, ["---"] * len(header), *rows))


FIGURES = {
    "figure-04": lambda: plane(0),
    "figure-05": lambda: plane(1),
    "figure-07": figure_7,
    "figure-08": figure_8,
    "figure-09": figure_9,
    "figure-10": figure_10,
    "figure-11": figure_11,
    "figure-12": lambda: (turned(("pitch", "normal"), 1, 5.3), {}),
    "human": human,
}

if __name__ == "__main__":
    page = PAGE.read_text(encoding="utf-8")
    with mpl.rc_context(STYLE):
        for asked in sys.argv[1:] or FIGURES:
            figure, tables = FIGURES[asked]()
            figure.savefig(HERE / "paper" / f"{asked}.svg", metadata={"Date": None})
            for mark, text in tables.items():
                between = re.compile(rf"(<!-- {mark} -->\n\n).*?(\n\n<!-- end of {mark} -->)", re.DOTALL)
                page = between.sub(rf"\g<1>{text}\g<2>", page)
    PAGE.write_text(page, encoding="utf-8")

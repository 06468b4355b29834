"""Every number a run depends on: frozen, validated, in SI units.

Keys are namespaced (``gait.step_length``); :mod:`ampm.run_file` reads and writes them.
"""

import math
import os
from collections.abc import Iterable, Iterator, Mapping
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from ampm.controller_parameters import ControllerParameters
from ampm.exceptions import InputError
from ampm.physics_parameters import (
    ContactParameters,
    DisturbanceParameters,
    DrakeParameters,
    SimulationParameters,
    SolverParameters,
)
from ampm.section import (
    OPEN,
    OPTIONS,
    Open,
    Options,
    Real,
    RealOrInf,
    Section,
    Whole,
    bad_value,
    options_of,
    parameter,
    parse_setting,
    unit_of,
    unknown,
)
from ampm.sensor_parameters import SensorParameters

GRAVITY = 9.81
"""Gravitational acceleration of the paper [m/s^2]."""
HUMAN = "human"
"""Name of the default body, which has any stature and mass."""
NO_PLAN = "none"
"""Planner of a walk without a plan: the body begins standing, and is asked for a velocity."""


class GaitParameters(Section, section="gait"):
    """The closed-form gait, symbols of the paper (Kudoh & Komura, IROS 2003) in parentheses."""

    planner: str = parameter(
        "ampm",
        "makes the plan: ampm, the paper's pendulum, continuous up to the acceleration; lipm, the plain "
        "inverted pendulum at the same switching velocity (ZMP fixed under the foot, no moment, double "
        "support at constant velocity; a_s, c_s and c_y play no part); ipm (the same pendulum), preview or "
        "dcm, with the AMPM's footsteps and times; a table FILE.csv or FILE.parquet; MODULE:CLASS; or none, "
        "for a controller that walks by itself",
        min_length=1,
    )
    com_height: Open = parameter(0.865, "constant height of the COM over the floor (H)", "m", gt=0, le=10)
    step_length: Real = parameter(
        0.6,
        "distance of successive footprints of opposite feet along x (2 (l_s + l_d)); "
        "steps back or in place need footsteps",
        "m",
        gt=0,
        le=100,
    )
    switching_velocity: Real = parameter(
        1.0, "forward speed of the COM at every switch of support (v0)", "m/s", gt=0, le=100
    )
    single_support_ratio: Open = parameter(
        0.79, "share of the COM's travel that falls in single support (l_s / (l_s + l_d))", gt=0, lt=1
    )
    a_s: Annotated[RealOrInf, OPEN] = parameter(
        2.63, "COM travel over ZMP travel in single support; inf holds the ZMP still", gt=0
    )
    c_s: Real = parameter(
        1.0, "slope of the force line over the COM in single support; 1 goes through the COM", le=100
    )
    c_y: Real = parameter(1.0, "slope of the force line in the frontal plane; 1 goes through the COM", le=100)
    step_width: Open = parameter(0.18, "lateral distance of the feet (2 (s + beta))", "m", gt=0, le=100)
    slope: Real = parameter(
        0.0, "rise of the floor per distance along x; the soles are planned on it", "1", ge=-0.15, le=0.15
    )
    cross_slope: Real = parameter(
        0.0, "rise of the floor per distance to the left, along y", "1", ge=-0.15, le=0.15
    )
    steps: Whole = parameter(30, "number of steps", ge=1, le=10_000)

    @property
    def slopes(self) -> tuple[float, float]:
        """Slopes of the floor along x and y, dz/dx and dz/dy [1]."""
        return self.slope, self.cross_slope


class PlannerParameters(Section, section="planner"):
    """What a planner of a user's own takes; its name is ``gait.planner``."""

    options: Options = options_of("planner", "gait.planner")


class CommandParameters(Section, section="command"):
    """Velocity that a walk without a plan (``gait.planner = none``) is asked for."""

    vx: Real = parameter(0.0, "velocity forward, in the heading of the body", "m/s", ge=-10, le=10)
    vy: Real = parameter(0.0, "velocity to the left, in the heading of the body", "m/s", ge=-10, le=10)
    wz: Real = parameter(0.0, "rate of the heading, to the left positive", "rad/s", ge=-10, le=10)
    settling: Real = parameter(1.0, "time before the command, in which it is zero", "s", ge=0, le=100)
    duration: Real = parameter(10.0, "duration of the trial, settling included", "s", gt=0, le=1e4)

    def at(self, time: float) -> tuple[float, float, float]:
        """Command (vx, vy, wz) at a time [s], [m/s, m/s, rad/s]."""
        return (self.vx, self.vy, self.wz) if time >= self.settling else (0.0, 0.0, 0.0)


class BodyParameters(Section, section="body"):
    """The walking body."""

    source: str = parameter(
        HUMAN, "the body: a name that 'ampm body list' shows, or its description (TOML)", min_length=1
    )
    height: Real = parameter(1.70, "stature; another body has that of its model", "m", ge=0.2, le=3)
    mass: Real = parameter(60.0, "total mass; another body has that of its model", "kg", ge=0.1, le=1000)
    lean: Open = parameter(0.0, "mean pitch of the trunk, forward positive", "rad", ge=-0.5, le=0.5)
    pelvis_list: Open = parameter(
        0.0, "largest drop of the swing leg's hip in the posture at rest, in mid step", "rad", ge=-0.5, le=0.5
    )
    pelvis_rotation: Open = parameter(
        0.0,
        "largest turn of the front leg's hip forward in the posture at rest, when a foot lifts",
        "rad",
        ge=-0.5,
        le=0.5,
    )
    arm_abduction: Open = parameter(
        0.1, "angle by which the arms are spread sideways at rest; 0: they hang", "rad", ge=0, le=1.2
    )
    arm_abduction_roll: Real = parameter(
        0.36, "further angle times (1 - c_y)^2, as the trunk rolls and the arms must pass", "rad", ge=0, le=2
    )
    angular_momentum_z: Annotated[Literal["free", "zero"], OPEN] = parameter(
        "free", "angular momentum about the vertical: free with yaw held by posture, or held at zero"
    )
    posture_stiffness: Real = parameter(
        100.0, "elastic constant of the upright posture in the inverse kinematics (k)", "1/s^2", gt=0, le=1e5
    )
    posture_damping: Real = parameter(
        20.0, "viscosity constant of the upright posture in the inverse kinematics (d)", "1/s", gt=0, le=1e4
    )


class FootParameters(Section, section="foot"):
    """Key-frames of the feet: initial contact, full contact, heel rise, toe off."""

    schedule: Literal["flat", "roll"] = parameter(
        "roll", "flat: no heel rise before lift-off; roll: heel strike, flat, heel rise, toe off"
    )
    swing_height: Open = parameter(0.05, "extra lift of the foot at mid swing", "m", ge=0, le=0.5)
    swing_lag: Open = parameter(
        0.08, "how far the foot lags behind at mid swing, as share of its travel", ge=-0.2, le=0.3
    )
    heel_strike_angle: Open = parameter(0.2, "pitch of the foot at heel strike, toes up", "rad", ge=0, le=0.8)
    heel_strike_rate: Open = parameter(3.0, "downward speed of the toes at heel strike", "rad/s", ge=0, le=20)
    full_contact: Open = parameter(
        0.9, "share of the double support after which the front foot is flat", gt=0, le=1
    )
    heel_rise_lead: Open = parameter(
        0.0, "lead of the heel rise before the double support; negative: a delay", "s", ge=-1, le=1
    )
    toe_off_angle: Open = parameter(0.45, "pitch of the foot, heel up, at toe off", "rad", ge=0, le=1.2)
    toe_off_rate: Open = parameter(6.5, "speed at which the heel rises at toe off", "rad/s", ge=0, le=30)
    toe_return: Open = parameter(0.8, "share of the swing in which the toes straighten", gt=0, le=1)


class FootstepParameters(Section, section="footsteps"):
    """One placement of a foot."""

    foot: Literal["left", "right"] = parameter(..., "which foot")
    x: Real = parameter(..., "place of the sole's reference point, forward", "m", ge=-1e4, le=1e4)
    y: Real = parameter(..., "place of the sole's reference point, to the left", "m", ge=-1e4, le=1e4)
    heading: Real = parameter(0.0, "yaw of the foot, to the left positive", "rad", ge=-1e3, le=1e3)
    z: Real = parameter(0.0, "height of the floor there", "m", ge=-10, le=10)
    time: Real | None = parameter(
        None,
        "when the foot lands; left out: by the gait's durations",
        "s",
        ge=0,
        le=1e6,
        exclude_if=lambda time: time is None,
    )


def footstep_keys(row: Any) -> Any:
    """Keys of an :class:`ampm.Footstep`; rows as they are. Raises InputError of anything else."""
    if isinstance(row, Mapping | FootstepParameters):
        return row
    try:
        (x, y, z), heading = map(float, row.position), float(row.heading)
        return {"foot": row.foot, "x": x, "y": y, "heading": heading, "z": z, "time": row.time}
    except (AttributeError, TypeError, ValueError):
        wanted = "give ampm.Footstep(foot, (x, y, 0.0), heading)"
        raise InputError(f"cannot read the footstep {str(row)[:80]}; {wanted}.") from None


OPTION_TABLES: Mapping[str, str] = {
    "planner.options": "gait.planner",
    "controller.options": "controller.name",
    "sensors.options": "sensors.estimator",
}
"""Tables of the options of users' classes, and the keys of their names, after which they may stand, too."""


COUNTED: Mapping[str, str] = {
    "controller.frequency": "simulation.time_step",
    "disturbance.actuation_delay": "controller.frequency",
    "sensors.delay": "simulation.time_step",
    "sensors.rate": "simulation.time_step",
    "sensors.fix_rate": "controller.frequency",
}
"""Times and rates that are whole steps or ticks, and the key of these, see :meth:`RunParameters.count`."""


def counted(key: str, value: float, per: float, most: float = math.inf) -> tuple[float, int, float]:
    """Steps or ticks in a time [s] or between events of a rate [Hz]; the nearest whole number; its value.

    ``per`` is the value of the key that :data:`COUNTED` names [s or Hz]; the value found is ``most`` at most.
    """
    per_second = per if unit_of(field_of(COUNTED[key])) == "Hz" else 1.0 / per
    is_rate = unit_of(field_of(key)) == "Hz"
    number = per_second / value if is_rate else per_second * value
    nearest = max(round(number), int(is_rate))
    good = per_second / nearest if is_rate else nearest / per_second
    if good > most * (1.0 + 1e-9):
        nearest += 1 if is_rate else -1
        good = per_second / nearest if is_rate else nearest / per_second
    return number, nearest, good


def rounded(values: Mapping[str, Any], most: Mapping[str, float], run: "RunParameters") -> dict[str, Any]:
    """Values by key, of which times and rates with a largest value become whole steps or ticks of a run."""
    found = dict(values)
    for key, per in COUNTED.items():
        if key in most and found[key]:
            found[key] = counted(key, float(found[key]), found.get(per, run.value(per)), most[key])[2]
    return found


class RunParameters(Section):
    """Everything that describes one run."""

    gait: GaitParameters = Field(default_factory=GaitParameters)
    planner: PlannerParameters = Field(
        default_factory=PlannerParameters, exclude_if=lambda planner: not planner.options
    )
    command: CommandParameters = Field(
        default_factory=CommandParameters, exclude_if=lambda command: command == CommandParameters()
    )
    body: BodyParameters = Field(default_factory=BodyParameters)
    foot: FootParameters = Field(default_factory=FootParameters)
    contact: ContactParameters = Field(default_factory=ContactParameters)
    drake: DrakeParameters = Field(default_factory=DrakeParameters)
    controller: ControllerParameters = Field(default_factory=ControllerParameters)
    simulation: SimulationParameters = Field(default_factory=SimulationParameters)
    solver: SolverParameters = Field(default_factory=SolverParameters)
    disturbance: DisturbanceParameters = Field(default_factory=DisturbanceParameters)
    sensors: SensorParameters = Field(default_factory=SensorParameters)
    footsteps: tuple[Annotated[FootstepParameters, BeforeValidator(footstep_keys)], ...] = Field(
        (),
        description="places to walk over, from rest to rest; none: the periodic gait",
        strict=False,  # a list is fine
        exclude_if=lambda rows: not rows,
    )

    @model_validator(mode="before")
    @classmethod
    def _split(cls, table: dict[str, Any]) -> dict[str, Any]:
        return _split_names(table)

    @model_validator(mode="after")
    def _check(self) -> "RunParameters":
        """Refuse keys that do not go together."""
        contact, least = self.contact, 2.0 * self.simulation.time_step
        # MuJoCo would raise it silently; Drake has none.
        if contact.time_constant < least and self.simulation.engine == "mujoco":
            rule = f"must be at least {least:g} s, 2 times simulation.time_step"
            raise self.refusal("contact.time_constant", rule, "raise it or lower simulation.time_step")
        if contact.impedance_min > contact.impedance_max:
            rule = f"must be at most contact.impedance_max = {contact.impedance_max:g}"
            raise self.refusal("contact.impedance_min", rule, "exchange them")
        if not self.command.settling < self.command.duration:
            rule = f"must be longer than command.settling = {self.command.settling:g} s"
            raise self.refusal("command.duration", rule, "raise it")
        tick = 1.0 / self.controller.frequency
        for key in ("command.duration", "sensors.stand"):
            if 0.0 < self.value(key) < tick:
                raise self.refusal(key, f"must be at least a controller's tick, {tick:g} s", "raise it")
        for key in COUNTED:
            self.count(key)
        return self

    def count(self, key: str) -> int:
        """Steps or ticks in a key's time [s], or between two events of its rate [Hz]; 0 if that is 0.

        Raises InputError if it is no whole number.
        """
        per, value = COUNTED[key], self.value(key)
        if not value:
            return 0
        number, nearest, good = counted(key, value, self.value(per))
        if abs(number - nearest) > 1e-9 * max(1.0, number):
            unit, per_value = unit_of(field_of(per)), self.value(per)
            what = f"{'ticks' if unit == 'Hz' else 'steps'} of {per} = {per_value:g} {unit}"
            rule = f"gives {number:.4g} {what}, not a whole number"
            raise self.refusal(
                key, rule, f"choose for example {good or value / number:.12g}, or another {per}"
            )
        return nearest

    def refusal(self, key: str, rule: str, way_out: str) -> InputError:
        """Error about the value of a key: what holds for it (``rule``), and what to do."""
        return bad_value(key, self.value(key), field_of(key), rule, way_out)

    def __repr_args__(self) -> Iterator[tuple[str | None, Any]]:
        """What differs from the defaults; of footsteps their number."""
        yield from self.model_dump(exclude_defaults=True, exclude={"footsteps"}).items()
        if self.footsteps:
            yield "footsteps", f"[{len(self.footsteps)}]"

    def value(self, key: str) -> Any:
        """Value of a namespaced key.

        Raises:
            KeyError: an option that is not set.
        """
        section, name, *option = key.split(".")
        value = getattr(getattr(self, section), name)
        return value[option[0]] if option else value

    def replace(self, values: Mapping[str, Any], **more: Any) -> "RunParameters":
        """Copy with some namespaced keys changed, validated like any other input.

        Args:
            values: new values by namespaced key, for example ``{"gait.c_s": 1.2}``.
            more: ``footsteps``, a list of tables.

        Raises:
            InputError: unknown key or bad value.
        """
        table, changes = self.model_dump() | more, dict[str, Any]()
        for key, value in values.items():
            put(changes, key, value)
        table = merged(table, changes)
        for key in OPTION_TABLES.keys() & values.keys():  # a whole table takes the place of the old one
            put(table, key, values[key])
        return RunParameters(**table).giving(self.given | values.keys())

    @property
    def undisturbed(self) -> "RunParameters":
        """The run as planner and controller know it, a copy without its ``disturbance`` and ``sensors``."""
        hidden = {"disturbance": DisturbanceParameters(), "sensors": SensorParameters()}
        return self.model_copy(deep=True, update=hidden)

    @property
    def given(self) -> frozenset[str]:
        """Keys whose values stay; those of :data:`OPEN_KEYS` that are not among them may be found."""
        return frozenset(
            f"{section}.{key}"
            for section in SECTIONS
            for key in getattr(self, section).model_fields_set - {OPTIONS}
        )

    def as_is(self) -> "RunParameters":
        """The same values, all of which count as given: nothing is left to be found."""
        return self.giving(KEYS)

    def giving(self, given: Iterable[str]) -> "RunParameters":
        """The same values, of which these keys count as given; options always do."""
        kept = {*given, *OPTION_TABLES}
        sections = {
            name: kind.model_construct(
                {key for key in kind.model_fields if f"{name}.{key}" in kept}, **dict(getattr(self, name))
            )
            for name, kind in SECTIONS.items()
        }
        return self.model_copy(update=sections)

    @classmethod
    def known_keys(cls) -> list[str]:
        """Sections, and all namespaced keys."""
        return [*cls.model_fields, *KEYS]


SECTIONS: Mapping[str, type[Section]] = {
    name: field.annotation
    for name, field in RunParameters.model_fields.items()
    if isinstance(field.annotation, type) and issubclass(field.annotation, Section)
}
"""Classes of the sections, by name."""
FIELDS: Mapping[str, Any] = {
    f"{name}.{key}": field for name, kind in SECTIONS.items() for key, field in kind.model_fields.items()
}
"""Fields by namespaced key in the order of the file: meaning, unit, default and bounds."""
OPEN_KEYS = tuple(key for key, field in FIELDS.items() if OPEN in field.metadata)
"""Keys that a gait may leave open, to be found for the rest."""
KEYS = tuple(key for key in FIELDS if key not in OPTION_TABLES)
"""All namespaced keys, in the order of the file, without the options of users' classes."""


def _split_names(table: Mapping[str, Any]) -> dict[str, Any]:
    """A table of sections with the options behind names of classes, as in ``quintic:Quintic,roll=0.09``."""
    table = dict(table)
    for options, names in OPTION_TABLES.items():
        (section, key), where = names.split("."), options.partition(".")[0]
        named: Any = table.get(section)
        text = named.get(key) if isinstance(named, dict) else None
        if isinstance(text, str) and "," in text and not os.path.isfile(text):
            name, *given = text.split(",")
            table[section] = {**named, key: name}
            others: Any = table.get(where, {})
            old = others.get(OPTIONS, {}) if isinstance(others, dict) else None
            if isinstance(old, dict):  # else it is refused
                new = dict(map(parse_setting, given))
                if twice := [item for item in new if item in old and old[item] != new[item]]:
                    values = f"{old[twice[0]]!r}, and {new[twice[0]]!r} behind {name}"
                    raise InputError(f"{options}.{twice[0]} is {values}; give it once.", key=options)
                table[where] = {**others, OPTIONS: old | new}
    return table


def merged(table: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """A table of sections with changes. Options of a class that gives way to another one are left out.

    Options beside a default name are meant for a class that is still to be named. Raises InputError if an
    option has two values in one of both.
    """
    table, changes = _split_names(table), _split_names(changes)
    for options, name in OPTION_TABLES.items():
        section, key = name.split(".")
        sides = [side.get(section) for side in (table, changes)]
        old, new = (side.get(key) if isinstance(side, Mapping) else None for side in sides)
        if None not in (old, new) and old not in (new, FIELDS[name].default):
            where = options.partition(".")[0]
            table[where] = {key: value for key, value in table.get(where, {}).items() if key != OPTIONS}
    return _merged(table, changes)


def _merged(table: Mapping[str, Any], more: Mapping[str, Any]) -> dict[str, Any]:
    """A table with the keys of another one, by section; what is not a section is left for the refusal."""
    found = {**table, **more}
    for name in table.keys() & more.keys():
        if isinstance(more[name], Mapping):
            old = table[name]
            found[name] = _merged(old, more[name]) if isinstance(old, Mapping) else old
    return found


def is_option(key: str) -> bool:
    """Whether a key is an option of a user's class, such as ``controller.options.gain``."""
    table, _, option = key.rpartition(".")
    return table in OPTION_TABLES and option.isidentifier()


def field_of(key: str) -> Any:
    """Field of a key, of an option that of its table; InputError, with the nearest, if there is none."""
    table = key.rpartition(".")[0] if is_option(key) else key
    if table not in FIELDS:
        raise unknown(key, KEYS)
    return FIELDS[table]


def put(table: dict[str, Any], key: str, value: Any) -> None:
    """Set a namespaced key in a table of sections; raises InputError if there is no such key."""
    field_of(key)
    *sections, name = key.split(".")
    for section in sections:
        table = table.setdefault(section, {})
    table[name] = value

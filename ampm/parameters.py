"""Every number a run depends on: frozen, validated, in SI units, and one TOML file to hold them all.

Keys are namespaced (``gait.step_length``). A run starts from the defaults, takes a preset or a TOML file over
them, then ``key=value`` overrides; :func:`dump_run` writes the result so that :func:`load_run` gives back the
same bits.
"""

from __future__ import annotations

import difflib
import math
import operator
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, get_args, get_origin

import tomli_w
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from ampm.exceptions import InputError

GRAVITY = 9.81
"""Gravitational acceleration of the paper [m/s^2]."""

PRESETS: dict[str, str] = {
    "normal": "the paper's gait: 0.6 m steps, 1.0 m/s at every switch, no angular momentum about the COM",
    "momentum": "the same with angular momentum about both horizontal axes (c_s 1.2, c_y 0.4)",
    "flat": "an easy gait: 0.3 m steps on flat feet",
    "roll-0.1": "the normal gait with c_y 0.1: large angular momentum about the forward axis (Fig. 11)",
    "roll-0.4": "the same with c_y 0.4",
    "roll-0.7": "the same with c_y 0.7",
    "roll-1.0": "the same with c_y 1: none",
    "pitch": "0.65 m steps with c_s 1.6: large angular momentum about the lateral axis (Fig. 12)",
    "pitch-low": "0.7 m steps with c_s 0.33: the same with the opposite sign",
    "ipm": "the plain inverted pendulum, whose acceleration jumps at every switch, as the normal gait",
}
"""Presets and what they are; each is ``ampm/presets/<name>.toml``."""


def _not_nan(value: float) -> float:
    if math.isnan(value):
        raise ValueError("must be a number")
    return value


Real = Annotated[float, Field(allow_inf_nan=False)]
"""A finite float."""

RealOrInf = Annotated[float, AfterValidator(_not_nan)]
"""A float that may be infinite, but not NaN."""


class Section(BaseModel):
    """Base of all parameter sections: immutable, no unknown keys, failures raised as :class:`InputError`."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=True)
    section: ClassVar[str] = ""

    def __init__(self, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise input_error(error, type(self)) from None


def _field(default: Any, description: str, unit: str, **bounds: Any) -> Any:
    """A field with its default, meaning, SI unit and bounds."""
    return Field(default, description=description, json_schema_extra={"unit": unit}, **bounds)


class GaitParameters(Section):
    """The closed-form gait, symbols of the paper (Kudoh & Komura, IROS 2003) in parentheses."""

    section: ClassVar[str] = "gait"

    model: Literal["ampm", "ipm"] = _field(
        "ampm",
        "ampm: the paper's pendulum, continuous up to the acceleration; ipm: the plain inverted pendulum, to "
        "compare with: ZMP fixed under the foot, no moment, double support at constant velocity",
        "1",
    )
    com_height: Real = _field(0.865, "constant height of the COM over the floor (H)", "m", gt=0, le=100)
    step_length: Real = _field(
        0.6, "distance of successive footprints of opposite feet along x (2 (l_s + l_d))", "m", gt=0, le=100
    )
    switching_velocity: Real = _field(
        1.0, "forward speed of the COM at every switch of support (v0)", "m/s", gt=0, le=100
    )
    single_support_ratio: Real = _field(
        0.79, "share of the COM's travel that falls in single support (l_s / (l_s + l_d))", "1", gt=0, lt=1
    )
    a_s: RealOrInf = _field(
        2.63, "COM travel over ZMP travel in single support; inf holds the ZMP still", "1", gt=0
    )
    c_s: Real = _field(
        1.0, "slope of the force line over the COM in single support; 1 passes through the COM", "1", le=100
    )
    c_y: Real = _field(
        1.0, "slope of the force line in the frontal plane; 1 passes through the COM", "1", le=100
    )
    step_width: Real = _field(0.18, "lateral distance of the feet (2 (s + beta))", "m", gt=0, le=100)
    steps: int = _field(30, "number of steps", "1", ge=1, le=100_000)


class BodyParameters(Section):
    """The walking body."""

    section: ClassVar[str] = "body"

    height: Real = _field(1.70, "stature", "m", ge=0.5, le=3)
    mass: Real = _field(60.0, "total mass", "kg", gt=0, le=1000)
    lean: Real = _field(0.0, "mean pitch of the trunk over a step, forward positive", "rad", ge=-0.5, le=0.5)
    angular_momentum_z: Literal["free", "zero"] = _field(
        "free", "angular momentum about the vertical: free with yaw held by posture, or held at zero", "1"
    )
    posture_stiffness: Real = _field(
        100.0, "elastic constant of the upright posture in the inverse kinematics (k)", "1/s^2", gt=0, le=1e5
    )
    posture_damping: Real = _field(
        20.0, "viscosity constant of the upright posture in the inverse kinematics (d)", "1/s", gt=0, le=1e4
    )


class FootParameters(Section):
    """Key-frames of the feet: initial contact, full contact, heel rise, toe off."""

    section: ClassVar[str] = "foot"

    schedule: Literal["flat", "roll"] = _field(
        "roll", "flat: no heel rise before lift-off; roll: heel strike, flat, heel rise, toe off", "1"
    )
    swing: Literal["quintic", "paper"] = _field(
        "quintic",
        "quintic: continuous up to the acceleration; paper: cubic splines, the foot lifts at l_s / T_swing "
        "at once and lands at rest (swing_lag and heel_strike_rate play no part)",
        "1",
    )
    swing_height: Real = _field(0.05, "extra lift of the foot at mid swing", "m", ge=0, le=0.5)
    swing_lag: Real = _field(
        0.08, "how far the foot lags behind at mid swing, as share of its travel", "1", ge=-0.2, le=0.3
    )
    heel_strike_angle: Real = _field(
        0.2, "pitch of the foot, toes up, at initial contact", "rad", ge=0, le=0.8
    )
    heel_strike_rate: Real = _field(
        3.0, "speed at which the toes come down at initial contact", "rad/s", ge=0, le=20
    )
    full_contact: Real = _field(
        0.9, "share of the double support after which the front foot is flat", "1", gt=0, le=1
    )
    heel_rise_lead: Real = _field(
        0.0,
        "time by which the heel rise begins before the double support; negative: after it has begun",
        "s",
        ge=-1,
        le=1,
    )
    toe_off_angle: Real = _field(0.45, "pitch of the foot, heel up, at toe off", "rad", ge=0, le=1.2)
    toe_off_rate: Real = _field(6.5, "speed at which the heel rises at toe off", "rad/s", ge=0, le=30)
    toe_return: Real = _field(0.8, "share of the swing in which the toe joint straightens", "1", gt=0, le=1)


class ContactParameters(Section):
    """Contact of the sole points with the floor (MuJoCo's soft contact model)."""

    section: ClassVar[str] = "contact"

    time_constant: Real = _field(0.015, "time constant of a contact", "s", gt=0, le=1)
    damping_ratio: Real = _field(1.0, "damping ratio of a contact", "1", gt=0, le=10)
    impedance_min: Real = _field(0.6, "constraint impedance at zero penetration", "1", gt=0, lt=1)
    impedance_max: Real = _field(0.95, "constraint impedance at full penetration", "1", gt=0, lt=1)
    impedance_width: Real = _field(0.001, "penetration over which the impedance rises", "m", gt=0, le=0.1)
    friction: Real = _field(0.8, "sliding friction of soles and floor", "1", gt=0, le=10)
    impratio: Real = _field(10.0, "ratio of frictional to normal impedance", "1", gt=0, le=1000)


class ControllerParameters(Section):
    """The torque-level tracking controller."""

    section: ClassVar[str] = "controller"

    frequency: Real = _field(500.0, "control ticks per second", "Hz", gt=0, le=10_000)
    friction: Real = _field(0.6, "friction that the controller allows itself", "1", gt=0, le=10)
    com_stiffness: Real = _field(
        60.0, "feedback from COM position to its acceleration", "1/s^2", ge=0, le=1e5
    )
    com_damping: Real = _field(15.0, "feedback from COM velocity to its acceleration", "1/s", ge=0, le=1e4)
    momentum_gain: Real = _field(15.0, "feedback from angular momentum to its rate", "1/s", ge=0, le=1e4)
    trunk_gain: Real = _field(
        3.0,
        "slow feedback from trunk pitch and roll to the commanded angular momentum",
        "N m s/rad",
        ge=0,
        le=1e3,
    )
    posture_stiffness: Real = _field(
        900.0, "feedback from posture to its acceleration", "1/s^2", ge=0, le=1e5
    )
    posture_damping: Real = _field(
        60.0, "feedback from posture rate to its acceleration", "1/s", ge=0, le=1e4
    )
    swing_stiffness: Real = _field(
        400.0, "feedback from the swing foot's pose to its acceleration", "1/s^2", ge=0, le=1e5
    )
    swing_damping: Real = _field(
        40.0, "feedback from the swing foot's velocity to its acceleration", "1/s", ge=0, le=1e4
    )
    stance_damping: Real = _field(
        50.0, "feedback from the stance foot's velocity to its acceleration", "1/s", ge=0, le=1e4
    )
    roll_stiffness: Real = _field(
        1500.0,
        "feedback from the pose of a foot that rolls on heel or toes to its rotation",
        "1/s^2",
        ge=0,
        le=1e5,
    )
    roll_damping: Real = _field(
        80.0,
        "feedback from the rate of a foot that rolls on heel or toes to its rotation",
        "1/s",
        ge=0,
        le=1e4,
    )
    touchdown_damping: Real = _field(
        200.0, "how fast a late foot takes up the touch-down velocity", "1/s", ge=0, le=1e4
    )
    contact_ramp: Real = _field(
        0.04,
        "time in which a point's force limit opens after touch-down and closes before lift-off",
        "s",
        gt=0,
        le=1,
    )
    landing_share: Real = _field(
        0.6, "share of a landing foot's sensed force that the QP takes as given", "1", ge=0, le=1
    )
    touchdown_lead: Real = _field(
        0.0, "time before its planned contact from which a foot is let down", "s", ge=0, le=0.2
    )
    touchdown_window: Real = _field(
        0.04, "time before its planned contact from which a touch counts as contact", "s", ge=0, le=0.5
    )
    roll_down_bias: Real = _field(
        0.004, "how much later than planned the front foot's ball comes down, as pitch", "rad", ge=0, le=0.1
    )
    touchdown_velocity: Real = _field(
        0.05, "speed at which a foot that is late closes in on the floor", "m/s", ge=0, le=2
    )
    touchdown_rate: Real = _field(
        0.5, "rate at which a sole that is late turns to the floor", "rad/s", ge=0, le=20
    )
    unsolved_limit: Real = _field(
        0.05, "time for which the QP may stay unsolved before the run ends as infeasible", "s", gt=0, le=10
    )


class SimulationParameters(Section):
    """The physics engine."""

    section: ClassVar[str] = "simulation"

    time_step: Real = _field(0.002, "time step of the physics", "s", gt=0, le=0.05)
    integrator: Literal["Euler", "implicitfast"] = _field("Euler", "integrator of the physics", "1")
    start_depth: Real = _field(
        0.001,
        "depth at which the soles start under the floor, so that they carry weight at once",
        "m",
        ge=0,
        le=0.01,
    )


class SolverParameters(Section):
    """Numerical solvers and grids."""

    section: ClassVar[str] = "solver"

    qp: Literal["osqp", "daqp"] = _field("osqp", "solver of the controller's quadratic programme", "1")
    tolerance: Real = _field(
        5e-5, "tolerance of the controller's OSQP, forces in body weights", "1", gt=0, le=1e-2
    )
    max_iterations: int = _field(
        1000, "iterations after which a QP counts as unsolved", "1", ge=10, le=100_000
    )
    ik_time_step: Real = _field(
        0.002,
        "largest step of the inverse kinematics' grid, which divides both phases exactly",
        "s",
        gt=0,
        le=0.05,
    )


class RunParameters(Section):
    """Everything that describes one run."""

    gait: GaitParameters = Field(default_factory=GaitParameters)
    body: BodyParameters = Field(default_factory=BodyParameters)
    foot: FootParameters = Field(default_factory=FootParameters)
    contact: ContactParameters = Field(default_factory=ContactParameters)
    controller: ControllerParameters = Field(default_factory=ControllerParameters)
    simulation: SimulationParameters = Field(default_factory=SimulationParameters)
    solver: SolverParameters = Field(default_factory=SolverParameters)

    def replace(self, values: Mapping[str, Any]) -> RunParameters:
        """Copy with some namespaced keys changed, validated like any other input.

        What was left at its default stays unnamed, so that it can still be tuned.

        Args:
            values: new values by namespaced key, for example ``{"gait.c_s": 1.2}``.

        Raises:
            InputError: unknown key or bad value.
        """
        table = self.model_dump(exclude_unset=True)
        for key, value in values.items():
            _assign(table, key, value)
        return RunParameters(**table)


def keys() -> tuple[str, ...]:
    """All namespaced keys, in the order of the file."""
    return tuple(
        f"{name}.{key}"
        for name, field in RunParameters.model_fields.items()
        for key in _section_type(field.annotation).model_fields
    )


@dataclass(frozen=True)
class KeyInfo:
    """One key of a run.

    Attributes:
        key: namespaced name.
        meaning: in words.
        unit: SI unit, ``"1"`` if it has none.
        default: its value where nobody names it.
        kind: type of its values.
        options: values of a text, empty for numbers.
        bounds: limits by comparison (``gt``, ``ge``, ``lt``, ``le``), those that there are.
        finite: whether infinity is refused.
    """

    key: str
    meaning: str
    unit: str
    default: float | int | str
    kind: Literal["float", "int", "text"]
    options: tuple[str, ...]
    bounds: Mapping[str, float]
    finite: bool

    def inside(self, values: Any) -> Any:
        """Which numbers of an array are within the bounds, same shape."""
        good = values == values  # no NaN
        if self.finite:
            good &= abs(values) < math.inf
        for comparison, limit in self.bounds.items():
            good &= getattr(operator, comparison)(values, limit)
        return good

    def convert(self, value: Any) -> float | int | str:
        """A value of TOML as this key has it, within its bounds or not.

        Raises:
            InputError: another type, not a number, or none of the options.
        """
        is_number = isinstance(value, float) or (type(value) is int and abs(value) <= _LARGEST_INTEGER)
        if self.kind == "text":
            good, wanted = value in self.options, f"one of {', '.join(self.options)}"
        elif self.kind == "int":
            good, wanted = is_number and value % 1 == 0, "a whole number"
        else:
            good, wanted = is_number and not math.isnan(value), "a number"
        if not good:
            limit = f"must be {wanted}"
            raise InputError(f"{self.key} = {value!r} {limit}.", key=self.key, value=value, limit=limit)
        return {"text": str, "int": int, "float": float}[self.kind](value)


_LARGEST_INTEGER = 2**53  # whole numbers beyond are not exact as floats


@cache
def key_info(key: str) -> KeyInfo:
    """What is known of a key, from the field of its section.

    Raises:
        InputError: there is none of this name; the nearest is named.
    """
    if key not in keys():
        raise unknown_key(key)
    section, _, name = key.partition(".")
    field = _section_type(RunParameters.model_fields[section].annotation).model_fields[name]
    extra = field.json_schema_extra
    options = get_args(field.annotation) if get_origin(field.annotation) is Literal else ()
    bounds = {
        name: getattr(item, name)
        for item in field.metadata
        for name in ("gt", "ge", "lt", "le")
        if getattr(item, name, None) is not None
    }
    return KeyInfo(
        key=key,
        meaning=str(field.description),
        unit=str(extra["unit"]) if isinstance(extra, dict) else "1",
        default=field.default,
        kind="text" if options else "int" if field.annotation is int else "float",
        options=options,
        bounds=bounds,
        finite=any(getattr(item, "allow_inf_nan", None) is False for item in field.metadata),
    )


def steps_per_tick(frequency: float, time_step: float) -> int:
    """Time steps of the physics in one control period.

    Args:
        frequency: of the controller [Hz].
        time_step: of the physics [s].

    Raises:
        InputError: it is no whole number.
    """
    ratio = 1.0 / (frequency * time_step)
    steps = round(ratio)
    if steps < 1 or abs(ratio - steps) > 1e-9 * ratio:
        fitting = f"controller.frequency = {1.0 / (max(1, steps) * time_step):g}"
        raise InputError(
            f"controller.frequency = {frequency:g} Hz gives a tick every {ratio:.4g} time steps of "
            f"{time_step:g} s; it must be a whole number: choose for example {fitting}.",
            key="controller.frequency",
            value=frequency,
            way_out=f"choose for example {fitting}",
        )
    return steps


def preset_names() -> tuple[str, ...]:
    """Names of the presets."""
    return tuple(PRESETS)


def load_run(gait: str | Path | None = None, overrides: Sequence[str] = ()) -> RunParameters:
    """Resolve a run from a preset or file and from overrides.

    Args:
        gait: name of a preset, path of a TOML file, or None for the defaults.
        overrides: ``key=value`` texts, the key namespaced, the value as in TOML (quotes may be left out).

    Raises:
        InputError: no such preset or file, no valid TOML, an unknown key or a bad value.
    """
    table = {} if gait is None else _read(gait)
    for override in overrides:
        key, equals, text = override.partition("=")
        if not equals:
            raise InputError(
                f"override {override!r} is no key=value pair; write for example gait.c_s=1.2.",
                value=override,
                way_out="write for example gait.c_s=1.2",
            )
        if not key.strip():
            raise InputError(
                f"there is no key before = in {override!r}; write for example gait.c_s=1.2.",
                value=override,
                way_out="write for example gait.c_s=1.2",
            )
        _assign(table, key.strip(), _value(text.strip()))
    return RunParameters(**table)


def dump_run(run: RunParameters) -> str:
    """TOML text of a run that :func:`load_run` reads back bit-exactly; keys without a value are left out."""
    table = run.model_dump()
    return tomli_w.dumps(
        {name: {k: v for k, v in section.items() if v is not None} for name, section in table.items()}
    )


def _read(gait: str | Path) -> dict[str, Any]:
    """Read the table of a preset or of a file."""
    if isinstance(gait, str) and gait in PRESETS:
        text = resources.files("ampm").joinpath("presets", f"{gait}.toml").read_text(encoding="utf-8")
        return tomllib.loads(text)
    path = Path(gait)
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        hint = f"the presets are {', '.join(PRESETS)}"
        close = difflib.get_close_matches(str(gait).lower(), PRESETS, n=1)
        if close:
            hint = f"did you mean {close[0]!r}? {hint}"
        nearest = {"nearest": close[0]} if close else {}
        raise InputError(
            f"there is neither a preset nor a file {str(gait)!r}; {hint}.", value=str(gait), **nearest
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        message = f"the file {str(gait)!r} cannot be read ({error}); give a readable TOML file."
        raise InputError(message) from None
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"the file {str(gait)!r} is no valid TOML: {error}; correct that line.") from None


def _value(text: str) -> Any:
    """Value of an override: TOML where it is TOML, else a number, else the text itself."""
    try:
        parsed = tomllib.loads(f"value = {text}")
        if parsed.keys() == {"value"}:
            return parsed["value"]
    except tomllib.TOMLDecodeError:
        pass
    try:
        return float(text)
    except ValueError:
        return text


def _assign(table: dict[str, Any], key: str, value: Any) -> None:
    """Set one namespaced key in a nested table."""
    name, dot, field = key.partition(".")
    if not dot or name not in RunParameters.model_fields:
        raise unknown_key(key)
    section = table.setdefault(name, {})
    if not isinstance(section, dict):
        raise InputError(
            f"{name} = {section!r} is no section; write [{name}] and its keys below.",
            key=name,
            value=section,
            way_out=f"write [{name}] and its keys below",
        )
    section[field] = value


def _section_type(annotation: Any) -> type[Section]:
    if not (isinstance(annotation, type) and issubclass(annotation, Section)):
        raise TypeError(f"{annotation!r} is no section")
    return annotation


def unknown_key(key: str, known: Sequence[str] = (), *, is_table: bool = False) -> InputError:
    """Error about an unknown key, or section if it is a table, with the nearest of the ``known`` ones."""
    sections = tuple(RunParameters.model_fields)
    lower = key.lower()
    section, _, leaf = lower.rpartition(".")
    if is_table:
        nearest = difflib.get_close_matches(lower, sections, n=1, cutoff=0.0)[0]
        return InputError(
            f"unknown section {key!r}; did you mean {nearest!r}?",
            key=key,
            nearest=nearest,
            way_out=f"write [{nearest}]",
        )
    known = known or keys()
    # The leaf as it is counts most; among equal leaves, and without one, the whole name decides.
    candidates = [k for k in known if k.rpartition(".")[2] == leaf]
    if not candidates and section in sections:
        candidates = [k for k in known if k.startswith(f"{section}.")]
    nearest = difflib.get_close_matches(lower, candidates or known, n=1, cutoff=0.0)[0]
    return InputError(
        f"unknown key {key!r}; did you mean {nearest!r}?",
        key=key,
        nearest=nearest,
        way_out=f"write {nearest}",
    )


_LIMITS = {
    "greater_than": ("gt", "must be greater than"),
    "greater_than_equal": ("ge", "must be at least"),
    "less_than": ("lt", "must be less than"),
    "less_than_equal": ("le", "must be at most"),
}
_KINDS = {
    "int_type": "must be a whole number",
    "float_type": "must be a number",
    "model_type": "must be a table of keys",
}


def input_error(error: ValidationError, model: type[Section]) -> InputError:
    """Translate the first failure of a validation into one sentence: key, value, limit, way out."""
    detail = error.errors()[0]
    location = [str(part) for part in detail["loc"]]
    key = ".".join([model.section, *location] if model.section else location)
    kind, value, context = detail["type"], detail.get("input"), detail.get("ctx", {})
    if kind == "union_tag_invalid":
        key, limit = context["discriminator"].strip("'"), f"must be one of {context['expected_tags']}"
        return InputError(f"{key} = {context['tag']!r} {limit}.", key=key, value=context["tag"], limit=limit)
    known = {field.alias or name: field for name, field in model.model_fields.items()}
    is_run = issubclass(model, RunParameters)
    if kind == "extra_forbidden":
        if is_run or model.section in RunParameters.model_fields:
            return unknown_key(key, is_table=is_run and isinstance(value, Mapping))
        return unknown_key(key, [f"{model.section}.{name}".lstrip(".") for name in known])
    field = known.get(location[0]) if location else None
    if field is None or is_run:
        return InputError(
            f"{key} = {value!r} is no section of keys; write [{key}] and its keys below it.",
            key=key,
            value=value,
            way_out=f"write [{key}] and its keys below it",
        )
    meaning = f" Meaning: {field.description}." if field.description else ""
    if kind == "missing":
        return InputError(f"{key} is missing; write {key} = ...{meaning}", key=key, way_out=f"write {key}")
    extra = field.json_schema_extra
    unit = str(extra.get("unit", "1")) if isinstance(extra, dict) else "1"
    shown_unit = "" if unit == "1" else f" {unit}"
    if kind in _LIMITS:
        name, words = _LIMITS[kind]
        limit = f"{words} {context[name]:g}{shown_unit}"
    elif kind == "literal_error":
        limit = f"must be one of {context['expected']}"
    elif kind == "value_error":
        limit = str(context["error"])
    else:  # pydantic's own words: "Input should be a valid string"
        limit = _KINDS.get(kind) or f"must {detail['msg'].partition(' should ')[2]}"
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    given = f"{value:g}{shown_unit}" if is_number else repr(value)
    if field.is_required() or field.default is None or field.default_factory is not None:
        return InputError(f"{key} = {given} {limit}.{meaning}", key=key, value=value, limit=limit)
    default = field.default
    shown = f"{default:g}{shown_unit}" if isinstance(default, float) else repr(default)
    return InputError(
        f"{key} = {given} {limit}; the default is {shown}.{meaning}",
        key=key,
        value=value,
        limit=limit,
        way_out=f"the default is {shown}",
    )

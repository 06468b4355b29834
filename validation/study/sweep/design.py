"""Definition of a sweep: one TOML file that lists the runs, independent of their execution.

Several blocks are crossed: every case of the first with every one of the second; the last block changes
fastest. Runs are numbered from 0. The same definition gives the same values on every machine with the same
SciPy. ``docs/sweeps.md`` has an example and explains every key.
"""

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
import tomli_w
from numpy.typing import NDArray
from pydantic import Field, model_validator
from scipy.stats import qmc

from ampm.description import BodyDescription
from ampm.exceptions import InputError
from ampm.parameters import HUMAN, KEYS, OPTION_TABLES, SECTIONS, RunParameters, field_of, is_option, rounded
from ampm.presets import PRESETS
from ampm.run_file import key_info, load_run
from ampm.section import Option, Real, Section, read_toml, unknown
from ampm.tune.first_gait import first_gait
from models.load import build_body
from validation.judge.profiles import DEFAULT, Profile, find_profile, own_profile
from validation.store.environment import parameter_values
from validation.trial import users
from validation.trial.engine import check_drake

MOST_CASES = 100_000
"""Runs of one sweep at most, and points of a sampled block: of 10 s each they take 12 days of a core."""
STEPS_KEY, PLANNER_KEY = "gait.steps", "gait.planner"
ENGINE_KEY = "simulation.engine"
BODY_KEY = "body.source"

_TABLES = ("sweep", "set", "vary", "base")
_DIGITS = 12  # significant digits to which a grid's inner values are rounded


class Range(Section):
    """Values between two ends, in the unit of their key: ``{ from = 0.8, to = 1.4, count = 7 }``."""

    start: Real = Field(alias="from", description="lowest value")
    stop: Real = Field(alias="to", description="highest value")
    count: int | None = Field(None, description="values of a grid, both ends among them", ge=2, le=MOST_CASES)
    scale: Literal["linear", "log"] = Field("linear", description="log spaces by equal ratios")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if not self.start < self.stop:
            raise InputError(
                f"from = {self.start:g} must be less than to = {self.stop:g}; one value goes under [set]."
            )
        if self.scale == "log" and not self.start > 0.0:
            raise InputError(f"from = {self.start:g} must be > 0 with the scale log; take scale linear.")
        return self


class Block(Section):
    """One ``[[vary]]`` block: its method, and the values of each varied key."""

    method: Literal["grid", "list", "latin_hypercube", "sobol"] = Field(
        description="grid: all combinations; list: side by side; latin_hypercube, sobol: points in ranges"
    )
    count: int | None = Field(None, description="points of a sampled block", ge=1, le=MOST_CASES)
    keys: Mapping[str, Range | tuple[Option, ...]]

    @property
    def size(self) -> int:
        """Cases of this block alone."""
        if self.count is not None:
            return self.count
        counts = [v.count or 0 if isinstance(v, Range) else len(v) for v in self.keys.values()]
        return math.prod(counts) if self.method == "grid" else counts[0]

    @model_validator(mode="after")
    def _check(self) -> Self:
        sampled = self.method in ("latin_hypercube", "sobol")
        if sampled != (self.count is not None):
            verb = "needs a" if sampled else "has no"
            raise InputError(f"a {self.method} {verb} count of its own; correct it.", key="count")
        wanted = "a list, or a range with its count: { from = ..., to = ..., count = 5 }"
        if sampled:
            wanted = "a range without a count: { from = ..., to = ... }; give lists a block of their own"
        for key, value in self.keys.items():
            if sampled != (isinstance(value, Range) and value.count is None):
                raise InputError(f"{key} in a {self.method} must be {wanted}.", key=key)
        lengths = {key: v.count if isinstance(v, Range) else len(v) for key, v in self.keys.items()}
        if self.method == "list" and len(set(lengths.values())) > 1:
            found = ", ".join(f"{key} has {length}" for key, length in lengths.items())
            raise InputError(
                f"the lists stand side by side and must be equally long: {found}. For all combinations take "
                'method = "grid".'
            )
        return self

    def cases(self, generator: np.random.Generator) -> list[dict[str, Option]]:
        """Values of all keys, case by case."""
        count, keys = self.count or 0, len(self.keys)
        points = np.empty((0, keys))  # in 0 ... 1, of a sampled block
        if self.method == "latin_hypercube":
            points = qmc.LatinHypercube(d=keys, rng=generator).random(count)
        elif self.method == "sobol":  # balanced for powers of two; other numbers take the first points
            points = qmc.Sobol(d=keys, scramble=True, rng=generator).random_base2((count - 1).bit_length())
        columns = []
        for number, (key, value) in enumerate(self.keys.items()):
            is_whole = key_info(key).kind == "int"
            if not isinstance(value, Range):
                columns.append(list(value))
            elif self.count is None:
                columns.append(_spaced(value, is_whole))
            else:
                columns.append(_scaled(value, is_whole, points[:count, number]))
        rows = product(*columns) if self.method == "grid" else zip(*columns, strict=True)
        return [dict(zip(self.keys, row, strict=True)) for row in rows]


def _spaced(value: Range, is_whole: bool) -> list[Option]:
    """Values of a range of a grid."""
    space = np.geomspace if value.scale == "log" else np.linspace
    values = space(value.start, value.stop, value.count or 0)
    if is_whole:
        return np.rint(values).astype(int).tolist()
    # 1.0 instead of 1.0000000000000002: some gaits are exact only there.
    largest = max(abs(value.start), abs(value.stop))
    values = np.round(values, min(_DIGITS - math.ceil(math.log10(largest)), 300))
    values[0], values[-1] = value.start, value.stop
    return values.tolist()


def _scaled(value: Range, is_whole: bool, unit: NDArray[np.float64]) -> list[Option]:
    """Points of 0 ... 1 as values of a range; every whole number of an integer key gets an equal share."""
    half = 0.5 if is_whole else 0.0
    start, stop = value.start - half, value.stop + half
    if value.scale == "log":
        values = np.exp(math.log(start) + unit * (math.log(stop) - math.log(start)))
    else:
        values = start + unit * (stop - start)
    if is_whole:
        values = np.rint(values).astype(int)
    return np.clip(values, value.start, value.stop).astype(values.dtype).tolist()


_OF_PROFILES = (
    "gait.planner",
    "controller.contact_ramp",
    *(f"disturbance.push_{axis}" for axis in "xyz"),
    "sensors.estimator",
    "sensors.fix_rate",
)
"""Keys that decide on the profile of a run."""


class SweepDefinition(Section, section="sweep"):
    """A complete sweep: the same definition gives the same runs in the same order.

    ``base`` has the run of every gait, as read with the definition; :attr:`shared` adds steps and ``set``,
    and every run changes the varied keys. Several gaits are crossed with all blocks, as the first one.
    """

    name: str = Field("sweep", description="name of the sweep, for report and table", min_length=1)
    gait: str | tuple[str, ...] = Field(
        "normal", description="preset, or TOML file relative to the sweep's; or a list of them", min_length=1
    )
    steps: int | None = Field(30, description="of every run; None: those of its gait", ge=1, le=10_000)
    tune: bool = Field(False, description="find the values that every run leaves open; otherwise keep them")
    seed: int = Field(1, description="of the sampled blocks", ge=0, le=2**63 - 1)
    profile: str = Field("", description="profile that judges the runs; by default their own if alike")
    recordings: Literal["none", "failures", "worst"] = Field("failures", description="runs that are recorded")
    worst: int = Field(10, description="how many runs keep one at most, the worst first", ge=1, le=10_000)
    wall_clock: Real = Field(600.0, description="seconds after which a run on a worker counts as hung", gt=0)
    set: Mapping[str, Option] = Field(default_factory=dict)
    vary: tuple[Block, ...] = ()
    base: tuple[RunParameters, ...] = (RunParameters(),)

    @model_validator(mode="after")
    def _check(self) -> Self:
        find_profile(self.profile or "default")
        if not self.vary:
            raise InputError(
                "the sweep varies nothing; add a [[vary]] block, for example with "
                'method = "grid" and gait.c_y = [0.4, 1.0].'
            )
        places = [(key, "[set]") for key in self.set]
        for number, block in enumerate(self.vary, start=1):
            places += [(key, f"[[vary]] block {number}") for key in block.keys]
        where: dict[str, str] = {}
        for key, place in places:
            if key == STEPS_KEY:
                raise InputError(f"{key} stands in {place}; all runs have the steps of [sweep].", key=key)
            if key in where:
                raise InputError(f"{key} stands in {place}, and in {where[key]}; keep one.", key=key)
            where[key] = place
        if len(self.base) != len(self.gaits):
            raise InputError(f"{len(self.base)} [[base]] for {len(self.gaits)} gaits; give one for each.")
        for name in self.gaits:
            if self.gaits.count(name) > 1:
                raise InputError(f"several gaits are named {name!r}; name every gait once.", key="gait")
        if len(self) > MOST_CASES:
            raise InputError(
                f"the sweep would have {len(self):,} runs, more than {MOST_CASES:,}; lower a count, or vary "
                "several keys in one sobol block instead of crossing them."
            )
        _ = self.shared  # the shared parameters must be valid
        return self

    def __len__(self) -> int:
        """Number of runs."""
        return math.prod([len(self.base), *(block.size for block in self.vary)])

    @property
    def gaits(self) -> tuple[str, ...]:
        """The gaits, as the file names them."""
        return (self.gait,) if isinstance(self.gait, str) else self.gait

    @cached_property
    def shared(self) -> tuple[RunParameters, ...]:
        """What the runs of each gait share: it with ``steps`` and ``set``, as given unless they tune."""
        return tuple(self._complete(gait, {}) for gait in range(len(self.base)))

    @cached_property
    def _fixed(self) -> list[tuple[RunParameters, BodyDescription | None]]:
        """Each gait with ``steps`` and ``set``, and its body, which no key varies; None for the human."""
        steps = {} if self.steps is None else {STEPS_KEY: self.steps}
        runs = [run.replace({**self.set, **steps}) for run in self.base]
        return [(run, None if run.body.source == HUMAN else build_body(run).description) for run in runs]

    def _complete(self, gait: int, varied: Mapping[str, Option]) -> RunParameters:
        """A gait with varied keys; of a robot with its own values, which depend on engine and sensors."""
        run, body = self._fixed[gait]
        run = run.replace(varied) if varied else run
        run = run if body is None else first_gait(run, body)
        return run if self.tune else run.as_is()

    def gait_of(self, run: int) -> int:
        """Number of the gait of a run."""
        return run // (len(self) // len(self.base))

    @cached_property
    def judged_by(self) -> Profile:
        """The profile that judges the runs: by default their own, or ``default`` where they have several."""
        alike: dict[Any, int] = {}
        for run in range(len(self)):
            alike.setdefault((self.gait_of(run), *map(self.varied(run).get, _OF_PROFILES)), run)
        names = {self.profile} if self.profile else set[str]()
        for run in () if self.profile else alike.values():
            with suppress(InputError):  # a run whose keys do not go together
                names.add(own_profile(self.parameters(run)).name)
        return find_profile(*names) if len(names) == 1 else DEFAULT

    @property
    def keys(self) -> tuple[str, ...]:
        """Varied keys, in the order of the blocks."""
        return tuple(key for block in self.vary for key in block.keys)

    @cached_property
    def _cases(self) -> list[list[dict[str, Option]]]:
        """Cases of every block."""
        rngs = (np.random.default_rng([self.seed, number]) for number in range(len(self.vary)))
        return [block.cases(rng) for block, rng in zip(self.vary, rngs, strict=True)]

    @cached_property
    def _ends(self) -> dict[str, float]:
        """Upper ends of all ranges."""
        pairs = [pair for block in self.vary for pair in block.keys.items()]
        return {key: value.stop for key, value in pairs if isinstance(value, Range)}

    def values(self, key: str) -> tuple[Option, ...]:
        """Values of a key: those listed, both ends of a range, or those of the gaits."""
        for block in self.vary:
            if key in block.keys:
                values = block.keys[key]
                return (values.start, values.stop) if isinstance(values, Range) else values
        found = (parameter_values(run) for run in self.shared)
        return tuple(dict.fromkeys(values[key] for values in found if key in values))

    @property
    def options(self) -> dict[str, tuple[Option, ...]]:
        """Values of every option of a user's class, by its key."""
        found = dict.fromkeys(key for run in self.shared for key in (*parameter_values(run), *self.keys))
        return {key: self.values(key) for key in found if is_option(key)}

    def varied(self, run: int) -> dict[str, Option]:
        """Varied keys of one run; times and rates of a range are whole steps or ticks of it.

        Raises :class:`IndexError` if there is no such run.
        """
        if not 0 <= run < len(self):
            raise IndexError(f"there is no run {run}: the sweep has {len(self)}")
        _, *places = np.unravel_index(run, [len(self.base), *map(len, self._cases)])
        found: dict[str, Option] = {}
        for cases, place in zip(self._cases, places, strict=True):
            found |= cases[place]
        return rounded(found, self._ends, self.shared[self.gait_of(run)])

    def parameters(self, run: int) -> RunParameters:
        """Everything that describes one run; InputError if its keys do not go together."""
        return self._complete(self.gait_of(run), self.varied(run))

    def values_of(self, run: int) -> dict[str, Any]:
        """Every parameter of one run by key, also of one whose keys do not go together."""
        found = parameter_values(self.shared[self.gait_of(run)])
        with suppress(InputError):
            found |= parameter_values(self.parameters(run))
        return found | self.varied(run)

    def name_of(self, run: int) -> str:
        """Number of a run as text, with zeros in front so that names sort as numbers do."""
        return f"{run:0{len(str(len(self) - 1))}d}"


def load_sweep(path: str | Path) -> SweepDefinition:
    """Read a sweep's definition from a TOML file; nothing that it names is imported.

    Files of a gait, body or plan are searched in the same folder. Raises :class:`InputError` of no such file,
    no valid TOML, or no valid sweep.
    """
    path = Path(str(path))
    stem = path.stem.encode("utf-8", "backslashreplace").decode()  # a name may not be UTF-8
    return read_definition(read_toml(path), stem, path.parent)


def read_definition(table: Mapping[str, Any], name: str, folder: Path) -> SweepDefinition:
    """A sweep's definition from its tables; files that it names are searched in a folder."""
    for word, value in table.items():
        if word in _HEAD and not isinstance(value, dict):
            raise InputError(
                f"{word} = {value!r} belongs in the table [sweep]; put it below a line [sweep].", key=word
            )
        if word in RunParameters.model_fields:
            raise InputError(f"[{word}] is not a table of a sweep; put its keys under [set].", key=word)
        if word not in _TABLES:
            raise unknown(word, _TABLES)
        is_list = isinstance(value, list) and all(isinstance(item, dict) for item in value)
        if not (is_list if word in ("vary", "base") else isinstance(value, dict)):
            brackets = f"[[{word}]]" if word in ("vary", "base") else f"[{word}]"
            raise InputError(f"{word} must be written as {brackets}, with its keys below.", key=word)
    head = dict(table.get("sweep", {}))
    for word in head.keys() & set(_TABLES):
        raise unknown(f"sweep.{word}", [f"sweep.{known}" for known in _HEAD])
    with _place("[set]"):
        fixed = {key: _checked(key, value) for key, value in _flat(table.get("set", {})).items()}
    fixed |= {key: _beside(folder, str(fixed[key])) for key in (BODY_KEY, PLANNER_KEY) if key in fixed}
    gait = head.get("gait")
    gaits = tuple(gait) if isinstance(gait, list) else (gait,)
    if not gaits:
        raise InputError("sweep.gait = [] names no gait; name one, or leave the line out.", key="sweep.gait")
    if "base" in table:
        base = tuple(RunParameters(**item) for item in table["base"])
    else:
        body = fixed.get(BODY_KEY, HUMAN)
        base = tuple(_base(folder, item, body) for item in gaits)
    if isinstance(gait, list):
        head = {"steps": None, **head, "gait": gaits}
    elif base[0].body.source != HUMAN:  # nothing is known of its gait but size and speed
        head = {"gait": Path(base[0].body.source).stem, "tune": True, **head}
    blocks = []
    for number, item in enumerate(table.get("vary", []), start=1):
        with _place(f"[[vary]] block {number}"):
            blocks.append(_block(item, folder))
    head = {"name": name, "steps": base[0].gait.steps, **head}
    definition = SweepDefinition(**head, set=fixed, vary=tuple(blocks), base=base)
    if BODY_KEY in definition.keys:
        raise InputError(
            f"{BODY_KEY} cannot be varied, as every body has a gait of its own; make a sweep of each body, "
            f"with {BODY_KEY} under [set], and compare them with 'ampm compare'.",
            key=BODY_KEY,
        )
    return definition


def check_classes(definition: SweepDefinition) -> None:
    """Refuse a controller, planner, estimator or engine that there is not, before anything is walked."""
    first = {key: values[0] for key, values in definition.options.items()}
    first |= {key: values[0] for key in OPTION_TABLES.values() if (values := definition.values(key))}
    for key in OPTION_TABLES.values():
        for name in definition.values(key):
            users.check_classes(definition.shared[0].replace({**first, key: name}))
    if "drake" in definition.values(ENGINE_KEY):
        check_drake()


def _base(folder: Path, gait: Any, body: Any) -> RunParameters:
    """Parameters before those of the sweep: of a gait, and its body."""
    run = load_run(None if gait is None and body != HUMAN else _beside(folder, str(gait or "normal")))
    return run if body == HUMAN else run.replace({BODY_KEY: body})


def _beside(folder: Path, name: str) -> str:
    """A file beside the definition, or the name unchanged."""
    path = folder / name
    return str(path.resolve()) if name not in PRESETS and path.is_file() else name


def _block(table: Mapping[str, Any], folder: Path) -> Block:
    """A block of the file, with the varied keys beside the block's own keys."""
    own = {name: value for name, value in table.items() if name in ("method", "count")}
    found = _flat({name: value for name, value in table.items() if name not in own})
    if not found:
        raise InputError("no key is varied; add for example gait.c_y = [0.4, 0.7, 1.0].")
    keys = {key: _values(key, value) for key, value in found.items()}
    if isinstance(plans := keys.get(PLANNER_KEY), tuple):
        keys[PLANNER_KEY] = tuple(_beside(folder, str(plan)) for plan in plans)
    return Block(**own, keys=keys)


def _values(key: str, value: Any) -> Range | tuple[Option, ...]:
    """Values of one key of a block."""
    if key not in KEYS and not is_option(key):
        raise unknown(key, [*KEYS, "method", "count"])
    info = key_info(key)
    if isinstance(value, dict):
        if info.kind == "text":
            values = ", ".join(info.options) or "its values"
            raise InputError(f"{key} is a text and has no range; list {values}.", key=key)
        with _place(key):
            found = Range(**value)
        _checked(key, found.start), _checked(key, found.stop)
        return found
    if not isinstance(value, list) or not value:
        raise InputError(
            f"{key} = {value!r} must be a list with values, or a range; one value alone belongs under [set].",
            key=key,
        )
    return tuple(_checked(key, item) for item in value)


def _checked(key: str, value: Any) -> Option:
    """A value of TOML in the type of its key, checked by the rules of run files."""
    field_of(key)
    section, name, *option = key.split(".")
    found = getattr(SECTIONS[section](**{name: dict.fromkeys(option, value) if option else value}), name)
    return found[option[0]] if option else found


def _flat(table: Mapping[str, Any]) -> dict[str, Any]:
    """Namespaced keys of nested tables; ``gait.c_s = ...`` and ``"gait.c_s" = ...`` mean the same."""
    flat: dict[str, Any] = {}
    for name, value in table.items():
        nested = isinstance(value, dict) and ("." not in name or name in OPTION_TABLES)
        items = _flat({f"{name}.{k}": v for k, v in value.items()}) if nested else {name: value}
        for key, item in items.items():
            if key in flat:
                raise InputError(f"{key} stands twice; keep one.", key=key)
            flat[key] = item
    return flat


@contextmanager
def _place(where: str) -> Iterator[None]:
    """Add to an error the part of the file in which it is."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{where}: {error}", **error.details) from None


_HEAD = tuple(name for name in SweepDefinition.model_fields if name not in _TABLES)


def dump_sweep(definition: SweepDefinition) -> str:
    """TOML text that :func:`load_sweep` reads back as an equal definition, without any other file."""
    head = definition.model_dump(include=set(_HEAD), exclude_none=True)
    table: dict[str, Any] = {"sweep": head, "set": dict(definition.set)}
    # The file of a gait may change or be missing later, so its contents are included.
    gaits = definition.gaits
    if not set(gaits) <= set(PRESETS) or definition.base != tuple(map(load_run, gaits)):
        table["base"] = []
        for run in definition.base:  # what is given, and what differs from the defaults
            kept = run.given | {key for key in KEYS if run.value(key) != key_info(key).default}
            sections = run.giving(kept).model_dump(exclude_unset=True)
            table["base"].append({name: section for name, section in sections.items() if section})
    text = tomli_w.dumps(table)
    for block in definition.vary:
        text += "\n[[vary]]\n" + tomli_w.dumps(block.model_dump(exclude={"keys"}, exclude_none=True))
        for key, value in block.keys.items():
            if isinstance(value, Range):  # as a table it would come last, and change the order of the runs
                items = value.model_dump(by_alias=True, exclude_none=True).items()
                inside = ", ".join(tomli_w.dumps({name: item}).strip() for name, item in items)
                text += f'"{key}" = {{ {inside} }}\n'
            else:
                text += tomli_w.dumps({key: value})
    return text

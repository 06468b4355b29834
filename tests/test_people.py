"""Recorded people: their table, the benchmark's files, and the comparison with a run."""

import json
from pathlib import Path

import numpy as np
import pytest

import validation as val
from ampm.exceptions import InputError
from ampm.parameters import GRAVITY
from validation.store.saved import load_saved_run
from validation.store.tables import write_columns
from validation.study.people.compare import PERSON, PLAN, SIMULATION
from validation.study.people.walking import PHASES, take_overs
from validation.trial.columns import read_columns

MASS, SPEED, STRIDE = 72.0, 1.2, 1.1  # of the synthetic person [kg, m/s, s]


def columns_of(folder: Path, *, by_foot: bool = True) -> dict[str, np.ndarray]:
    """What force plates and markers would have recorded of a run."""
    signals = load_saved_run(folder).signals
    names = {"time": "time"} | {f"com_{axis}": f"measured_com_{axis}" for axis in "xyz"}
    names |= {f"angular_momentum_{axis}": f"measured_angular_momentum_{axis}" for axis in "xyz"}
    feet = {f"{foot}_force_{axis}": f"{foot}_force_{axis}" for foot in ("left", "right") for axis in "xyz"}
    names |= feet if by_foot else {f"force_{axis}": f"measured_force_{axis}" for axis in "xyz"}
    names |= {} if by_foot else {f"cop_{axis}": f"measured_zmp_{axis}" for axis in "xy"}
    return {name: signals[column] for name, column in names.items()}


def person() -> dict[str, np.ndarray]:
    """Six strides on two plates: sinusoidal forces, feet in turn, a COM that obeys them."""
    time = np.arange(0.0, 6 * STRIDE, 0.005)
    w = 2.0 * np.pi / STRIDE
    left = np.clip(0.5 + 2.0 * np.sin(w * time), 0.0, 1.0)  # the feet's share changes within .08 of a stride
    force = MASS * np.stack(
        [
            -0.3 * np.sin(2 * w * time),
            0.4 * np.sin(w * time + 0.1),
            GRAVITY + 2.0 * np.cos(2 * w * time),
        ],
        axis=1,
    )
    com = np.stack(
        [
            SPEED * time + 0.3 / (2 * w) ** 2 * np.sin(2 * w * time),
            -0.4 / w**2 * np.sin(w * time + 0.1),
            0.95 - 2.0 / (2 * w) ** 2 * np.cos(2 * w * time),
        ],
        axis=1,
    )
    table = {"time": time}
    table |= {f"com_{axis}": com[:, k] for k, axis in enumerate("xyz")}
    for foot, share in (("left", left), ("right", 1.0 - left)):
        table |= {f"{foot}_force_{axis}": share * force[:, k] for k, axis in enumerate("xyz")}
    return table


def benchmark() -> dict[str, object]:
    """A file of the benchmark in its own units and axes: the person's right foot, from its contact on."""
    w, phase = 2.0 * np.pi, np.arange(101) / 100
    right = np.clip(0.5 + 2.0 * np.sin(w * phase), 0.0, 1.0)
    up = right * (1.0 + 0.2 * np.cos(2 * w * phase))
    forces = np.stack([-0.15 * right * np.sin(2 * w * phase), up, -0.05 * right], axis=1)
    frequency = 1.0 / (STRIDE * np.sqrt(GRAVITY / 0.9))
    return {
        "subject_mass": MASS, "subject_height": 1.8, "leglength": 0.9, "speed": SPEED,
        "stride_frequency": frequency, "grf_r": forces.tolist(), "grf_header": ["Fx", "Fy", "Fz"],
    }  # fmt: skip


def saved(table, path: Path) -> Path:
    write_columns(table, path)
    return path


@pytest.fixture(scope="module")
def folder(run_of):
    return run_of("normal", steps=8)


@pytest.mark.parametrize("by_foot", [True, False])
def test_a_run_as_a_recording_differs_from_itself_by_nothing(folder, by_foot, tmp_path):
    """And from its plan as the run does."""
    table = columns_of(folder, by_foot=by_foot)
    found = val.people(saved(table, tmp_path / "person.parquet"), folder)
    of = {(item.of, item.signal): item for item in found.differences if item.against == PLAN}
    same = {
        item.signal: item for item in found.differences if (item.of, item.against) == (PERSON, SIMULATION)
    }
    assert same.keys() >= {"force_x", "force_z", "com_y", "angular_momentum_y"}
    assert ("zmp_x" in same) is not by_foot
    # The recording has the first step, too.
    for name, item in same.items():
        limit = {"m": 1e-3, "N": 0.01 * found.weight, "N m s": 0.1}[item.unit]
        assert item.statistics.rmse < limit, name
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    for name in ("force_x", "force_y", "force_z"):
        one, two = of[SIMULATION, name], of[PERSON, name]
        assert one.rmse_limit == summary["metrics"][f"{name}_rmse"]["tolerance"]
        assert one.within
        assert two.within
        # A mean over strides has less error than the run.
        assert 0.2 < one.statistics.rmse / summary["metrics"][f"{name}_rmse"]["value"] < 1.05
    facts = found.facts
    assert facts["length of a step"][1][PERSON] == pytest.approx(0.6, abs=2e-3)
    assert facts["mass"][1][PERSON] == pytest.approx(60.0, rel=2e-3)
    assert facts["mass"][1][SIMULATION] == pytest.approx(60.0)
    assert facts["COM by markers less by force, y, RMS"][1][PERSON] < 1e-3
    assert found.kept(SIMULATION, PLAN)[0] == found.kept(SIMULATION, PLAN)[1]


def test_strides_speed_and_com_of_a_known_person(tmp_path):
    found = val.people(saved(person(), tmp_path / "person.csv"))
    strides = found.strides[PERSON]
    assert strides.count == 4
    assert strides.duration == pytest.approx(STRIDE, abs=1e-6)
    assert strides.speed == pytest.approx(SPEED, abs=1e-4)
    assert strides.weight == pytest.approx(MASS * GRAVITY, rel=1e-3)
    assert strides.both == pytest.approx(2 * np.arcsin(0.225) / np.pi, abs=0.01)
    assert strides.spread("force_x") < 1.0
    # COM by markers and by force are two ways to one curve.
    by_force = strides.com_by_force()
    for axis in "xyz":
        np.testing.assert_allclose(by_force[f"com_{axis}"], strides.mean(f"com_{axis}"), atol=2e-4)
    assert found.facts["range of the COM, vertical"][1][PERSON] == pytest.approx(
        4.0 / (4 * np.pi / STRIDE) ** 2, rel=1e-2
    )
    assert f"gait.step_length={0.5 * SPEED * STRIDE:.3f}"[:-1] in found.notes[-1]


def test_belt_speed_makes_a_treadmill_a_floor(tmp_path):
    table = person()
    table["com_x"] = table["com_x"] - SPEED * table["time"]
    still = val.people(saved(table, tmp_path / "still.csv")).strides[PERSON]
    assert still.speed == pytest.approx(0.0, abs=1e-4)
    table["belt_speed"] = np.full(len(table["time"]), SPEED)
    walks = val.people(saved(table, tmp_path / "walks.csv")).strides[PERSON]
    assert walks.speed == pytest.approx(SPEED, abs=1e-4)
    np.testing.assert_allclose(walks.mean("com_x"), still.mean("com_x"), atol=2e-5)


def test_gaps_are_left_out_and_not_filled(tmp_path):
    table = person()
    whole = val.people(saved(table, tmp_path / "whole.csv")).strides[PERSON]
    table["com_y"] = np.where((table["time"] > 2.0) & (table["time"] < 2.4), np.nan, table["com_y"])
    holed = val.people(saved(table, tmp_path / "holed.csv")).strides[PERSON]
    assert np.isnan(holed.curves["com_y"]).sum() > PHASES // 4
    assert np.isfinite(holed.mean("com_y")).all()
    assert np.abs(holed.mean("com_y") - whole.mean("com_y")).max() < 0.02


def test_a_file_of_the_benchmark(folder, tmp_path, ampm):
    path = tmp_path / "Person_12ms.json"
    path.write_text(json.dumps(benchmark()), encoding="utf-8")
    found = val.people(path, folder)
    strides = found.strides[PERSON]
    assert strides.duration == pytest.approx(STRIDE)
    assert strides.speed == pytest.approx(SPEED)
    forward, sideways = strides.mean("left_force_x"), strides.mean("left_force_y")
    # The left foot first brakes, then pushes; the floor pushes it to the right, where the other foot is.
    assert forward[20] < 0.0 < forward[70]
    assert sideways[50] == pytest.approx(-0.05 * MASS * GRAVITY)
    assert {item.signal for item in found.differences if item.of == PERSON} == {
        *(f"{name}_{axis}" for name in ("force", "com") for axis in "xyz"),
        *(f"left_force_{axis}" for axis in "xyz"),
    }
    assert len(found.notes) == 3

    # Written as a table of ours it is the same person.
    assert ampm("people", path, "--write", tmp_path / "person.csv").status == 0
    assert read_columns(tmp_path / "person.csv").keys() >= {"left_force_z", "belt_speed"}
    again = val.people(tmp_path / "person.csv", folder)
    for one, two in zip(found.differences, again.differences, strict=True):
        assert one.statistics.rmse == pytest.approx(two.statistics.rmse, rel=1e-9)


def test_the_command_prints_and_draws(folder, tmp_path, ampm):
    path = saved(person(), tmp_path / "person.csv")
    answer = ampm("people", path, "--beside", folder, "--plot", tmp_path / "people.png")
    assert answer.status == 0, answer.err
    assert (tmp_path / "people.png").stat().st_size > 20_000
    for text in ("time of a stride", "person - plan", "simulation less plan", "ampm validate normal --set"):
        assert text in answer.out
    facts = ampm("people", path, "--json").json["facts"]
    assert facts["mean speed"] == {"unit": "m/s", "person": pytest.approx(SPEED, abs=1e-3)}


def test_the_suggested_gait_has_the_persons_speed(tmp_path, ampm):
    note = val.people(saved(person(), tmp_path / "person.csv")).notes[-1]
    settings = [word for word in note.split() if "=" in word]
    plan = ampm("plan", "normal", *(word for text in settings for word in ("--set", text)), "--json")
    assert plan.status == 0, plan.err
    assert plan.json["mean_velocity"] == pytest.approx(SPEED, rel=2e-3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"time": None}, "no column 'time'"),
        ({"left_force_y": None}, "no column 'left_force_y'"),
        ({"left_force_z": -1.0}, "must be more than 10 N"),
        ({"left_force_z": 1e-3}, "upwards, in newtons"),
        ({"right_force_x": "hole"}, "row 11 of person.csv: right_force_x = nan"),
        ({"time": "turn"}, "row 2 of person.csv: time"),
        ({"com_z": "thousandths"}, "give lengths in metres"),
        ({"time": "thousandths"}, "give the time in seconds"),
        ({"com_x": "words"}, "com_x must be numbers"),
        ({"rows": 150}, "no whole stride"),
    ],
)
def test_bad_recordings_are_refused(change, message, tmp_path):
    table = person()
    for name, what in change.items():
        if what is None:
            del table[name]
        elif name == "rows":
            table = {key: values[:what] for key, values in table.items()}
        elif isinstance(what, float):
            table = {k: what * v if k.endswith("force_z") else v for k, v in table.items()}
        elif what == "hole":
            table[name] = np.where(np.arange(len(table[name])) == 10, np.nan, table[name])
        else:
            table[name] = {
                "turn": lambda v: v[::-1],
                "thousandths": lambda v: 1e3 * v,
                "words": lambda v: np.array(["far"] * len(v), dtype=object),
            }[what](table[name])
    with pytest.raises(InputError, match=message):
        val.people(saved(table, tmp_path / "person.csv"))


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("x.json", {"grf_r": [[1, 2]] * 20}, "grf_r must be 11 rows"),
        ("x.json", {"grf_r": None}, "grf_r must be 11 rows"),
        ("x.json", {"speed": "fast"}, "speed = 'fast' must be a positive number"),
        ("x.json", {"stride_frequency": 0}, "stride_frequency = 0"),
        ("x.json", {"grf_l": [[0, 1, 0]] * 30}, "grf_l has 30 rows"),
        ("nowhere.csv", None, "no file"),
        ("person.xlsx", None, "must end in"),
        ("nowhere.json", None, "as JSON"),
    ],
)
def test_bad_or_missing_files_are_refused(name, change, message, tmp_path):
    if change is not None:
        (tmp_path / name).write_text(json.dumps(benchmark() | change), encoding="utf-8")
    with pytest.raises(InputError, match=message):
        val.people(tmp_path / name)


def test_take_overs_ignore_what_does_not_carry_the_weight_over():
    time = np.arange(0.0, 4.0, 0.01)
    share = 0.5 - 0.5 * np.cos(2 * np.pi * time)
    share[(time > 0.4) & (time < 0.45)] = 0.45  # a wobble around the half
    assert take_overs(time, share) == pytest.approx(np.array([0.25, 1.25, 2.25, 3.25]), abs=1e-3)
    assert take_overs(time, np.full(len(time), np.nan)).size == 0

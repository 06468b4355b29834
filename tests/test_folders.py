"""Output folders: nothing that exists is lost, nothing is seen half written."""

from contextlib import nullcontext
from pathlib import Path

import pytest

from ampm.exceptions import InputError
from validation.store.folders import check_target, names_folder, output_file, run_folder


def fill(folder, text="first"):
    (folder / "run.toml").write_text(text)
    (folder / "joints.parquet").write_text("")


def write_and_fail(context, write, error):
    with context as place:
        write(place)
        raise error


@pytest.fixture
def target(tmp_path):
    return tmp_path / "run"


@pytest.fixture
def run(target):
    """A run that exists already."""
    target.mkdir()
    fill(target)
    return target


def test_a_run_appears_whole(tmp_path):
    target = tmp_path / "deep" / "run"
    with run_folder(target, force=False) as folder:
        fill(folder)
        assert not target.exists()
    assert sorted(path.name for path in target.iterdir()) == ["joints.parquet", "run.toml"]
    assert [path.name for path in target.parent.iterdir()] == ["run"]


def test_an_existing_run_needs_force(tmp_path, run):
    with pytest.raises(InputError, match="--force"), run_folder(run, force=False):
        pass
    with run_folder(run, force=True) as folder:
        fill(folder, "second")
        assert (run / "run.toml").read_text() == "first"
    assert (run / "run.toml").read_text() == "second"
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_an_error_leaves_the_old_run_and_what_was_written(tmp_path, run):
    with pytest.raises(KeyboardInterrupt) as caught:
        write_and_fail(run_folder(run, force=True), lambda place: fill(place, "second"), KeyboardInterrupt)
    assert (run / "run.toml").read_text() == "first"
    (partial,) = [path for path in tmp_path.iterdir() if path != run]
    assert (partial / "run.toml").read_text() == "second"
    assert str(partial) in caught.value.__notes__[0]


@pytest.mark.parametrize("exists", [False, True])
def test_an_error_before_anything_was_recorded_leaves_nothing(tmp_path, target, exists):
    if exists:
        target.mkdir()
    folder = run_folder(target, force=False)
    with pytest.raises(OSError):
        write_and_fail(folder, lambda place: (place / "run.toml").write_text(""), OSError)
    assert list(tmp_path.rglob("*")) == ([target] if exists else [])


@pytest.mark.parametrize("name", ["is_mount", "cwd"])
def test_a_mounted_volume_and_the_working_folder_are_not_replaced(target, monkeypatch, name):
    monkeypatch.setattr(Path, name, lambda path=target: path == target if name == "is_mount" else path)
    with pytest.raises(InputError, match="cannot be renamed; give another"), run_folder(target, force=True):
        pass


@pytest.mark.parametrize(
    ("files", "force", "known", "marks", "refused"),
    [
        (None, False, {"a"}, {"a"}, None),  # does not exist
        ((), False, {"a"}, {"a"}, None),
        ("a", False, {"a"}, {"a"}, "--force"),
        ("a", True, {"a", "b"}, {"a"}, None),
        ("ax", True, {"a", "b"}, {"a"}, "'x', which no study writes"),
        ("b", True, {"a", "b"}, {"a"}, "holds no study"),
        ("b", True, {"a", "b"}, (), None),
        ("ax", True, None, {"a"}, None),  # what else is in it stays
        ("x", True, None, {"a"}, "holds no study"),
    ],
)
def test_what_is_of_another_kind_is_never_replaced(target, files, force, known, marks, refused):
    if files is not None:
        target.mkdir()
        for name in files:
            (target / name).write_text("mine")
    with nullcontext() if refused is None else pytest.raises(InputError, match=refused):
        check_target(target, known, force=force, marks=marks, what="study")
    assert refused is None or (target / files[-1]).read_text() == "mine"


def test_a_file_appears_whole(tmp_path):
    target = tmp_path / "motion.parquet"
    target.write_text("old")
    with pytest.raises(InputError, match="--force"), output_file(target, force=False):
        pass
    with pytest.raises(OSError):
        write_and_fail(output_file(target), lambda place: place.write_text("half"), OSError)
    assert target.read_text() == "old"
    with pytest.raises(InputError, match=r"motion\.parquet cannot be written"), output_file(target):
        raise PermissionError(13, "Permission denied")
    with output_file(target) as work:
        work.write_text("new")
    assert target.read_text() == "new"
    assert [path.name for path in tmp_path.iterdir()] == ["motion.parquet"]


def test_a_preset_is_not_a_folder_of_its_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for folder in ("normal", "walked"):
        Path(folder).mkdir()
    folders = {text for text in ("./normal", "walked", "runs/missing") if names_folder(text)}
    assert folders == {"./normal", "walked", "runs/missing"}
    assert not any(map(names_folder, ("normal", "momentum", "own/gait.toml")))

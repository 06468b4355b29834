"""Output folders: nothing that exists is lost, nothing is seen half written."""

from __future__ import annotations

import pytest

from ampm.exceptions import InputError
from validation.store.folders import output_file, run_folder


def fill(folder, text="first"):
    (folder / "run.toml").write_text(text)
    (folder / "joints.parquet").write_text("")


def test_a_run_appears_whole(tmp_path):
    target = tmp_path / "deep" / "run"
    with run_folder(target, force=False) as folder:
        fill(folder)
        assert not target.exists()
    assert sorted(path.name for path in target.iterdir()) == ["joints.parquet", "run.toml"]
    assert [path.name for path in target.parent.iterdir()] == ["run"]


def test_an_empty_folder_is_filled_in_place(tmp_path):
    target = tmp_path / "run"
    target.mkdir()
    inode = target.stat().st_ino
    with run_folder(target, force=False) as folder:
        fill(folder)
    assert target.stat().st_ino == inode
    assert (target / "run.toml").exists()


def test_an_existing_run_needs_force(tmp_path):
    target = tmp_path / "run"
    target.mkdir()
    fill(target)
    with pytest.raises(InputError, match="--force"), run_folder(target, force=False):
        pass
    with run_folder(target, force=True) as folder:
        fill(folder, "second")
        assert (target / "run.toml").read_text() == "first"
    assert (target / "run.toml").read_text() == "second"
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_what_is_no_run_is_never_replaced(tmp_path):
    target = tmp_path / "thesis"
    target.mkdir()
    fill(target)
    (target / "chapter.tex").write_text("mine")
    with pytest.raises(InputError, match=r"chapter\.tex"), run_folder(target, force=True):
        pass
    assert (target / "chapter.tex").read_text() == "mine"


def test_an_error_leaves_the_old_run_and_what_was_written(tmp_path):
    target = tmp_path / "run"
    target.mkdir()
    fill(target)

    def write_and_fail():
        with run_folder(target, force=True) as folder:
            fill(folder, "second")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as caught:
        write_and_fail()
    assert (target / "run.toml").read_text() == "first"
    (partial,) = [path for path in tmp_path.iterdir() if path != target]
    assert (partial / "run.toml").read_text() == "second"
    assert str(partial) in caught.value.__notes__[0]


@pytest.mark.parametrize("exists", [False, True])
def test_an_error_before_anything_was_recorded_leaves_nothing(tmp_path, exists):
    target = tmp_path / "run"
    if exists:
        target.mkdir()

    def write_and_fail():
        with run_folder(target, force=False) as folder:
            (folder / "run.toml").write_text("")
            raise ValueError

    with pytest.raises(ValueError):
        write_and_fail()
    assert list(tmp_path.rglob("*")) == ([target] if exists else [])


def test_a_file_is_no_folder(tmp_path):
    (tmp_path / "run").write_text("")
    with pytest.raises(InputError, match="not a folder"), run_folder(tmp_path / "run", force=True):
        pass


def test_a_file_appears_whole(tmp_path):
    target = tmp_path / "motion.parquet"
    target.write_text("old")
    with pytest.raises(InputError, match="--force"), output_file(target, force=False):
        pass

    def write_and_fail():
        with output_file(target) as work:
            work.write_text("half")
            raise ValueError

    with pytest.raises(ValueError):
        write_and_fail()
    assert target.read_text() == "old"
    with output_file(target) as work:
        work.write_text("new")
    assert target.read_text() == "new"
    assert [path.name for path in tmp_path.iterdir()] == ["motion.parquet"]

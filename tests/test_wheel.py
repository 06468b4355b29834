"""A built wheel walks from another folder, without this checkout. To build it, pip fetches hatchling."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.test_docs import blocks

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("ampm", "models", "validation", "benchmarks")


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """Folder into which the wheel is installed, without its dependencies."""
    folder = tmp_path_factory.mktemp("wheel")
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, "wheel", "--no-deps", "--wheel-dir", folder, ROOT], check=True)
    wheel = next(folder.glob("ampm-*.whl"))
    subprocess.run([*pip, "install", "--no-deps", "--target", folder / "installed", wheel], check=True)
    return folder / "installed"


@pytest.mark.slow
def test_a_wheel_has_every_file_of_the_packages(installed):
    kept = {path for name in PACKAGES for path in ROOT.joinpath(name).rglob("*") if path.is_file()}
    wanted = {path.relative_to(ROOT) for path in kept if "__pycache__" not in path.parts}
    assert {path for path in wanted if not (installed / path).is_file()} == set()


@pytest.mark.slow
@pytest.mark.parametrize(
    "arguments",
    [
        ("-m", "ampm", "validate", "normal", "--steps", "3", "--out", "run"),
        ("-m", "ampm", "validate", "--body", str(ROOT / "docs/examples/biped.toml"), "--steps", "3"),
        ("-c", next(text for language, text in blocks(ROOT / "docs/howto/log.md") if language == "python")),
    ],
    ids=["preset", "body", "log"],
)
def test_a_wheel_walks_elsewhere(installed, tmp_path, arguments):
    elsewhere = [path for path in sys.path if path and not Path(path, "pyproject.toml").exists()]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(installed), *elsewhere])}

    def run(*arguments):
        python = (sys.executable, "-S", *arguments)  # without the paths of an editable installation
        answer = subprocess.run(python, cwd=tmp_path, env=environment, capture_output=True, text=True)
        assert answer.returncode == 0, answer.stderr
        return answer.stdout.split()

    found = run("-c", "import ampm, importlib.util as u; print(ampm.__file__, u.find_spec('docs'))")
    assert found == [str(installed / "ampm/__init__.py"), "None"]
    run(*arguments)

"""Environments of the peers: each has its own in the user's cache, none touches the project's."""

import importlib.util
import os
import signal
import subprocess
import sys
import tempfile
import venv
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import platformdirs

ROOT = Path(__file__).resolve().parents[2]


class Peer(NamedTuple):
    """Another library.

    Attributes:
        module: that it imports; where the project's own environment has it, no other is made.
        requirements: what ``pip`` installs.
    """

    module: str
    requirements: tuple[str, ...]


OURS = Peer("ampm", ())
PEERS = {
    "OSQP, its defaults": Peer("osqp", ("osqp==1.1.3",)),
    "DAQP": Peer("daqp", ("daqp==0.11.0",)),
    "ProxQP": Peer("proxsuite", ("proxsuite==0.8.0", "numpy<3")),
    "PIQP": Peer("piqp", ("piqp==0.6.4", "numpy<3")),
    "Clarabel": Peer("clarabel", ("clarabel==0.11.1", "numpy<3", "scipy")),
    "quadprog": Peer("quadprog", ("quadprog==0.1.14", "numpy<3")),
    "mink": Peer("mink", ("mink==1.3.0", "daqp")),
    "pink": Peer("pink", ("pin-pink==4.4.0", "daqp")),
    "placo IK": Peer("placo", ("placo==0.10.2",)),
    "placo": Peer("placo", ("placo==0.10.2",)),
    # The wheel of 1.10.0 crashes when it gets a model, with Pinocchio 4.1 and 4.0.
    "TSID": Peer("tsid", ("tsid==1.7.1", "pin==3.4.0", "cmeel-urdfdom<5", "cmeel-tinyxml2<11")),
}


class MissingPeer(Exception):
    """A peer that cannot be measured; the message is the reason."""


def folder() -> Path:
    """Where the environments are."""
    return platformdirs.user_cache_path("ampm") / "peers"


def python_of(peer: Peer, *, install: bool) -> str:
    """The interpreter of a peer, whose environment is made if it is allowed.

    Raises:
        MissingPeer: it is not installed, and may not or cannot be.
    """
    if importlib.util.find_spec(peer.module) is not None:
        return sys.executable
    home = folder() / peer.requirements[0]
    python, stamp = str(home / "bin" / "python"), home / "installed"
    if not stamp.exists():
        if not install:
            raise MissingPeer("not installed")
        venv.create(home, clear=True, with_pip=True)
        command = [
            python,
            "-m",
            "pip",
            "install",
            "--quiet",
            "--disable-pip-version-check",
            *peer.requirements,
        ]
        done = subprocess.run(command, capture_output=True, text=True, check=False, env=_plain())
        if done.returncode:
            errors = [line for line in done.stderr.splitlines() if line.startswith("ERROR")]
            raise MissingPeer(f"cannot be installed: {' '.join(errors[-1:]) or done.returncode}")
        stamp.touch()
    return python


def work(script: str, name: str, arrays: dict[str, Any], *, install: bool) -> dict[str, Any]:
    """Run a script of this package for one peer, in its own environment and process.

    Args:
        script: name of the file; it gets the peer's name, a file with arrays, and the file to write.
        name: of the peer, or of ours.
        arrays: what the script needs.
        install: whether a missing environment is made.

    Raises:
        MissingPeer: it is not installed, or fails.
    """
    peer = PEERS.get(name, OURS)
    python = python_of(peer, install=install)
    environment = _plain()
    if python == sys.executable:
        environment["PYTHONPATH"] = str(ROOT)
    with tempfile.TemporaryDirectory(prefix="ampm-peers-") as place:
        source, target = Path(place) / "in.npz", Path(place) / "out.npz"
        np.savez(source, **arrays)
        command = [python, str(Path(__file__).parent / script), name, str(source), str(target)]
        done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
        if done.returncode < 0:
            raise MissingPeer(f"crashes: {signal.Signals(-done.returncode).name}")
        if done.returncode:
            raise MissingPeer(f"fails: {done.stderr.strip().splitlines()[-1]}")
        with np.load(target) as data:
            return {key: data[key] for key in data.files}


def _plain() -> dict[str, str]:
    """The variables of this process without the project's folder."""
    return {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}

"""Modules of a user, which reach workers by value, so that they need no installation there."""

import os
import sys
import sysconfig
from functools import cache

import cloudpickle


def send_by_value() -> None:
    """Have cloudpickle send every loaded module that is no installed package and not of this project.

    Without this, it would send the name of a module, which workers started elsewhere cannot import.
    """
    _register(len(sys.modules))


@cache
def _register(loaded: int) -> None:
    """Once for a number of loaded modules, as looking at all of them takes 50 ms."""
    root = os.path.dirname(os.path.realpath(sys.modules["ampm"].__path__[0]))
    ours = [os.path.join(root, name) + os.sep for name in ("ampm", "models", "validation", "benchmarks")]
    installed = map(os.path.realpath, {sys.prefix, sys.base_prefix, *sysconfig.get_paths().values()})
    known = (*ours, *(path + os.sep for path in installed))
    for name, module in list(sys.modules.items()):
        file = getattr(module, "__file__", None)
        if name != "__main__" and file and not os.path.realpath(file).startswith(known):
            cloudpickle.register_pickle_by_value(module)

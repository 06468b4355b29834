"""Public names of a package, imported when they are first read.

NumPy, pydantic and simulators would delay every start. The package's stub ``__init__.pyi`` is the one list of
its names, which type checkers and editors read, too.
"""

import re
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any


def public_names(package: str, file: str) -> tuple[list[str], Callable[[str], Any], Callable[[], list[str]]]:
    """Names that a package's stub imports, its ``__getattr__`` and its ``__dir__``."""
    stub = Path(file).with_suffix(".pyi").read_text(encoding="utf-8")
    lines = re.findall(r"^from (\S+) import (\w+) as (\w+)$", stub, re.MULTILINE)
    homes = {name: (module, original) for module, original, name in lines}

    def read(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module, original = homes[name]
        value = getattr(import_module(module), original)
        setattr(sys.modules[package], name, value)
        return value

    return sorted(homes), read, lambda: sorted({*vars(sys.modules[package]), *homes})

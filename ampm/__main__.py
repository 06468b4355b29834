"""``python -m ampm``: the command line, which belongs to the package that validates."""

from importlib import import_module

import_module("validation.cli.entry").main()

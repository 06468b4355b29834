"""``python -m validation.cli``, which is ``ampm``."""

from validation.cli.entry import main

main()

"""Colours of all pictures."""

INK, FAINT, GRID, SHADE = "#1d2126", "#6c737d", "#e6e8ea", "#eceef1"
PLAN, COMMAND, MEASURED = "#0072b2", "#009e73", "#d55e00"
LEFT, RIGHT = "#8f2a62", "#a67c00"
GOOD, BAD = "#1a7f45", "#c62f3b"
PARTS = ("#332288", "#aa3377", "#33a088", "#ccbb44")
"""Colours of components and causes, from dark to light, so that they differ in grey, too."""

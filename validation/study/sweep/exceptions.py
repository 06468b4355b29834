"""What stops a sweep from outside."""

from __future__ import annotations

from ampm.exceptions import AmpmError


class SweepStopped(AmpmError):
    """The sweep cannot go on here and now: a full disk, a lost scheduler. ``--resume`` goes on later."""

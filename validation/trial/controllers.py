"""Controllers by name."""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from validation.trial.users import load_named

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ampm.walk import ControllerFactory

GROUP = "ampm.controllers"
"""Entry points by which an installed package adds a controller."""
CONTROLLERS: Mapping[str, str] = MappingProxyType(
    {
        "ampm": "ampm.control.controller:TrackingController",
        "joint-pd": "ampm.control.joint_pd:JointPD",
    }
)
"""The project's own controllers."""


def find_controller(name: str) -> ControllerFactory:
    """The controller of a name of :data:`CONTROLLERS`, of an installed package, or of ``module:Class``.

    Raises:
        InputError: there is none.
    """
    found: ControllerFactory = load_named("controller.name", name, CONTROLLERS, GROUP)
    return found


def name_of(factory: Any) -> str:
    """Name of what makes a controller: its own, or ``module:Class``."""
    kind = factory if hasattr(factory, "__qualname__") else type(factory)
    text = f"{kind.__module__}:{kind.__qualname__}"
    return next((name for name, place in CONTROLLERS.items() if place == text), text)

"""Controllers by name."""

from __future__ import annotations

import inspect
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from validation.trial.policy import OnnxPolicy
from validation.trial.users import check_options, load_named

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ampm.section import Option
    from ampm.walk import ControllerFactory

GROUP = "ampm.controllers"
"""Entry points by which an installed package adds a controller."""
POLICY = "onnx:"
"""Begin of the name of a policy in a file."""
CONTROLLERS: Mapping[str, str] = MappingProxyType(
    {
        "ampm": "ampm.control.controller:TrackingController",
        "joint-pd": "ampm.control.joint_pd:JointPD",
    }
)
"""The project's own controllers."""


def find_controller(name: str) -> ControllerFactory:
    """The controller of a name: ours, an installed package's, ``module:Class`` or ``onnx:FILE``.

    Raises:
        InputError: there is none.
    """
    if name.startswith(POLICY):
        return OnnxPolicy(name.removeprefix(POLICY))
    found: ControllerFactory = load_named("controller.name", name, CONTROLLERS, GROUP)
    return found


def check_controller(name: str, options: Mapping[str, Option]) -> None:
    """Refuse a name that is no controller, and options that it does not take, before anything is planned.

    Raises:
        InputError: there is no such controller, or an option is unknown or missing.
    """
    if name not in CONTROLLERS or options:
        check_options("controller.name", name, options, find_controller(name), 2)


def source_of(name: str) -> Path:
    """File that holds a controller.

    Raises:
        InputError: there is no such controller.
    """
    factory: Any = find_controller(name)
    return factory.path if isinstance(factory, OnnxPolicy) else Path(inspect.getfile(factory))


def name_of(factory: Any) -> str:
    """Name of what makes a controller, as :func:`find_controller` takes it."""
    if isinstance(factory, OnnxPolicy):
        return f"{POLICY}{factory.path}"
    kind = factory if hasattr(factory, "__qualname__") else type(factory)
    text = f"{kind.__module__}:{kind.__qualname__}"
    return next((name for name, place in CONTROLLERS.items() if place == text), text)

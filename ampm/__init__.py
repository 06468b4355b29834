"""AMPM: the gait planner of Kudoh & Komura (IROS 2003) and a controller that tracks its plans.

The package uses Pinocchio and OSQP, but no simulator: a body is given as a description and a Pinocchio model.
``__init__.pyi`` lists its names. Of these only ``FootstepPlanner``, ``PeriodicPlanner``, ``TablePlanner``,
``TrackingController`` and ``make_plan`` load Pinocchio.
"""

from ampm.lazy import public_names

__version__ = "0.1.0"

__all__, __getattr__, __dir__ = public_names(__name__, __file__)

"""The trial of a planned gait: walked in MuJoCo, measured, compared with its plan, judged.

Public interface: ``import ampm, validation as val``. ``__init__.pyi`` lists its names.
"""

from ampm.lazy import public_names

__all__, __getattr__, __dir__ = public_names(__name__, __file__)

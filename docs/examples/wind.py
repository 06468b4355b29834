"""A wind as a disturbance: the drag of the air on the trunk.

import ampm, validation as val
from docs.examples.wind import Wind

trial = val.walk(ampm.load_run("normal"), disturbances=[Wind()])
print(trial)

In a side wind of 4 m/s the ZMP of `normal` errs by 10 mm (RMS); one of 8 m/s fells it.
"""

from dataclasses import dataclass

import numpy as np

from validation.trial.disturbances import Plant


@dataclass(frozen=True)
class Wind:
    """Steady wind.

    Attributes:
        velocity: of the air, in world [m/s].
        start: when it begins [s].
        until: when it ends [s].
        drag_area: drag coefficient times frontal area of the trunk [m^2].
        density: of the air [kg/m^3].
    """

    velocity: tuple[float, float, float] = (0.0, 4.0, 0.0)
    start: float = 0.0
    until: float = float("inf")
    drag_area: float = 0.4
    density: float = 1.2

    def apply(self, time: float, plant: Plant) -> None:
        """Push the chest with the drag of the air that passes it."""
        if self.start <= time < self.until:
            relative = np.array(self.velocity) - plant.velocity("chest")
            drag = 0.5 * self.density * self.drag_area * np.linalg.norm(relative) * relative
            plant.push("chest", drag)

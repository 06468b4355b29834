"""What sensors read at a control tick, and the protocol of an estimator."""

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ampm.geometry import Array
from ampm.walk import State, Touch


class Readings(NamedTuple):
    """Readings of all sensors for one control tick."""

    time: float  # of the tick [s]
    age: float  # how old the readings are [s]
    angles: Array  # of the hinges, shape (nu,) [rad]
    rates: Array  # of the hinges, shape (nu,) [rad/s]
    gyro: Array  # rate of the root in its own axes, shape (3,) [rad/s]
    # acceleration of the root less gravity in its own axes, mean since the reading before, shape (3,) [m/s^2]
    accelerometer: Array
    force: Array  # normal force of every sole point, shape (P,) [N]; zeros with wrenches
    contact: NDArray[np.bool_]  # sole points that touch, by switches, shape (P,); False with wrenches
    position: Array | None = None  # of the root in the world, shape (3,) [m]; None without a fix
    # force and moment of the floor on every foot, about its sole's reference point and in that frame's axes,
    # shape (2, 6) [N, N m]; None without such sensors
    wrench: Array | None = None


class Estimator(Protocol):
    """Makes the state of the body from readings, once before every control tick.

    An estimator's class takes the body, :class:`ampm.body.robot.Robot`; the run, its section ``sensors``
    without seed, so that signs of biases are unknown; the state in which the walk is planned to start; and by
    name ``sensors.options``.

    One with a method ``begin(start)`` may watch the body stand (``sensors.stand``). At the walk's start
    it goes on from that state with what it found of the sensors.
    """

    def update(self, readings: Readings, commanded: Array | None) -> tuple[State, Touch]:
        """State and touch at the time of a tick.

        Args:
            readings: of this tick.
            commanded: accelerations of all coordinates that the controller commanded at the last tick, shape
                (nv,) [m/s^2, rad/s^2]: its ``acceleration``; None at the first tick, and of a controller
                without it.
        """

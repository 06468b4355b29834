"""What a policy observes of one tick, in :mod:`validation.environment` and as the controller of a trial."""

import numpy as np

from ampm.geometry import Array
from ampm.walk import Reference, State, Touch


def observe(state: State, touch: Touch, reference: Reference) -> dict[str, Array]:
    """What a policy observes of one tick: name to vector.

    - ``posture_error`` [rad], ``rate_error`` [rad/s]: of the joints, plan minus state, shape (nu,);
    - ``joints`` [rad], ``rates`` [rad/s]: of the joints, shape (nu,);
    - ``root_error``: of its position, plan minus state, world, shape (3,) [m];
    - ``orientation``: quaternion x, y, z, w of the root, shape (4,);
    - ``root_rate``: linear and angular velocity in root axes, shape (6,) [m/s, rad/s];
    - ``contact``: sole points that touch, shape (P,); ``planned_contact``: groups in contact, shape (6,);
    - ``planned_velocity`` [m/s], ``planned_acceleration`` [m/s^2]: of the COM, world, shape (3,).
    """
    return {
        "posture_error": reference.q[7:] - state.q[7:],
        "rate_error": reference.v[6:] - state.v[6:],
        "joints": state.q[7:].copy(),
        "rates": state.v[6:].copy(),
        "root_error": reference.q[:3] - state.q[:3],
        "orientation": state.q[3:7].copy(),
        "root_rate": state.v[:6].copy(),
        "contact": touch.contact.astype(np.float64),
        "planned_contact": reference.planned.astype(np.float64).ravel(),
        "planned_velocity": reference.com_velocity.copy(),
        "planned_acceleration": reference.com_acceleration.copy(),
    }

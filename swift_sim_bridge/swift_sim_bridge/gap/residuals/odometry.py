"""Residuals of visual-inertial odometry (VIO): its velocity against the pose's."""

import numpy as np

from swift_ros import geometry
from swift_sim_bridge.gap.recording.recording import Recording
from swift_sim_bridge.gap.residuals.filters import Filter, apply
from swift_sim_bridge.gap.residuals.kinematics import Kinematics
from swift_sim_bridge.sensors.vio import steady_drift


def velocity_error(q_world_body, v_world, terms: dict):
    """Return the error (n, 3) m/s in the world of the velocity that VIO measures.

    Args:
        q_world_body: (n, 4).
        v_world: (n, 3) m/s, the true velocity.
        terms: sensor terms.
    """
    error = np.zeros_like(v_world)
    if scale := terms.get("vio_scale"):
        error = scale.scale * v_world
    if drift := terms.get("vio_drift"):
        error = error + steady_drift(q_world_body, v_world, drift)
    return error


def measured_velocity(recording: Recording, low: Filter) -> np.ndarray:
    """Return VIO's velocity (m, 3) m/s in the body frame, by its own attitude."""
    v_vio = apply(low.slope, recording.p_vio)
    return geometry.rotate_inverse(recording.q_vio_body[low.rows], v_vio)


def velocity_residuals(v_vio, kinematics: Kinematics, low: Filter, terms: dict) -> np.ndarray:
    """Return VIO's minus the modelled velocity (1, m, 3) m/s.

    Each is in the body frame by its own attitude, so that VIO and pose need no common frame. The errors of VIO follow
    from the recorded velocity: the slope of a position whose stamps scatter has noise, which is in the residual too,
    and makes a scale seem smaller.

    Args:
        v_vio: (m, 3) m/s, see `measured_velocity`.
        kinematics: motion of the recording.
        low: the filter.
        terms: sensor terms.
    """
    q = kinematics.q_world_body
    error = velocity_error(q, apply(low.smooth, kinematics.moving.v_world), terms)
    return (v_vio - geometry.rotate_inverse(q, kinematics.v_world + error))[None]

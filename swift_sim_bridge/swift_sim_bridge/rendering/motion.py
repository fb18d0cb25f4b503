"""Pose and velocity of a body that carries a camera."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class BodyMotion:
    """Pose and velocity of a body at the stamp of an image.

    Attributes:
        p_world: (3,) m.
        q_world_body: (4,).
        v_world: (3,) m/s.
        omega_body: (3,) rad/s.
    """

    p_world: np.ndarray
    q_world_body: np.ndarray
    v_world: np.ndarray
    omega_body: np.ndarray

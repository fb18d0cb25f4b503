"""The attitude estimate of the flight controller."""

from dataclasses import dataclass

import numpy as np

from swift_ros import geometry
from swift_ros.configuration import setting, within
from swift_sim_bridge.sensors.coloured_noise import ColouredNoise


@dataclass(frozen=True)
class AttitudeSettings:
    """Section `attitude_estimate` of simulation.yaml.

    Attributes:
        tilt_deg: deg, standard deviation of roll and of pitch.
        memory_s: s, correlation time of the error.
    """

    tilt_deg: float = setting("deg, of estimates of flight controllers 0.2 to 3", 0.0, 20.0)
    memory_s: float = within(0.001, 10_000.0)


class AttitudeEstimate:
    """The true attitude with a slowly varying error of roll and pitch; the heading is not used."""

    def __init__(self, settings: AttitudeSettings, rng: np.random.Generator):
        self._sigma = np.radians(settings.tilt_deg)
        self._tilt = ColouredNoise(2, settings.memory_s, rng)

    def measure(self, q_world_body, dt: float) -> np.ndarray:
        """Return the estimate (4,) dt s after the last one."""
        tilt = self._tilt.step(dt, self._sigma)
        return tilted(tilt, q_world_body)


def tilted(tilt_world, q_world_body) -> np.ndarray:
    """Return the attitude (4,) rotated by `tilt_world` (2,) rad about the world's x and y."""
    error = geometry.quaternion_from_rotation_vector(np.array([tilt_world[0], tilt_world[1], 0.0]))
    return geometry.quaternion_multiply(error, np.asarray(q_world_body))

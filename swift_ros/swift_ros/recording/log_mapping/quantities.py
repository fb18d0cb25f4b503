"""Units, frames and sizes of the channels that a mapping can give."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

G = 9.80665  # m/s^2, standard gravity

LENGTH = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "km": 1e3, "ft": 0.3048}
SPEED = {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "km/h": 1.0 / 3.6}
RATE = {"rad/s": 1.0, "deg/s": np.pi / 180.0, "mrad/s": 1e-3}
ACCELERATION = {"m/s^2": 1.0, "g": G, "mg": 1e-3 * G, "cm/s^2": 1e-2, "mm/s^2": 1e-3}
ANGLE = {"rad": 1.0, "deg": np.pi / 180.0, "cdeg": np.pi / 18000.0}  # of Euler angles; a quaternion has no unit
ROTOR_SPEED = {"rad/s": 1.0, "rpm": np.pi / 30.0, "Hz": 2.0 * np.pi}
SHARE = {"1": 1.0, "%": 0.01}
VOLTAGE = {"V": 1.0, "mV": 1e-3}
CURRENT = {"A": 1.0, "mA": 1e-3}
TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
# Units of motor commands that have a range: what the motors get at 0 and at 1
RANGES = {"us": (1000.0, 2000.0), "DShot": (48.0, 2047.0)}

# Rotations from a frame to this project's: the world's with z up, the body's forward-left-up
WORLDS = {
    "ENU": np.eye(3),
    "NED": np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]),
    "y-up": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
}
BODIES = {
    "FLU": np.eye(3),
    "FRD": np.diag([1.0, -1.0, -1.0]),
    "RFU": np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
}


@dataclass(frozen=True)
class Quantity:
    """What a channel is.

    Attributes:
        sizes: possible numbers of columns; empty for one column for each rotor.
        units: factors to SI by name; the first one needs no name.
        world: the values have axes of a world.
        body: the values have axes of the body.
    """

    sizes: tuple[int, ...]
    units: dict[str, float]
    world: bool = False
    body: bool = False


QUANTITIES = {
    "p_world": Quantity((3,), LENGTH, world=True),
    "v_world": Quantity((3,), SPEED, world=True, body=True),
    "q_world_body": Quantity((4, 3), ANGLE, world=True, body=True),
    "gyro_body": Quantity((3,), RATE, body=True),
    "specific_force_body": Quantity((3,), ACCELERATION, body=True),
    "rotor_speed": Quantity((), ROTOR_SPEED),
    "motor_command": Quantity((), SHARE),
    "thrust_command": Quantity((1,), ACCELERATION),
    "omega_command_body": Quantity((3,), RATE, body=True),
    "feedforward_body": Quantity((3,), SHARE, body=True),
    "voltage": Quantity((1,), VOLTAGE),
    "current": Quantity((1,), CURRENT),
    "p_vio": Quantity((3,), LENGTH, world=True),
    "q_vio_body": Quantity((4, 3), ANGLE, world=True, body=True),
}

# Hz; supported rates of pose, accelerometer and actuation: at least the 50 Hz of residuals and identification
RATE_RANGE_HZ = (50.0, 2000.0)
# Relative tolerance of the rate range, for clocks with jitter: topics that PX4 logs at 50 Hz have steps of 20 to 24 ms
RATE_TOLERANCE = 0.1
# Hz; lowest rate of a pose beside a gyro and an accelerometer, which show the motion between its rows. PX4 logs its
# position ten times a second.
SLOW_POSE_HZ = 9.0
POSE, IMU = ("p_world", "q_world_body"), ("gyro_body", "specific_force_body")
FAST = (*POSE, "specific_force_body", "rotor_speed", "motor_command", "thrust_command")


def lowest_rate_hz(channel: str, rates: Mapping[str, float]) -> float:
    """Return the lowest rate that a channel may have, Hz: 0 where any will do.

    Args:
        channel: its name.
        rates: rates of all channels, Hz, by name.
    """
    low = RATE_RANGE_HZ[0] * (1 - RATE_TOLERANCE)
    if channel in POSE and all(rates.get(name, 0.0) >= low for name in IMU):
        return SLOW_POSE_HZ
    return low if channel in FAST else 0.0

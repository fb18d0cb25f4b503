"""The samples of a recording in which the vehicle flies."""

import numpy as np

from swift_ros.vehicle import GRAVITY, Vehicle

MOTOR_SETTLING = 6.0  # motor time constants after which the unknown first rotor speed has decayed to 0.25 %
STILL_S, STILL_M = 0.2, 0.02  # a vehicle on the ground moves less than this in its first or last moment
MAX_LIFT_ON_GROUND = 0.8  # of the weight: with more lift, a vehicle without motion hovers
CLEARANCE_M = 0.2  # distance from its place on the ground at which nothing touches the vehicle any more
MIN_LIFT = 0.1  # of the weight: with less lift, the rotors are off


def in_flight(values: dict, t, vehicle: Vehicle) -> np.ndarray:
    """Return where (n,) the vehicle flies and its motors no longer depend on their unknown first speed.

    Args:
        values: channels (n, k) by name; uses `rotor_speed` and `p_world` where present.
        t: (n,) s.
        vehicle: gives motor lag, thrust coefficient and mass.
    """
    found = t > t[0] + MOTOR_SETTLING * max(vehicle.motor.time_constant_up, vehicle.motor.time_constant_down)
    if "rotor_speed" not in values:
        return found
    lift = vehicle.thrust_coefficient * np.sum(values["rotor_speed"] ** 2, axis=1) / vehicle.mass
    found &= lift >= MIN_LIFT * GRAVITY
    return found & ~on_ground(values["p_world"], lift, t[1] - t[0]) if "p_world" in values else found


def on_ground(p_world, lift, dt: float) -> np.ndarray:
    """Return where (n,) the vehicle rests before take-off and after landing, until it is clear of its support.

    Args:
        p_world: (n, 3) m.
        lift: (n,) thrust over mass, m/s^2.
        dt: time step, s.
    """
    found, moment = np.zeros(len(lift), bool), max(1, round(STILL_S / dt))
    for order in (slice(None), slice(None, None, -1)):
        away = np.linalg.norm(p_world[order] - p_world[order][0], axis=1)
        if np.median(lift[order][:moment]) < MAX_LIFT_ON_GROUND * GRAVITY and away[:moment].max() < STILL_M:
            found[order] |= np.cumsum(away > CLEARANCE_M) == 0
    return found

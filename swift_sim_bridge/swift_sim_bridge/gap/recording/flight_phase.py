"""The samples of a recording in which the vehicle flies."""

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from swift_ros.recording.checks import true_runs
from swift_ros.vehicle import GRAVITY, Vehicle

MOTOR_SETTLING = 6.0  # motor time constants after which the unknown first rotor speed has decayed to 0.25 %
STILL_S, STILL_M = 0.2, 0.02  # a vehicle on the ground moves less than this in its first or last moment
MAX_LIFT_ON_GROUND = 0.8  # of the weight: with more lift, a vehicle without motion hovers
# A landing between two flights: for so long less than this share of the usual lift, without more motion than this. A
# vehicle in the air falls by 0.2 m and more meanwhile.
LANDED_S, MAX_SHARE_LANDED, LANDED_M = 0.6, 0.5, 0.2
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
    """Return where (n,) the vehicle rests on the ground, until it is clear of its support.

    Args:
        p_world: (n, 3) m.
        lift: (n,) thrust over mass, m/s^2.
        dt: time step, s.
    """
    n, moment = len(lift), max(1, round(STILL_S / dt))
    little = _little_lift(lift)
    found, rests = np.zeros(n, bool), _landings(p_world, lift < little, dt)
    for order, end in ((slice(None), 0), (slice(None, None, -1), n - 1)):
        away = np.linalg.norm(p_world[order][:moment] - p_world[end], axis=1)
        if np.median(lift[order][:moment]) < MAX_LIFT_ON_GROUND * GRAVITY and away.max() < STILL_M:
            rests.append((end, end))
    for first, last in rests:
        found[first : last + 1] = True
        for rows in (slice(last, None), slice(first, None, -1)):
            found[rows] |= _supported(p_world[rows], lift[rows] >= little)
    return found


def _little_lift(lift) -> float:
    """Return the lift below which a vehicle without motion is supported, m/s^2.

    Lift is compared with its usual value as well as with the weight: the thrust by the vehicle file may be wrong.
    """
    turning = lift >= MIN_LIFT * GRAVITY
    usual = np.median(lift[turning]) if turning.any() else np.inf
    return min(MAX_SHARE_LANDED * usual, MAX_LIFT_ON_GROUND * GRAVITY)


def _landings(p_world, little, dt: float) -> list[tuple[int, int]]:
    """Return first and last row of each time in which a vehicle with little lift (n,) does not fall."""
    window = 2 * max(1, round(0.5 * LANDED_S / dt)) + 1
    if len(little) < window:
        return []
    spread = np.linalg.norm(
        maximum_filter1d(p_world, window, axis=0) - minimum_filter1d(p_world, window, axis=0), axis=1
    )
    return true_runs(minimum_filter1d(little.astype(float), window).astype(bool) & (spread < LANDED_M))


def _supported(p_world, able) -> np.ndarray:
    """Return the rows (n,) up to that in which a vehicle has been able (n,) to fly and is clear of its first place.

    An estimated position may jump on the ground.
    """
    clear = np.linalg.norm(p_world - p_world[0], axis=1) > CLEARANCE_M
    return np.cumsum(clear & np.logical_or.accumulate(able)) == 0

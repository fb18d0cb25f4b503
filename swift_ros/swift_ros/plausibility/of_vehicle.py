"""Whether the numbers of a vehicle file can belong to a multicopter that flies. No ROS.

The limits of what is odd are wide: from a palm-sized vehicle of 20 g to one of 20 kg. A finding that is impossible
contradicts mechanics, or no such vehicle could take off, hover or be controlled.
"""

from collections.abc import Iterator

import numpy as np

from swift_ros.plausibility import of_battery, of_motors, of_propulsion
from swift_ros.plausibility.finding import Finding, first_findings

DRAGS = {"rotor_drag": ("k_d",), "linear_drag": ("k",), "body_drag": ("c",)}
MAX_ARM_M = 1.5
MAX_HEIGHT = 3.0  # of a hub from the centre of mass, over the reach of the propellers
# Radii of gyration over the longest arm: 0.35 to 0.6 of known vehicles. Below, no motor has a mass.
LEAST_GYRATION, LOW_GYRATION, HIGH_GYRATION = 0.03, 0.2, 1.1
DENSEST_KG_M3 = 22_600.0  # osmium
MAX_HULL = 10.0  # hull over the reach of the propellers
COVERED = 0.9  # share of that reach which a hull has at least
MAX_BODY_RATE = 34.9  # rad/s: 1,998 deg/s, the firmware's largest setpoint; common gyros measure up to 2,000 deg/s
MAX_SETTLING_S, LONG_SETTLING_S = 10.0, 2.0  # from rest to `rates.max` by the largest torque at hover
MAX_NOISE = {  # of one sample; a sensor with more measures nothing
    "position_m": 20.0,
    "velocity_m_s": 20.0,
    "attitude_rad": 1.0,
    "gyro_rad_s": 3.0,
    "accel_m_s2": 50.0,
    "vibration_m_s2": 100.0,
    "rotor_relative": 0.5,
    "vbat_v": 5.0,
    "ibat_a": 100.0,
}


def findings(vehicle) -> list[Finding]:
    """Return what is impossible about a `swift_ros.vehicle.Vehicle`, or else what is odd."""
    stages = (
        (_sizes, of_propulsion.signs, of_battery.signs),
        (
            _inertia,
            _rates,
            _drag,
            _noise,
            _hull,
            *of_propulsion.IMPOSSIBLE,
            *of_motors.IMPOSSIBLE,
            *of_battery.IMPOSSIBLE,
        ),
        (_control, of_battery.charge),
    )
    return first_findings(
        vehicle, stages, (_odd_size, _odd_control, *of_propulsion.ODD, *of_motors.ODD, *of_battery.ODD)
    )


def _arm_m(vehicle) -> float:
    """Return the distance of the outermost hub from the middle of the hubs."""
    places = of_propulsion.hubs(vehicle)[:, :2]
    return float(np.linalg.norm(places - places.mean(axis=0), axis=1).max()) if len(places) else 0.0


def reach_m(vehicle) -> float:
    """Return the distance of the outermost tip of a propeller from the middle of the hubs."""
    return _arm_m(vehicle) + vehicle.rotor_radius


def _gyrations_m(vehicle) -> np.ndarray:
    """Return the radii of gyration (3,), from the smallest."""
    return np.sqrt(np.linalg.eigvalsh(vehicle.inertia_matrix) / vehicle.mass)


def _sizes(vehicle) -> Iterator[str]:
    arm, height = _arm_m(vehicle), float(np.abs(of_propulsion.hubs(vehicle)[:, 2]).max(initial=0.0))
    if arm > MAX_ARM_M:
        yield f"under 'rotors' a hub is {arm:.3g} m from the middle of the hubs; give each 'position' in m"
    elif height > max(MAX_HEIGHT * reach_m(vehicle), vehicle.hull_height):
        yield (
            f"under 'rotors' a hub is {height:.3g} m above or below the centre of mass of a vehicle whose propellers "
            f"reach {reach_m(vehicle):.2g} m; give each 'position' in m"
        )


def _inertia(vehicle) -> Iterator[str]:
    matrix = vehicle.inertia_matrix
    if not np.allclose(matrix, matrix.T, rtol=1e-6, atol=1e-12):
        yield "'inertia' is not symmetric; give Ixy = Iyx, Ixz = Izx and Iyz = Izy"
    small, middle, large = np.linalg.eigvalsh(0.5 * (matrix + matrix.T))
    if large > 1.001 * (small + middle):
        yield (
            f"'inertia' belongs to no body: its largest principal moment {large:.3g} exceeds the sum of the others, "
            f"{small + middle:.3g} kg m^2; measure it again"
        )
        return
    arm, gyration = _arm_m(vehicle), _gyrations_m(vehicle)
    reach = max(reach_m(vehicle), vehicle.hull_radius)
    if arm > 0 and (gyration[-1] > reach or gyration[0] < LEAST_GYRATION * arm):
        yield (
            f"'inertia' and 'mass' {vehicle.mass:g} kg give radii of gyration of {gyration[0]:.2g} to "
            f"{gyration[-1]:.2g} m, of a vehicle with a radius of {reach:.2g} m; give 'inertia' in kg m^2"
        )
    elif small + middle + large < 3.0 * _ball_inertia(vehicle.mass):
        yield (
            f"'inertia' belongs to no vehicle of {vehicle.mass:g} kg: its mean principal moment "
            f"{(small + middle + large) / 3.0:.2g} kg m^2 is less than the {_ball_inertia(vehicle.mass):.2g} of a "
            "solid ball of osmium, the densest matter; give 'inertia' in kg m^2 and 'mass' in kg"
        )


def _ball_inertia(mass: float) -> float:
    """Return the inertia in kg m^2 of a ball of the densest matter: no body of this mass has a smaller mean moment."""
    return 0.4 * mass * (0.75 * mass / (np.pi * DENSEST_KG_M3)) ** (2.0 / 3.0)


def _rates(vehicle) -> Iterator[str]:
    if min(vehicle.rates.max) <= 0:
        yield "'rates.max' must be positive, in rad/s"
    elif max(vehicle.rates.max) > MAX_BODY_RATE:
        yield (
            f"'rates.max' reaches {max(vehicle.rates.max):g} rad/s, and the firmware ends at {MAX_BODY_RATE:g} rad/s "
            "(1,998 deg/s); give rad/s, not deg/s"
        )


def _control(vehicle) -> Iterator[str]:
    settling_s = _settling_s(vehicle)
    if settling_s.max() > MAX_SETTLING_S:
        yield (
            f"about its {'xyz'[int(settling_s.argmax())]} axis this vehicle needs {settling_s.max():.3g} s to its "
            "'rates.max': the rotors' torque is too small; check 'inertia', 'rotors', 'torque_coefficient' and "
            "'rates.max'"
        )


def _settling_s(vehicle) -> np.ndarray:
    """Return the times (3,) s from rest to the highest body rates by the largest torques at hover."""
    weight = vehicle.max_thrust / vehicle.thrust_to_weight
    spare = min(weight, max(vehicle.max_thrust - weight, 1e-3 * weight))
    levers = np.array([np.abs(row - row.mean()).mean() for row in of_propulsion.levers(vehicle)])
    inertia = np.diag(vehicle.inertia_matrix)
    return np.array(vehicle.rates.max) * inertia / np.maximum(levers * spare, 1e-12)


def _drag(vehicle) -> Iterator[str]:
    for term, keys in DRAGS.items():
        for key in keys:
            value = vehicle.terms.get(term, {}).get(key) if isinstance(vehicle.terms.get(term), dict) else None
            numbers = [v for v in np.ravel(value) if isinstance(v, int | float)] if value is not None else []
            if any(number < 0 for number in numbers):
                yield f"'terms.{term}.{key}' is negative: such a drag would drive the vehicle; give 0 or more"


def _noise(vehicle) -> Iterator[str]:
    for key, noise in vehicle.sensors.items():
        if noise > MAX_NOISE[key]:
            yield (
                f"'sensors.{key}' is {noise:g}, and a sensor with more than {MAX_NOISE[key]:g} measures nothing; give "
                "the unit in the key's name"
            )


def _hull(vehicle) -> Iterator[str]:
    arm, reach = _arm_m(vehicle), reach_m(vehicle)
    if vehicle.hull_radius < arm:
        yield (
            f"'hull_radius' {vehicle.hull_radius:g} m is smaller than the distance of a rotor's hub, {arm:.2g} m; give "
            f"the reach of frame and propellers, {reach:.2g} m"
        )
    elif max(vehicle.hull_radius, vehicle.hull_height) > MAX_HULL * reach:
        yield (
            f"'hull_radius' {vehicle.hull_radius:g} m and 'hull_height' {vehicle.hull_height:g} m do not fit a vehicle "
            f"whose propellers reach {reach:.2g} m; give m"
        )


def _odd_size(vehicle) -> Iterator[str]:
    arm, gyration = _arm_m(vehicle), _gyrations_m(vehicle)
    if arm > 0 and not LOW_GYRATION * arm <= gyration[0] <= gyration[-1] <= HIGH_GYRATION * arm:
        yield (
            f"'inertia' and 'mass' give radii of gyration of {gyration[0]:.2g} to {gyration[-1]:.2g} m beside arms of "
            f"{arm:.2g} m; check the units"
        )
    reach = reach_m(vehicle)
    if vehicle.hull_radius < COVERED * reach:
        yield f"'hull_radius' {vehicle.hull_radius:g} m does not cover the propellers, which reach {reach:.2g} m"


def _odd_control(vehicle) -> Iterator[str]:
    slowest = float(_settling_s(vehicle).max())
    if slowest > LONG_SETTLING_S:
        yield f"the rotors' torque needs {slowest:.2g} s to a body rate of 'rates.max'; little is left for control"

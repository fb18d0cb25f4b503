"""Whether the motors of a vehicle file reach the speeds of its rotors. No ROS."""

from collections.abc import Iterator

import numpy as np

from swift_ros.plausibility.finding import Check, unless
from swift_ros.plausibility.of_propulsion import strength, tips

MAX_TIME_CONSTANT_S, LONG_TIME_CONSTANT_S = 1.0, 0.25  # of motors; those of 13 inch propellers have 0.1 s
MIN_TIME_CONSTANT_S = 0.001  # the smallest motors have 0.01 s
HIGH_ROTOR_SHARE = 0.1  # of the mass, at the tips, that has the rotors' inertia; rotors have 0.01 to 0.03
FALL = 0.01  # of the speed on the way to full throttle, over the highest: less is the error of a fitted map
MAX_OVERSPEED, HIGH_OVERSPEED = 2.0, 1.3  # speed at full command by the motor map, over the highest one


def _descent(vehicle) -> Iterator[str]:
    weight = vehicle.max_thrust / vehicle.thrust_to_weight
    for key, command in (("controller.motor_idle", _idle(vehicle)), ("motor.map.coefficients", 0.0)):
        lifted = len(vehicle.rotors) * vehicle.thrust_coefficient * vehicle.motor_speed(command) ** 2
        if lifted >= weight:
            yield (
                f"with idle motors the rotors lift {lifted / weight:.2g} times the weight, so this vehicle never "
                f"comes down; check '{key}'"
            )
            return


def _idle(vehicle) -> float:
    """Return the motor command of an armed motor without throttle; 0 where the file does not give it."""
    idle = vehicle.controller.get("motor_idle", 0.0)
    return 0.01 * idle if isinstance(idle, int | float) and 0 <= idle <= 100 else 0.0


def _falling_map(vehicle) -> Iterator[str]:
    """Compare the speeds by the motor map from idle to full throttle, at the battery's reference voltage."""
    commands = np.linspace(_idle(vehicle), 1.0, 201)
    speeds = np.array([vehicle.motor_speed(command) for command in commands])
    falls = np.maximum.accumulate(speeds) - speeds
    last = int(np.argmax(falls))
    first = int(np.argmax(speeds[: last + 1]))
    if falls[last] > FALL * np.abs(speeds).max():
        yield (
            f"'motor.map.coefficients' fall from {speeds[first]:.0f} rad/s at {commands[first]:.0%} throttle to "
            f"{speeds[last]:.0f} rad/s at {commands[last]:.0%}, and no motor turns slower with more throttle; give c0 "
            "to c4 of a map that rises"
        )


def _lags(vehicle) -> Iterator[str]:
    for name in ("time_constant_up", "time_constant_down"):
        if getattr(vehicle.motor, name) > MAX_TIME_CONSTANT_S:
            yield f"'motor.{name}' is {getattr(vehicle.motor, name):g} s, and motors need 0.02 to 0.1 s; give s, not ms"
            return
        if getattr(vehicle.motor, name) < MIN_TIME_CONSTANT_S:
            yield f"'motor.{name}' is {getattr(vehicle.motor, name):g} s, and motors need 0.02 to 0.1 s; give s"
            return


def _full_throttle(vehicle) -> Iterator[str]:
    if vehicle.full_speed < vehicle.hover_speed:
        yield (
            f"at full throttle the rotors reach {vehicle.full_speed:.0f} rad/s, below the {vehicle.hover_speed:.0f} of "
            "hover; check 'motor.map.coefficients' and 'battery.reference_voltage'"
        )


def _overspeed(vehicle) -> Iterator[str]:
    full, highest = vehicle.motor_speed(1.0), vehicle.rotor_speed_range[1]
    if full > MAX_OVERSPEED * highest:
        yield (
            f"at full throttle 'motor.map.coefficients' give {full:.0f} rad/s, and 'rotor_speed_range' ends at "
            f"{highest:.0f}; give both in rad/s, not rpm"
        )


def _rotor_mass_share(vehicle) -> float:
    """Return the least mass that can have the inertia of all rotors, at their tips, over that of the vehicle."""
    inertia = _rotor_inertia(vehicle)
    return len(vehicle.rotors) * inertia / vehicle.rotor_radius**2 / vehicle.mass


def _rotor_inertia(vehicle) -> float:
    """Return the inertia of one rotor about its axis, kg m^2; 0 where the file does not give it."""
    entry = vehicle.terms.get("rotor_gyroscopic")
    inertia = entry.get("inertia", 0.0) if isinstance(entry, dict) else 0.0
    return float(inertia) if isinstance(inertia, int | float) else 0.0


def _spinning(vehicle) -> Iterator[str]:
    inertia, whole = _rotor_inertia(vehicle), vehicle.inertia_matrix[2, 2]
    if _rotor_mass_share(vehicle) > 1.0 or len(vehicle.rotors) * inertia > whole:
        mass = inertia / vehicle.rotor_radius**2
        yield (
            f"'terms.rotor_gyroscopic.inertia' {inertia:g} kg m^2 is that of {mass:.2g} kg at the tips of each "
            f"propeller, and the vehicle of {vehicle.mass:g} kg has {whole:.2g} kg m^2 in all; give that of one rotor"
        )


def _odd_spinning(vehicle) -> Iterator[str]:
    share = _rotor_mass_share(vehicle)
    if share > HIGH_ROTOR_SHARE:
        yield (
            f"'terms.rotor_gyroscopic.inertia' {_rotor_inertia(vehicle):g} kg m^2 needs {share:.0%} of the vehicle's "
            "mass at the tips of the propellers; give that of one rotor"
        )


def _odd_motor(vehicle) -> Iterator[str]:
    slowest = max(vehicle.motor.time_constant_up, vehicle.motor.time_constant_down)
    if slowest > LONG_TIME_CONSTANT_S:
        yield f"a time constant of the motors is {slowest:g} s; give s, not ms"
    full, highest = vehicle.motor_speed(1.0), vehicle.rotor_speed_range[1]
    if full > HIGH_OVERSPEED * highest:
        yield f"at full throttle the motor map gives {full:.0f} rad/s, beyond 'rotor_speed_range', {highest:.0f} rad/s"


IMPOSSIBLE: tuple[Check, ...] = (
    unless(_descent, tips, strength, _falling_map, _overspeed),
    _lags,
    unless(_full_throttle, _falling_map),
    _overspeed,
    _falling_map,
    _spinning,
)
ODD: tuple[Check, ...] = (_odd_motor, _odd_spinning)

"""Whether rotors, propellers and motors of a vehicle file lift and control it. No ROS."""

from collections.abc import Iterator

import numpy as np

from swift_ros.plausibility.finding import Check

MOTORS = ("rear right", "front right", "rear left", "front left")  # Betaflight's order
# Roll, pitch and yaw demands of each motor of Betaflight's quad X (mixer.c), and the axes of the body about which they
# turn it: forward, left, and down, because its yaw is positive to the right.
MIX = np.array([[-1.0, -1.0, 1.0, 1.0], [1.0, -1.0, 1.0, -1.0], [-1.0, 1.0, 1.0, -1.0]])
AXES = np.array([1.0, 1.0, -1.0])
AIR_DENSITY = 1.225  # kg/m^3 at sea level and 15 deg C (ISO 2533)
TIP_SPEED_M_S = 340.0  # of sound
# Drag torque over thrust, of the rotor's radius; real propellers have 0.1 to 0.3. Above 1, drag exceeds lift.
LEVER_SHARE, MAX_LEVER_SHARE = (0.02, 0.5), 1.0
MAX_THRUST_TO_WEIGHT, HIGH_THRUST_TO_WEIGHT, LOW_THRUST_TO_WEIGHT = 40.0, 25.0, 1.3  # the best racers reach 15
SAME_M = 0.005  # between two hubs at one place
ONE_PLANE, TOUCHING = 0.05, 0.98  # height between two discs over the radius; distance of their hubs over the diameter
MAX_TIME_CONSTANT_S, LONG_TIME_CONSTANT_S = 1.0, 0.25  # of motors; those of 13 inch propellers have 0.1 s
MIN_TIME_CONSTANT_S = 0.001  # the smallest motors have 0.01 s
HIGH_ROTOR_SHARE = 0.1  # of the mass, at the tips, that has the rotors' inertia; rotors have 0.01 to 0.03
FALL = 0.01  # of the speed on the way to full throttle, over the highest: less is the error of a fitted map
MAX_OVERSPEED, HIGH_OVERSPEED = 2.0, 1.3  # speed at full command by the motor map, over the highest one


def hubs(vehicle) -> np.ndarray:
    """Return the hubs (n, 3) m from the centre of mass."""
    return np.array([rotor.position for rotor in vehicle.rotors]).reshape(-1, 3)


def levers(vehicle) -> np.ndarray:
    """Return the torques (3, n) N m about the body's axes of one newton of thrust of each rotor."""
    places = hubs(vehicle)
    spins = np.array([rotor.spin for rotor in vehicle.rotors])
    return np.stack([places[:, 1], -places[:, 0], -vehicle.torque_coefficient / vehicle.thrust_coefficient * spins])


def signs(vehicle) -> Iterator[str]:
    """Yield the quantities that must be positive and are not."""
    for name in ("rotor_radius", "torque_coefficient", "hull_radius", "hull_height"):
        if not getattr(vehicle, name) > 0:
            yield f"'{name}' must be positive"


def _count(vehicle) -> Iterator[str]:
    if len(vehicle.rotors) < 4:
        yield f"{len(vehicle.rotors)} rotors cannot control thrust and three axes; list four or more under 'rotors'"


def _discs(vehicle) -> Iterator[str]:
    places, radius = hubs(vehicle), vehicle.rotor_radius
    for j in range(len(places)):
        for i in range(j):
            across, height = np.linalg.norm(places[i, :2] - places[j, :2]), abs(places[i, 2] - places[j, 2])
            if height > ONE_PLANE * radius or across > TOUCHING * 2.0 * radius:
                continue
            if across < SAME_M:
                yield f"rotors {i + 1} and {j + 1} are at one place; give each 'position' of its own"
            else:
                yield (
                    f"the propellers of rotors {i + 1} and {j + 1} strike each other: their hubs are {across:.3g} m "
                    f"apart, and 'rotor_radius' is {radius:g} m; give the radius in m, not the diameter"
                )
            return


def _tips(vehicle) -> Iterator[str]:
    tip_m_s = vehicle.rotor_speed_range[1] * vehicle.rotor_radius
    if tip_m_s > TIP_SPEED_M_S and not any(_discs(vehicle)):
        yield (
            f"at 'rotor_speed_range' the tips of the propellers move at {tip_m_s:.0f} m/s, faster than sound; give "
            "rad/s, not rpm, and 'rotor_radius' in m"
        )


def _merit(vehicle) -> float:
    """Return the figure of merit: ideal power of a hovering rotor by momentum theory over its power."""
    ideal = vehicle.thrust_coefficient**1.5 / np.sqrt(2.0 * AIR_DENSITY * np.pi * vehicle.rotor_radius**2)
    return float(ideal / vehicle.torque_coefficient)


def _lever_share(vehicle) -> float:
    return vehicle.torque_coefficient / vehicle.thrust_coefficient / vehicle.rotor_radius


def _blades(vehicle) -> Iterator[str]:
    if _merit(vehicle) > 1.0:
        yield (
            f"the rotors would need 1/{_merit(vehicle):.2g} of the least power by momentum theory: "
            f"'torque_coefficient' {vehicle.torque_coefficient:g} is too small beside 'thrust_coefficient' "
            f"{vehicle.thrust_coefficient:g} and 'rotor_radius' {vehicle.rotor_radius:g} m; measure the torque in N m"
        )
    elif _lever_share(vehicle) > MAX_LEVER_SHARE:
        yield (
            f"'torque_coefficient' over 'thrust_coefficient' is {_lever_share(vehicle):.2g} of 'rotor_radius': the "
            "blades would have more drag than lift; real propellers have 0.1 to 0.3"
        )


def _lift(vehicle) -> Iterator[str]:
    if vehicle.thrust_to_weight > MAX_THRUST_TO_WEIGHT:
        yield (
            f"thrust is {vehicle.thrust_to_weight:.0f} times the weight, of the best racers 15; give 'mass' in kg, "
            "'rotor_speed_range' in rad/s and 'thrust_coefficient' in N/(rad/s)^2"
        )
    if vehicle.motor_speed(1.0) > MAX_OVERSPEED * vehicle.rotor_speed_range[1]:
        return  # another unit, which has a sentence
    if any(_falling_map(vehicle)):
        return
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


def _spins(vehicle) -> Iterator[str]:
    spins = [rotor.spin for rotor in vehicle.rotors]
    if len(set(spins)) == 1 and len(spins) > 1:
        yield "all rotors turn in one direction, so the vehicle spins by itself; give half of them the other 'spin'"
    elif len(spins) >= 4 and not _hovers(vehicle, hubs(vehicle), 0.0):
        yield (
            "no rotor speeds within 'rotor_speed_range' hold this vehicle level and still; check positions and spins "
            "of the rotors, their order, and the thrust coefficient"
        )
    elif len(spins) >= 4:
        for term, offset, load in _loads(vehicle):
            if not _hovers(vehicle, hubs(vehicle) - offset, load):
                yield (
                    f"with 'terms.{term}' no rotor speeds hold this vehicle level and still: its centre of mass is "
                    f"{np.linalg.norm(offset):.2g} m from that of the file; give m, and kg"
                )


def _loads(vehicle) -> Iterator[tuple[str, np.ndarray, float]]:
    """Yield the terms that move the centre of mass: name, its move (3,) m, and the mass that is added, kg."""
    for term in ("com_offset", "payload"):
        entry = vehicle.terms.get(term)
        position = entry.get("position", (0.0, 0.0, 0.0)) if isinstance(entry, dict) else None
        load = entry.get("mass", 0.0) if isinstance(entry, dict) else 0.0
        if _is_vector(position) and isinstance(load, int | float) and load > -vehicle.mass:
            share = load / (vehicle.mass + load) if term == "payload" else 1.0
            yield term, share * np.array(position, dtype=float), load if term == "payload" else 0.0


def _is_vector(value) -> bool:
    return isinstance(value, list | tuple) and len(value) == 3 and all(isinstance(v, int | float) for v in value)


def _hovers(vehicle, places, load: float) -> bool:
    """Return whether steady speeds hover: the least-norm thrusts without a torque lie in the range.

    Args:
        vehicle: the vehicle.
        places: hubs (n, 3) m from the centre of mass.
        load: additional mass, kg.
    """
    lever = vehicle.torque_coefficient / vehicle.thrust_coefficient
    spins = np.array([rotor.spin for rotor in vehicle.rotors])
    effect = np.stack([np.ones(len(spins)), places[:, 1], -places[:, 0], -lever * spins])
    weight = vehicle.max_thrust / vehicle.thrust_to_weight * (1.0 + load / vehicle.mass)
    wanted = np.array([weight, 0.0, 0.0, 0.0])
    thrust = np.linalg.pinv(effect) @ wanted
    low, high = (vehicle.thrust_coefficient * speed**2 for speed in vehicle.rotor_speed_range)
    return bool(
        np.allclose(effect @ thrust, wanted, atol=1e-6 * wanted[0]) and np.all((thrust > low) & (thrust < high))
    )


def _motor_order(vehicle) -> Iterator[str]:
    """Compare the torques of the motors with those that Betaflight's mixer expects of them."""
    if vehicle.controller.get("type") != "betaflight" or len(vehicle.rotors) != 4:
        return
    places = hubs(vehicle)
    spins = np.array([rotor.spin for rotor in vehicle.rotors])
    if abs(spins.sum()) == 4:
        return  # has a sentence already
    reversed_yaw = -1.0 if vehicle.controller.get("yaw_motors_reversed") else 1.0
    centred = places - places.mean(axis=0)
    torques = np.stack([np.sign(centred[:, 1]), -np.sign(centred[:, 0]), -reversed_yaw * spins])
    response = AXES[:, None] * torques @ MIX.T / 4.0  # rows: torque about an axis, columns: demand
    if np.allclose(response, np.eye(3), atol=0.01):
        return
    if np.allclose(response[:2, :2], np.eye(2), atol=0.01):
        wanted = ", ".join(f"{spin:g}" for spin in reversed_yaw * MIX[2])
        if np.allclose(response[2], [0.0, 0.0, -1.0], atol=0.01):
            yield (
                "the propellers turn against the firmware's yaw, so the vehicle would spin faster and faster; change "
                f"each 'spin', to {wanted}, or 'yaw_motors_reversed'"
            )
        else:
            yield (
                "the propellers of one diagonal do not turn alike, so yaw and tilt need the same motors; give the "
                f"rotors the spins {wanted} in their order"
            )
        return
    found = [f"{'rear' if x < 0 else 'front'} {'right' if y < 0 else 'left'}" for x, y, _ in centred]
    yield (
        f"the rotors are listed as {', '.join(found)}, but Betaflight's motors are {', '.join(MOTORS)}: the vehicle "
        "would tumble; list them in that order"
    )


def _motor(vehicle) -> Iterator[str]:
    for name in ("time_constant_up", "time_constant_down"):
        if getattr(vehicle.motor, name) > MAX_TIME_CONSTANT_S:
            yield f"'motor.{name}' is {getattr(vehicle.motor, name):g} s, and motors need 0.02 to 0.1 s; give s, not ms"
            return
        if getattr(vehicle.motor, name) < MIN_TIME_CONSTANT_S:
            yield f"'motor.{name}' is {getattr(vehicle.motor, name):g} s, and motors need 0.02 to 0.1 s; give s"
            return
    full, highest = vehicle.motor_speed(1.0), vehicle.rotor_speed_range[1]
    if vehicle.full_speed < vehicle.hover_speed:
        yield (
            f"at full throttle the rotors reach {vehicle.full_speed:.0f} rad/s, below the {vehicle.hover_speed:.0f} of "
            "hover; check 'motor.map.coefficients' and 'battery.reference_voltage'"
        )
    elif full > MAX_OVERSPEED * highest:
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


def _odd_thrust(vehicle) -> Iterator[str]:
    if vehicle.thrust_to_weight > HIGH_THRUST_TO_WEIGHT:
        yield f"thrust is {vehicle.thrust_to_weight:.0f} times the weight; check 'mass' in kg and 'thrust_coefficient'"
    elif vehicle.thrust_to_weight < LOW_THRUST_TO_WEIGHT:
        yield f"thrust is only {vehicle.thrust_to_weight:.2f} times the weight; little is left for control"
    if not LEVER_SHARE[0] <= _lever_share(vehicle) <= LEVER_SHARE[1]:
        share = _lever_share(vehicle)
        yield f"drag torque over thrust is {share:.2g} of the rotor's radius; propellers have 0.1 to 0.3"


def _odd_motor(vehicle) -> Iterator[str]:
    slowest = max(vehicle.motor.time_constant_up, vehicle.motor.time_constant_down)
    if slowest > LONG_TIME_CONSTANT_S:
        yield f"a time constant of the motors is {slowest:g} s; give s, not ms"
    full, highest = vehicle.motor_speed(1.0), vehicle.rotor_speed_range[1]
    if full > HIGH_OVERSPEED * highest:
        yield f"at full throttle the motor map gives {full:.0f} rad/s, beyond 'rotor_speed_range', {highest:.0f} rad/s"


IMPOSSIBLE: tuple[Check, ...] = (
    _count,
    _discs,
    _tips,
    _blades,
    _lift,
    _spins,
    _motor_order,
    _motor,
    _falling_map,
    _spinning,
)
ODD: tuple[Check, ...] = (_odd_thrust, _odd_motor, _odd_spinning)

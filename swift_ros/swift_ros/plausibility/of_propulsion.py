"""Whether rotors and propellers of a vehicle file lift and control it. No ROS."""

from collections.abc import Iterator

import numpy as np

from swift_ros.plausibility.finding import Check, unless

MOTORS = ("rear right", "front right", "rear left", "front left")  # Betaflight's order
# Roll, pitch and yaw demands of each motor of Betaflight's quad X (mixer.c), and the axes of the body about which they
# turn it: forward, left, and down, because its yaw is positive to the right.
MIX = np.array([[-1.0, -1.0, 1.0, 1.0], [1.0, -1.0, 1.0, -1.0], [-1.0, 1.0, 1.0, -1.0]])
AXES = np.array([1.0, 1.0, -1.0])
AIR_DENSITY = 1.225  # kg/m^3 at sea level and 15 deg C (ISO 2533)
TIP_SPEED_M_S = 340.0  # of sound
# Drag torque over thrust, of the rotor's radius; real propellers have 0.1 to 0.3. Above 1, drag exceeds lift.
LEVER_SHARE, MAX_LEVER_SHARE = (0.02, 0.5), 1.0
PER_RPM = np.pi / 30.0  # rad/s
MAX_THRUST_TO_WEIGHT, HIGH_THRUST_TO_WEIGHT, LOW_THRUST_TO_WEIGHT = 40.0, 25.0, 1.3  # the best racers reach 15
SAME_M = 0.005  # between two hubs at one place
ONE_PLANE, TOUCHING = 0.05, 0.98  # height between two discs over the radius; distance of their hubs over the diameter


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


def _struck(vehicle) -> tuple[int, int, float] | None:
    """Return the first two rotors, from 1, whose discs meet, and the distance of their hubs, m; None without such."""
    places, radius = hubs(vehicle), vehicle.rotor_radius
    for j in range(len(places)):
        for i in range(j):
            across, height = np.linalg.norm(places[i, :2] - places[j, :2]), abs(places[i, 2] - places[j, 2])
            if height <= ONE_PLANE * radius and across <= TOUCHING * 2.0 * radius:
                return i + 1, j + 1, float(across)
    return None


def _places(vehicle) -> Iterator[str]:
    struck = _struck(vehicle)
    if struck and struck[2] < SAME_M:
        yield f"rotors {struck[0]} and {struck[1]} are at one place; give each 'position' of its own"


def _discs(vehicle) -> Iterator[str]:
    struck = _struck(vehicle)
    if struck and struck[2] >= SAME_M:
        yield (
            f"the propellers of rotors {struck[0]} and {struck[1]} strike each other: their hubs are {struck[2]:.3g} m "
            f"apart, and 'rotor_radius' is {vehicle.rotor_radius:g} m; give the radius in m, not the diameter"
        )


def tips(vehicle) -> Iterator[str]:
    """Yield a sentence on tips of propellers that are faster than sound, by another unit."""
    tip_m_s = vehicle.rotor_speed_range[1] * vehicle.rotor_radius
    if tip_m_s > TIP_SPEED_M_S and not _struck(vehicle):
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
            f"the rotors would lift with {1.0 / _merit(vehicle):.0%} of the power of ideal ones: 'rotor_radius' "
            f"{vehicle.rotor_radius:g} m or 'torque_coefficient' {vehicle.torque_coefficient:g} is too small, or "
            f"'thrust_coefficient' {vehicle.thrust_coefficient:g} too large; give the radius in m, and measure thrust "
            "and torque"
        )
    elif _lever_share(vehicle) > MAX_LEVER_SHARE:
        yield (
            f"'torque_coefficient' over 'thrust_coefficient' is {_lever_share(vehicle):.2g} of 'rotor_radius': the "
            "blades would have more drag than lift; real propellers have 0.1 to 0.3"
        )


def strength(vehicle) -> Iterator[str]:
    """Yield a sentence on more thrust than any vehicle has, by another unit."""
    if vehicle.thrust_to_weight > MAX_THRUST_TO_WEIGHT:
        yield (
            f"thrust is {vehicle.thrust_to_weight:.0f} times the weight, of the best racers 15; give 'mass' in kg, "
            "'rotor_speed_range' in rad/s and 'thrust_coefficient' in N/(rad/s)^2"
        )


def too_heavy(vehicle) -> str:
    """Return the sentence on a vehicle whose thrust is below its weight, with the unit that explains it alone."""
    ratio, thrust = vehicle.thrust_to_weight, vehicle.thrust_coefficient / PER_RPM**2
    units = {
        f"if 'mass' is in g, it is {vehicle.mass / 1e3:g} kg": 1e3 * ratio,
        f"if 'thrust_coefficient' is in N/RPM^2, it is {thrust:.4g} N/(rad/s)^2": ratio / PER_RPM**2,
    }
    likely = [text for text, corrected in units.items() if LOW_THRUST_TO_WEIGHT < corrected < HIGH_THRUST_TO_WEIGHT]
    cure = f"{likely[0]}; " if len(likely) == 1 else ""
    return (
        f"this vehicle cannot hover: 'mass' is {vehicle.mass:g} kg, and its rotors lift {vehicle.mass * ratio:.3g} kg, "
        f"thrust-to-weight is {ratio:.2g}; {cure}give 'mass' in kg, 'rotor_speed_range' in rad/s and "
        "'thrust_coefficient' in N/(rad/s)^2"
    )


def _spins(vehicle) -> Iterator[str]:
    if len({rotor.spin for rotor in vehicle.rotors}) == 1 < len(vehicle.rotors):
        yield "all rotors turn in one direction, so the vehicle spins by itself; give half of them the other 'spin'"


def _aside(vehicle) -> Iterator[str]:
    """Yield a sentence when all rotors are on one side of the centre of mass."""
    ahead, left, _ = hubs(vehicle).T
    sides = {"in front of": ahead > 0, "behind": ahead < 0, "to the left of": left > 0, "to the right of": left < 0}
    found = [side for side, there in sides.items() if len(there) >= 4 and there.all()]
    if found:
        yield (
            f"all rotors are {' and '.join(found)} the centre of mass, so that the vehicle tips over; give each "
            "'position' from the centre of mass, in m"
        )


def _trim(vehicle) -> Iterator[str]:
    spins = [rotor.spin for rotor in vehicle.rotors]
    if len(spins) >= 4 and not _hovers(vehicle, hubs(vehicle), 0.0):
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


def _odd_thrust(vehicle) -> Iterator[str]:
    if vehicle.thrust_to_weight > HIGH_THRUST_TO_WEIGHT:
        yield f"thrust is {vehicle.thrust_to_weight:.0f} times the weight; check 'mass' in kg and 'thrust_coefficient'"
    elif vehicle.thrust_to_weight < LOW_THRUST_TO_WEIGHT:
        yield f"thrust is only {vehicle.thrust_to_weight:.2f} times the weight; little is left for control"
    if not LEVER_SHARE[0] <= _lever_share(vehicle) <= LEVER_SHARE[1]:
        share = _lever_share(vehicle)
        yield f"drag torque over thrust is {share:.2g} of the rotor's radius; propellers have 0.1 to 0.3"


IMPOSSIBLE: tuple[Check, ...] = (
    _count,
    _places,
    _discs,
    tips,
    _blades,
    unless(strength, tips),
    _spins,
    unless(_aside, _places),
    unless(_trim, _places, tips, strength, _spins, _aside),
    unless(_motor_order, _places, _spins),
)
ODD: tuple[Check, ...] = (_odd_thrust,)

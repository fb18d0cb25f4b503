"""Whether the numbers of a vehicle file can belong to a quadrotor that flies. No ROS.

The limits of what is odd are wide: from a palm-sized vehicle of 20 g to one of 20 kg. A finding that is impossible
contradicts mechanics, or no such vehicle could take off, hover or be controlled.
"""

from collections.abc import Iterator

import numpy as np

from swift_ros.plausibility.finding import IMPOSSIBLE, ODD, Finding

MOTORS = ("rear right", "front right", "rear left", "front left")  # Betaflight's order
# Roll, pitch and yaw demands of each motor of Betaflight's quad X (mixer.c), and the axes of the body about which they
# turn it: forward, left, and down, because its yaw is positive to the right.
MIX = np.array([[-1.0, -1.0, 1.0, 1.0], [1.0, -1.0, 1.0, -1.0], [-1.0, 1.0, 1.0, -1.0]])
AXES = np.array([1.0, 1.0, -1.0])
DRAGS = {"rotor_drag": ("k_d",), "linear_drag": ("k",), "body_drag": ("c",)}
CELL_V = (2.5, 4.4)  # of any lithium cell that flies
MAX_THRUST_TO_WEIGHT = 25.0  # the best racers reach 15
MAX_ARM_M, MAX_GYRATION_SHARE, MIN_GYRATION_SHARE = 1.5, 1.5, 0.1
TIP_SPEED_M_S = 340.0  # of sound
LEVER_SHARE = (0.02, 0.5)  # drag torque over thrust, of the rotor's radius; real propellers have 0.1 to 0.3


def findings(vehicle) -> list[Finding]:
    """Return what is impossible or odd about a `swift_ros.vehicle.Vehicle`, the impossible first."""
    impossible = [Finding(IMPOSSIBLE, text) for check in _IMPOSSIBLE for text in check(vehicle)]
    return impossible + [Finding(ODD, text) for check in _ODD for text in check(vehicle)]


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


def _places(vehicle) -> Iterator[str]:
    places = np.array([rotor.position for rotor in vehicle.rotors])
    if len(places) < 4:
        yield f"{len(places)} rotors cannot control thrust and three axes; list four or more under 'rotors'"
        return
    for i in range(len(places)):
        for j in range(i):
            if np.linalg.norm(places[i] - places[j]) < 0.5 * vehicle.rotor_radius:
                yield f"rotors {j + 1} and {i + 1} are at one place; give each 'position' of its own"


def _spins(vehicle) -> Iterator[str]:
    spins = [rotor.spin for rotor in vehicle.rotors]
    if len(set(spins)) == 1 and len(spins) > 1:
        yield "all rotors turn in one direction, so the vehicle spins by itself; give half of them the other 'spin'"
    elif len(spins) >= 4 and not _hover(vehicle):
        yield (
            "no rotor speeds within 'rotor_speed_range' hold this vehicle level and still; check positions and spins "
            "of the rotors, their order, and the thrust coefficient"
        )


def _hover(vehicle) -> bool:
    """Return whether steady speeds hover: the least-norm thrusts without a torque lie in the range."""
    places = np.array([rotor.position for rotor in vehicle.rotors])
    lever = vehicle.torque_coefficient / vehicle.thrust_coefficient
    spins = np.array([rotor.spin for rotor in vehicle.rotors])
    effect = np.stack([np.ones(len(spins)), places[:, 1], -places[:, 0], -lever * spins])
    weight = vehicle.max_thrust / vehicle.thrust_to_weight
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
    places = np.array([rotor.position for rotor in vehicle.rotors])
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
        yield (
            "the propellers turn against the firmware's yaw, so the vehicle would spin faster and faster; change each "
            "'spin', or 'yaw_motors_reversed'"
        )
        return
    found = [f"{'rear' if x < 0 else 'front'} {'right' if y < 0 else 'left'}" for x, y, _ in centred]
    yield (
        f"the rotors are listed as {', '.join(found)}, but Betaflight's motors are {', '.join(MOTORS)}: the vehicle "
        "would tumble; list them in that order"
    )


def _propulsion(vehicle) -> Iterator[str]:
    low, high = vehicle.rotor_speed_range
    if not 0 <= low < high:
        yield "'rotor_speed_range' must rise from its lowest to its highest speed, both 0 or more, in rad/s"
        return
    for name in ("rotor_radius", "thrust_coefficient", "torque_coefficient", "hull_radius", "hull_height"):
        if not getattr(vehicle, name) > 0:
            yield f"'{name}' must be positive"
    tip_m_s = high * vehicle.rotor_radius
    if tip_m_s > TIP_SPEED_M_S:
        yield (
            f"at 'rotor_speed_range' the tips of the propellers move at {tip_m_s:.0f} m/s, faster than sound; give "
            "rad/s, not rpm, and 'rotor_radius' in m"
        )
    if vehicle.full_speed < vehicle.hover_speed:
        yield (
            f"at full throttle the rotors reach {vehicle.full_speed:.0f} rad/s, below the {vehicle.hover_speed:.0f} of "
            "hover; check 'motor.map.coefficients' and 'battery.reference_voltage'"
        )
    if min(vehicle.rates.max) <= 0:
        yield "'rates.max' must be positive, in rad/s"


def _drag(vehicle) -> Iterator[str]:
    for term, keys in DRAGS.items():
        for key in keys:
            value = vehicle.terms.get(term, {}).get(key) if isinstance(vehicle.terms.get(term), dict) else None
            numbers = [v for v in np.ravel(value) if isinstance(v, int | float)] if value is not None else []
            if any(number < 0 for number in numbers):
                yield f"'terms.{term}.{key}' is negative: such a drag would drive the vehicle; give 0 or more"


def _battery(vehicle) -> Iterator[str]:
    battery = vehicle.battery
    for name in ("reference_voltage", "open_circuit_full", "capacity"):
        if not getattr(battery, name) > 0:
            yield f"'battery.{name}' must be positive"
    for name in ("resistance", "rc_resistance", "open_circuit_slope", "avionics_w", "rc2_resistance", "heat_capacity"):
        if getattr(battery, name) < 0:
            yield f"'battery.{name}' must be 0 or more"
    if not 0 < battery.efficiency <= 1:
        yield f"'battery.efficiency' is {battery.efficiency:g}; a motor gives a share of 0 to 1 of its power"
    if battery.open_circuit_slope >= battery.open_circuit_full > 0:
        yield "'battery.open_circuit_slope' leaves an empty pack no voltage; give the drop in V over a whole discharge"
    if battery.cells and not CELL_V[0] <= battery.open_circuit_full / battery.cells <= CELL_V[1]:
        each = battery.open_circuit_full / battery.cells
        yield f"'battery.open_circuit_full' is {each:.2f} V for each of {battery.cells} cells; no lithium cell has that"


def _odd_thrust(vehicle) -> Iterator[str]:
    if vehicle.thrust_to_weight > MAX_THRUST_TO_WEIGHT:
        yield f"thrust is {vehicle.thrust_to_weight:.0f} times the weight; check 'mass' in kg and 'thrust_coefficient'"
    elif vehicle.thrust_to_weight < 1.3:
        yield f"thrust is only {vehicle.thrust_to_weight:.2f} times the weight; little is left for control"
    if vehicle.thrust_coefficient > 0 and vehicle.rotor_radius > 0:
        share = vehicle.torque_coefficient / vehicle.thrust_coefficient / vehicle.rotor_radius
        if not LEVER_SHARE[0] <= share <= LEVER_SHARE[1]:
            yield f"drag torque over thrust is {share:.2g} of the rotor's radius; propellers have 0.1 to 0.3"


def _odd_size(vehicle) -> Iterator[str]:
    places = np.array([rotor.position for rotor in vehicle.rotors])
    arm = float(np.linalg.norm(places[:, :2] - places[:, :2].mean(axis=0), axis=1).max())
    if arm > MAX_ARM_M:
        yield f"a rotor is {arm:.3g} m from the middle; give positions in m"
    elif arm > 0:
        gyration = np.sqrt(np.linalg.eigvalsh(vehicle.inertia_matrix) / vehicle.mass)
        if gyration.max() > MAX_GYRATION_SHARE * arm or gyration.min() < MIN_GYRATION_SHARE * arm:
            yield (
                f"'inertia' and 'mass' give radii of gyration of {gyration.min():.2g} to {gyration.max():.2g} m beside "
                f"arms of {arm:.2g} m; check the units"
            )
    if vehicle.hull_radius < arm:
        yield f"'hull_radius' {vehicle.hull_radius:g} m is smaller than the distance of a rotor's hub, {arm:.2g} m"


def _odd_motor(vehicle) -> Iterator[str]:
    motor = vehicle.motor
    slowest = max(motor.time_constant_up, motor.time_constant_down)
    if slowest > 0.5:
        yield f"a time constant of the motors is {slowest:g} s; give s, not ms"
    if vehicle.battery.cells and vehicle.battery.capacity < 50:
        yield f"'battery.capacity' is {vehicle.battery.capacity:g} A s, enough for seconds; 1 Ah is 3,600 A s"


_IMPOSSIBLE = (_inertia, _propulsion, _places, _spins, _motor_order, _drag, _battery)
_ODD = (_odd_thrust, _odd_size, _odd_motor)

"""Can the channels of a recording be true together? What contradicts itself is told by the mistake that would explain
it: another unit, order or frame than the flight table's. What no mistake explains is refused only where it is beyond
what any noise, delay or calibration does. Pure.
"""

from itertools import permutations, product

import numpy as np
from scipy.ndimage import gaussian_filter1d

from swift_ros import geometry
from swift_ros.recording.flight_table import FlightTable
from swift_ros.vehicle import GRAVITY, Vehicle
from swift_sim_bridge.gap.recording.betaflight_log import AXES

SMOOTH_S = 0.1
FRD = np.array([1.0, -1.0, -1.0])  # forward-right-down, against forward-left-up
DEGREES, RPM, HERTZ = np.pi / 180.0, 2.0 * np.pi / 60.0, 2.0 * np.pi
CLEARER = 4.0  # times by which a mistake must explain the squares better than none does
AGREED = 0.5  # of all squares, that it may leave
UPRIGHT = 0.5  # of gravity, that the mean specific force must hold upwards
THRUST_RANGE = 0.4, 2.5  # times what the accelerometer feels, within which the file's thrust may be off
CARRIED = 0.5  # of gravity, that rotors lift in the air: idling on the ground they may lift 0.2
SELDOM = 0.01  # of the time: too little in the air to go by
APART = 0.1  # of all squares, that axes in another order or of another sign must leave
STRANGE, LIVELY = 0.8, 0.5  # of all squares, that nothing but a mistake leaves where a vehicle turns so fast, rad/s
LATE_S = 0.4  # more than any recording is late: a delay is no mistake
OPPOSED = -0.5  # of what motors and rate loop have in common, that nothing but a mixer the other way round leaves
THOUSAND = 300.0, 3000.0  # times, that tell of a thousandth of a unit: no vehicle file is so far off


def found(table: FlightTable, recording, vehicle: Vehicle) -> str | None:
    """Return in a sentence what contradicts what among the channels of a recording (`check.Recording`), and the mistake
    that would explain it; None where nothing does."""
    tests = _turning, _up, _acceleration, _velocity, _axes, _thrust, _pack, _mixer
    return next(filter(None, (test(recording, vehicle) for test in tests)), None) or _commands(table)


def _turning(recording, _: Vehicle) -> str | None:
    """Compare the pose's turning with the gyro's."""
    if not recording.has("q_world_body", "gyro_body"):
        return None
    gyro, q = recording.gyro_body, recording.q_world_body
    rate, guesses = (
        _rates(recording, q),
        {
            "the gyro speaks of degrees, not radians": (_rates(recording, q), gyro * DEGREES),
            "the gyro's axes are forward-right-down": (_rates(recording, q), gyro * FRD),
            "the quaternion's w stands first, not last": (_rates(recording, q[:, [1, 2, 3, 0]]), gyro),
            "the quaternion turns world into body": (_rates(recording, geometry.quaternion_conjugate(q)), gyro),
        },
    )
    return _explained("attitude and gyro tell of different turns", recording, (rate, gyro), guesses)


def _axes(recording, _: Vehicle) -> str | None:
    """Compare the pose's turning with the gyro's axes in every order and of every sign. Where none makes them agree
    they must have nothing in common, at any delay and in a lively flight: a bad gyro is not refused."""
    if not recording.has("q_world_body", "gyro_body"):
        return None
    rate, gyro = (
        _smooth(recording, one)[recording.good]
        for one in (_rates(recording, recording.q_world_body), recording.gyro_body)
    )
    if not len(rate) or _misfit(rate, gyro) < APART or (as_is := _least_misfit(rate, gyro, recording.dt)) < APART:
        return None
    start = "attitude and gyro tell of different turns"
    guesses = [
        (list(order), np.array(signs)) for order, signs in product(permutations(range(3)), product((1, -1), repeat=3))
    ]
    misfits = [_misfit(rate, gyro[:, order] * signs) for order, signs in guesses]
    if min(misfits) < AGREED and CLEARER * min(misfits) < as_is:
        order, signs = guesses[int(np.argmin(misfits))]
        told = ", ".join(f"{'-' if sign < 0 else ''}w{'xyz'[axis]}" for axis, sign in zip(order, signs, strict=True))
        return f"{start}; they agree if the rates about forward, left and up are {told}"
    if as_is > STRANGE and np.median(np.linalg.norm(rate, axis=1)) > LIVELY:
        return f"{start}; check the axes (forward, left, up) and the unit (rad/s) of the gyro, and the pose's frames"
    return None


def _up(recording, _: Vehicle) -> str | None:
    """Compare the attitude's up with the accelerometer's."""
    if not recording.has("q_world_body", "specific_force_body"):
        return None
    force, q = recording.specific_force_body, recording.q_world_body

    def upwards(q_world_body, force_body):
        return geometry.rotate(q_world_body, force_body)[recording.good].mean(axis=0)

    if not recording.good.any() or upwards(q, force)[2] > UPRIGHT * GRAVITY:
        return None
    guesses = {
        "the quaternion's w stands first, not last": (q[:, [1, 2, 3, 0]], force),
        "the quaternion turns world into body": (geometry.quaternion_conjugate(q), force),
        "the accelerometer speaks of g, not m/s^2": (q, force * GRAVITY),
        "the accelerometer's axes are forward-right-down": (q, force * FRD),
    }
    start = "attitude and accelerometer disagree about up"
    for guess, pair in guesses.items():
        if abs(upwards(*pair)[2] / GRAVITY - 1.0) < UPRIGHT:
            return f"{start}; {guess}"
    told = ", ".join(f"{value:.2g}" for value in upwards(q, force))
    return (
        f"{start}: in the world the mean specific force is {told} m/s^2, not 9.8 upwards; check frames (FLU, z up) "
        "and units"
    )


def _velocity(recording, _: Vehicle) -> str | None:
    """Compare the recorded velocity with the position's."""
    if not recording.velocity_measured or recording.p_world is None:
        return None
    v, moved = recording.v_world, np.gradient(_smooth(recording, recording.p_world), recording.dt, axis=0)
    guesses = {
        "px, py, pz speak of millimetres, or vx, vy, vz of km/s": (moved / 1000.0, v),
        "vx, vy, vz speak of mm/s, or px, py, pz of kilometres": (moved, v / 1000.0),
        "vx, vy, vz speak of km/h": (moved, v / 3.6),
        "the axes of one of them are north-east-down": (moved, v * FRD),
    }
    if recording.q_world_body is not None:
        turned = geometry.rotate(recording.q_world_body, v)
        guesses["the velocity is the body's, not the world's"] = moved, turned
    return _explained("velocity and position tell of different motions", recording, (moved, v), guesses)


def _acceleration(recording, _: Vehicle) -> str | None:
    """Compare the position's acceleration with the accelerometer's."""
    if not recording.has("p_world", "q_world_body", "specific_force_body"):
        return None
    bent = np.gradient(np.gradient(_smooth(recording, recording.p_world), recording.dt, axis=0), recording.dt, axis=0)
    felt = geometry.rotate(recording.q_world_body, recording.specific_force_body) - [0.0, 0.0, GRAVITY]
    guesses = {
        "px, py, pz speak of millimetres": (bent / 1000.0, felt),
        "px, py, pz speak of kilometres": (bent * 1000.0, felt),
        "the world's axes are north-east-down": (bent * FRD, felt),
    }
    return _explained("position and accelerometer tell of different motions", recording, (bent, felt), guesses)


def _thrust(recording, vehicle: Vehicle) -> str | None:
    """Compare the thrust that the file gives these rotor speeds with the accelerometer's, in the air: on the ground
    something else carries."""
    if not recording.has("rotor_speed", "specific_force_body") or not recording.good.any():
        return None
    lift = vehicle.thrust_coefficient * np.sum(recording.rotor_speed**2, axis=1) / vehicle.mass
    rows = recording.good & (lift > CARRIED * GRAVITY)
    if np.count_nonzero(rows) < SELDOM * len(rows):
        rows = recording.good
    told, felt = (float(np.mean(one[rows])) for one in (lift, recording.specific_force_body[:, 2]))
    low, high = THRUST_RANGE
    if felt <= 0 or low < told / felt < high:
        return None
    if recording.rotor_speed_modelled:
        return (
            f"by the vehicle file the motor commands (u_1 ..) push with {told:.3g} m/s^2, and the accelerometer "
            f"feels {felt:.3g}; give the vehicle file of this flight"
        )
    start = f"by the vehicle file the rotors push with {told:.3g} m/s^2, and the accelerometer feels {felt:.3g}"
    for unit, factor in (("rpm", RPM), ("turns a second", HERTZ), ("1,000 rad/s", 1e3), ("1,000 rpm", 1e3 * RPM)):
        if low < told * factor**2 / felt < high:
            return f"{start}; the rotor speeds may be in {unit}, not rad/s"
    return f"{start}; give the vehicle file of this flight, and rotor speeds in rad/s"


def _pack(recording, vehicle: Vehicle) -> str | None:
    """Compare the pack's voltage with the file's, and its power with what the rotors draw by the file."""
    if not recording.has("voltage", "rotor_speed") or not recording.good.any():
        return None
    low, high = THOUSAND
    volts, usual = float(np.median(recording.voltage)), vehicle.battery.reference_voltage
    if low * volts < usual < high * volts:
        return f"vbat is {volts:.3g} V and the file's pack has {usual:.3g}; vbat speaks of kilovolts, not volts"
    if recording.current is None:
        return None
    battery = vehicle.battery
    drawn = vehicle.torque_coefficient * np.sum(recording.rotor_speed**3, axis=1) / battery.efficiency
    told = float(np.mean(drawn[recording.good])) + battery.avionics_w
    given = float(np.mean((recording.voltage * recording.current)[recording.good]))
    for unit, more, less in (("milliamperes", given, told), ("kiloamperes", told, given)):
        if low * less < more < high * less:
            return (
                f"by vbat and ibat the pack gives {given:.3g} W, by the vehicle file the rotors draw {told:.3g}; "
                f"ibat speaks of {unit}, not amperes, or the file's torque_coefficient is another vehicle's"
            )
    return None


def _commands(table: FlightTable) -> str | None:
    """Compare commanded rates with the gyro's."""
    if "omega_command_body" not in table or "gyro_body" not in table:
        return None
    sent, gyro = table["omega_command_body"], table["gyro_body"]
    turned = np.stack([np.interp(sent.t, gyro.t, axis) for axis in gyro.values.T], axis=-1)
    if _misfit(sent.values * DEGREES, turned) * CLEARER < min(_misfit(sent.values, turned), AGREED * CLEARER):
        return "commanded rates and gyro tell of different turns; the commands speak of degrees, not radians"
    return None


def _explained(start: str, recording, told: tuple, guesses: dict) -> str | None:
    """Return the sentence with the mistake that makes two tellings (n, 3) of one motion agree, None where none does
    so clearly."""
    good = recording.good
    if not good.any():
        return None
    as_is = _misfit(*(one[good] for one in told))
    misfits = {guess: _misfit(*(one[good] for one in pair)) for guess, pair in guesses.items()}
    best = min(misfits, key=misfits.get)
    return f"{start}; {best}" if misfits[best] < AGREED and CLEARER * misfits[best] < as_is else None


def _misfit(one, other) -> float:
    """Return the squares between two tellings as a share of all: 0 where they agree, 1 where they have nothing in
    common, 2 where they are opposite."""
    return float(np.sum((one - other) ** 2) / max(np.sum(one**2) + np.sum(other**2), 1e-300))


def _least_misfit(one, other, dt: float) -> float:
    """Return the misfit of two tellings (n, 3) at the delay, up to LATE_S either way, at which they agree best."""
    reach, count = min(round(LATE_S / dt), len(one) - 1), len(one)
    return min(
        _misfit(one[max(k, 0) : count + min(k, 0)], other[max(-k, 0) : count - max(k, 0)])
        for k in range(-reach, reach + 1, max(1, reach // 20))
    )


def _rates(recording, q_world_body) -> np.ndarray:
    """Return body rates (n, 3) rad/s of attitudes (n, 4)."""
    turn = geometry.quaternion_multiply(geometry.quaternion_conjugate(q_world_body[:-2]), q_world_body[2:])
    rate = geometry.rotation_vector_from_quaternion(turn) / (2.0 * recording.dt)
    return np.concatenate([rate[:1], rate, rate[-1:]])


def _smooth(recording, values) -> np.ndarray:
    return gaussian_filter1d(values, SMOOTH_S / recording.dt, axis=0)


def _mixer(recording, _: Vehicle) -> str | None:
    """Compare what the motors of a flight controller's own log show with what the file's rate loop asks of them."""
    if not recording.has("rate_loop"):
        return None
    wrong = [axis for axis, share in zip(AXES, recording.rate_loop.agreement(), strict=True) if share < OPPOSED]
    if not wrong:
        return None
    if wrong == ["yaw"]:
        return "the motors yaw against the rate loop; set yaw_motors_reversed in the vehicle file the other way"
    return (
        f"the motors {' and '.join(wrong)} against the rate loop; give them in Betaflight's order (rear right, "
        "front right, rear left, front left)"
    )

"""Contradictions among the channels of a recording, and the mistake that explains each.

Each test compares two channels that measure the same motion. Where they disagree, the test tries the usual mistakes:
another unit, order of components or frame than the flight table's. A disagreement that no mistake explains is refused
only where it exceeds what noise, delay or calibration can cause.
"""

from itertools import permutations, product

import numpy as np
from scipy.ndimage import gaussian_filter1d

from swift_ros import geometry
from swift_ros.recording.flight_table import FlightTable
from swift_ros.vehicle import GRAVITY, Vehicle
from swift_sim_bridge.gap.recording import rotor_moments
from swift_sim_bridge.gap.recording.betaflight_log import AXES

SMOOTH_S = 0.1  # standard deviation of the Gaussian filter before a position is differentiated
FRD = np.array([1.0, -1.0, -1.0])  # from forward-right-down to forward-left-up, and from north-east-down to z up
DEGREES, RPM, HERTZ = np.pi / 180.0, 2.0 * np.pi / 60.0, 2.0 * np.pi  # rad, rad/s, rad/s
MIN_IMPROVEMENT = 4.0  # factor by which a mistake must reduce the misfit; larger reports fewer mistakes
MAX_MISFIT = 0.5  # misfit that may remain after the mistake is corrected
MIN_UPRIGHT = 0.5  # of gravity: mean specific force along the world's z axis
THRUST_RANGE = 0.4, 2.5  # ratio of modelled to measured thrust that a wrong vehicle parameter can cause
MIN_LIFT_IN_AIR = 0.5  # of the weight: idling rotors on the ground lift 0.2
MIN_SHARE_IN_AIR = 0.01  # of the recording: with less, the thrust is compared over all of it
SIMILAR_AXES = 0.1  # misfit below which the axes are in order
UNRELATED, MIN_RATE = 0.8, 0.5  # misfit of unrelated signals, where the median rate is above this, rad/s
MAX_DELAY_S = 0.4  # s either way at which two signals are compared: a delay is not a contradiction
OPPOSED = -0.5  # correlation of motors and rate loop below which the mixer must be reversed
THOUSAND_RANGE = 300.0, 3000.0  # ratio that indicates a unit of a thousandth: no vehicle file is so wrong


def contradiction(table: FlightTable, recording, vehicle: Vehicle) -> str | None:
    """Return a sentence about the first contradiction among the channels, with the mistake that explains it.

    Args:
        table: the flight.
        recording: the same flight as `recording.Recording`.
        vehicle: the vehicle as its file describes it.

    Returns:
        None where the channels agree.
    """
    motion = _gyro, _accelerometer_direction, _acceleration, _velocity, _gyro_axes
    tests = *motion, _thrust, _battery, _mixer, rotor_moments.contradiction
    return next(filter(None, (test(recording, vehicle) for test in tests)), None) or _commanded_rates(table)


def _gyro(recording, _: Vehicle) -> str | None:
    """Compare the attitude's rate with the gyro."""
    if not recording.has("q_world_body", "gyro_body"):
        return None
    gyro, q, dt = recording.gyro_body, recording.q_world_body, recording.dt
    rate = body_rates(q, dt)
    mistakes = {
        "the gyro is in degrees/s, not rad/s": (rate, gyro * DEGREES),
        "the gyro's axes are forward-right-down": (rate, gyro * FRD),
        "the quaternion has w first, not last": (body_rates(q[:, [1, 2, 3, 0]], dt), gyro),
        "the quaternion rotates world into body vectors": (body_rates(geometry.quaternion_conjugate(q), dt), gyro),
    }
    return _explained("attitude and gyro disagree about the rotation", recording, (rate, gyro), mistakes)


def _gyro_axes(recording, _: Vehicle) -> str | None:
    """Compare the attitude's rate with the gyro's axes in every order and with every sign.

    Where no order fits, the recording is refused only if both are unrelated at any delay while the vehicle rotates: a
    bad gyro is not refused.
    """
    if not recording.has("q_world_body", "gyro_body"):
        return None
    rate, gyro = (
        _smooth(recording, values)[recording.good]
        for values in (body_rates(recording.q_world_body, recording.dt), recording.gyro_body)
    )
    if not len(rate) or _misfit(rate, gyro) < SIMILAR_AXES:
        return None
    as_is = _misfit_at_best_delay(rate, gyro, recording.dt)
    if as_is < SIMILAR_AXES:
        return None
    start = "attitude and gyro disagree about the rotation"
    orders = [
        (list(order), np.array(signs)) for order, signs in product(permutations(range(3)), product((1, -1), repeat=3))
    ]
    misfits = [_misfit(rate, gyro[:, order] * signs) for order, signs in orders]
    if min(misfits) < MAX_MISFIT and MIN_IMPROVEMENT * min(misfits) < as_is:
        order, signs = orders[int(np.argmin(misfits))]
        columns = ", ".join(f"{'-' if sign < 0 else ''}w{'xyz'[axis]}" for axis, sign in zip(order, signs, strict=True))
        return f"{start}; they agree if the rates about forward, left and up are {columns}"
    if as_is > UNRELATED and np.median(np.linalg.norm(rate, axis=1)) > MIN_RATE:
        return f"{start}; check the axes (forward, left, up) and the unit (rad/s) of the gyro, and the pose's frames"
    return None


def _accelerometer_direction(recording, _: Vehicle) -> str | None:
    """Compare the attitude with the direction of the mean specific force: upwards."""
    if not recording.has("q_world_body", "specific_force_body"):
        return None
    force, q = recording.specific_force_body, recording.q_world_body

    def mean_in_world(q_world_body, force_body):
        return geometry.rotate(q_world_body, force_body)[recording.good].mean(axis=0)

    if not recording.good.any() or mean_in_world(q, force)[2] > MIN_UPRIGHT * GRAVITY:
        return None
    mistakes = {
        "the quaternion has w first, not last": (q[:, [1, 2, 3, 0]], force),
        "the quaternion rotates world into body vectors": (geometry.quaternion_conjugate(q), force),
        "the accelerometer is in g, not m/s^2": (q, force * GRAVITY),
        "the accelerometer's axes are forward-right-down": (q, force * FRD),
    }
    start = "attitude and accelerometer disagree about up"
    for mistake, pair in mistakes.items():
        if abs(mean_in_world(*pair)[2] / GRAVITY - 1.0) < MIN_UPRIGHT:
            return f"{start}; {mistake}"
    measured = ", ".join(f"{value:.2g}" for value in mean_in_world(q, force))
    return (
        f"{start}: in the world the mean specific force is {measured} m/s^2, not 9.8 upwards; check frames (FLU, z up) "
        "and units"
    )


def _velocity(recording, _: Vehicle) -> str | None:
    """Compare the recorded velocity with the derivative of the position."""
    if not recording.velocity_measured or recording.p_world is None:
        return None
    v, slope = recording.v_world, np.gradient(_smooth(recording, recording.p_world), recording.dt, axis=0)
    mistakes = {
        "px, py, pz are in millimetres, or vx, vy, vz in km/s": (slope / 1000.0, v),
        "vx, vy, vz are in mm/s, or px, py, pz in kilometres": (slope, v / 1000.0),
        "vx, vy, vz are in km/h": (slope, v / 3.6),
        "the axes of one of them are north-east-down": (slope, v * FRD),
    }
    if recording.q_world_body is not None:
        rotated = geometry.rotate(recording.q_world_body, v)
        mistakes["the velocity is in the body frame, not in the world"] = slope, rotated
    return _explained("velocity and position disagree about the motion", recording, (slope, v), mistakes)


def _acceleration(recording, _: Vehicle) -> str | None:
    """Compare the second derivative of the position with the accelerometer."""
    if not recording.has("p_world", "q_world_body", "specific_force_body"):
        return None
    smooth = _smooth(recording, recording.p_world)
    of_position = np.gradient(np.gradient(smooth, recording.dt, axis=0), recording.dt, axis=0)
    measured = geometry.rotate(recording.q_world_body, recording.specific_force_body) - [0.0, 0.0, GRAVITY]
    mistakes = {
        "px, py, pz are in millimetres": (of_position / 1000.0, measured),
        "px, py, pz are in kilometres": (of_position * 1000.0, measured),
        "the world's axes are north-east-down": (of_position * FRD, measured),
    }
    start = "position and accelerometer disagree about the motion"
    return _explained(start, recording, (of_position, measured), mistakes)


def _thrust(recording, vehicle: Vehicle) -> str | None:
    """Compare the thrust that the file gives for these rotor speeds with the accelerometer, in the air."""
    if not recording.has("rotor_speed", "specific_force_body") or not recording.good.any():
        return None
    lift = vehicle.thrust_coefficient * np.sum(recording.rotor_speed**2, axis=1) / vehicle.mass
    rows = recording.good & (lift > MIN_LIFT_IN_AIR * GRAVITY)
    if np.count_nonzero(rows) < MIN_SHARE_IN_AIR * len(rows):
        rows = recording.good
    modelled, measured = (float(np.mean(values[rows])) for values in (lift, recording.specific_force_body[:, 2]))
    low, high = THRUST_RANGE
    if measured <= 0 or low < modelled / measured < high:
        return None
    if recording.rotor_speed_modelled:
        return (
            f"for the motor commands (u_1 ..) the vehicle file gives a thrust of {modelled:.3g} m/s^2, the "
            f"accelerometer measures {measured:.3g}; give the vehicle file of this flight"
        )
    start = (
        f"for these rotor speeds the vehicle file gives a thrust of {modelled:.3g} m/s^2, the accelerometer measures "
        f"{measured:.3g}"
    )
    units = ("rpm", RPM), ("revolutions per second", HERTZ), ("1,000 rad/s", 1e3), ("1,000 rpm", 1e3 * RPM)
    for unit, factor in units:
        if low < modelled * factor**2 / measured < high:
            return f"{start}; the rotor speeds may be in {unit}, not rad/s"
    return f"{start}; give the vehicle file of this flight, and rotor speeds in rad/s"


def _battery(recording, vehicle: Vehicle) -> str | None:
    """Compare voltage and electrical power with the vehicle file's battery and rotors."""
    if not recording.has("voltage", "rotor_speed") or not recording.good.any():
        return None
    low, high = THOUSAND_RANGE
    volts, reference = float(np.median(recording.voltage)), vehicle.battery.reference_voltage
    if low * volts < reference < high * volts:
        return f"vbat is {volts:.3g} V and the file's pack has {reference:.3g}; vbat is in kilovolts, not volts"
    if recording.current is None:
        return None
    battery = vehicle.battery
    drawn = vehicle.torque_coefficient * np.sum(recording.rotor_speed**3, axis=1) / battery.efficiency
    modelled = float(np.mean(drawn[recording.good])) + battery.avionics_w
    measured = float(np.mean((recording.voltage * recording.current)[recording.good]))
    for unit, more, less in (("milliamperes", measured, modelled), ("kiloamperes", modelled, measured)):
        if low * less < more < high * less:
            return (
                f"vbat and ibat give a power of {measured:.3g} W, the vehicle file {modelled:.3g} for these rotor "
                f"speeds; ibat is in {unit}, not amperes, or the file's torque_coefficient is another vehicle's"
            )
    return None


def _commanded_rates(table: FlightTable) -> str | None:
    """Compare commanded rates with the gyro."""
    if "omega_command_body" not in table or "gyro_body" not in table:
        return None
    sent, gyro = table["omega_command_body"], table["gyro_body"]
    measured = np.stack([np.interp(sent.t, gyro.t, axis) for axis in gyro.values.T], axis=-1)
    in_degrees = _misfit(sent.values * DEGREES, measured)
    if in_degrees * MIN_IMPROVEMENT < min(_misfit(sent.values, measured), MAX_MISFIT * MIN_IMPROVEMENT):
        return "commanded rates and gyro disagree; the commands are in degrees/s, not rad/s"
    return None


def _explained(start: str, recording, as_is: tuple, mistakes: dict) -> str | None:
    """Return a sentence with the mistake whose correction lets two signals agree.

    Args:
        start: the disagreement.
        recording: gives the valid samples.
        as_is: the two signals (n, 3) as recorded.
        mistakes: the two signals (n, 3) with each mistake corrected.

    Returns:
        None where no mistake explains the disagreement.
    """
    good = recording.good
    if not good.any():
        return None
    recorded = _misfit(*(signal[good] for signal in as_is))
    misfits = {mistake: _misfit(*(signal[good] for signal in pair)) for mistake, pair in mistakes.items()}
    best = min(misfits, key=misfits.get)
    clear = misfits[best] < MAX_MISFIT and MIN_IMPROVEMENT * misfits[best] < recorded
    return f"{start}; {best}" if clear else None


def _misfit(first, second) -> float:
    """Return the squared difference over the sum of squares: 0 for equal signals, 1 for unrelated, 2 for opposite."""
    return float(np.sum((first - second) ** 2) / max(np.sum(first**2) + np.sum(second**2), 1e-300))


def _misfit_at_best_delay(first, second, dt: float) -> float:
    """Return the misfit of two signals (n, 3) at the delay, up to MAX_DELAY_S either way, at which they agree best."""
    reach, count = min(round(MAX_DELAY_S / dt), len(first) - 1), len(first)
    return min(
        _misfit(first[max(k, 0) : count + min(k, 0)], second[max(-k, 0) : count - max(k, 0)])
        for k in range(-reach, reach + 1, max(1, reach // 20))
    )


def body_rates(q_world_body, dt: float) -> np.ndarray:
    """Return body rates (n, 3) rad/s of attitudes (n, 4) every dt s, each over two steps."""
    turn = geometry.quaternion_multiply(geometry.quaternion_conjugate(q_world_body[:-2]), q_world_body[2:])
    rate = geometry.rotation_vector_from_quaternion(turn) / (2.0 * dt)
    return np.concatenate([rate[:1], rate, rate[-1:]])


def _smooth(recording, values) -> np.ndarray:
    """Return values (n, k) after a Gaussian filter."""
    return gaussian_filter1d(values, SMOOTH_S / recording.dt, axis=0)


def _mixer(recording, _: Vehicle) -> str | None:
    """Compare the demand that the logged motors show with the demand of the file's rate loop."""
    if not recording.has("rate_loop"):
        return None
    correlations = recording.rate_loop.correlation()
    reversed_axes = [axis for axis, share in zip(AXES, correlations, strict=True) if share < OPPOSED]
    if not reversed_axes:
        return None
    if reversed_axes == ["yaw"]:
        return "the motors yaw against the rate loop; set yaw_motors_reversed in the vehicle file the other way"
    return (
        f"the motors {' and '.join(reversed_axes)} against the rate loop; give them in Betaflight's order (rear right, "
        "front right, rear left, front left)"
    )

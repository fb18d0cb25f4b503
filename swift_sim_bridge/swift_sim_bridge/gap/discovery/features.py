"""Features of the equation search: quantities of physical dimension on which a residual may depend.

They are computed from the recording and the vehicle file. None contains the measurement whose residual it may explain.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from swift_ros import geometry
from swift_sim_bridge import units
from swift_sim_bridge.gap.residuals import physics_replay
from swift_sim_bridge.gap.residuals.channels import AXES, ELECTRICAL_POWER, ROTOR_SPEED, VOLTAGE
from swift_sim_bridge.gap.residuals.filters import apply, averaged, derivative, lagged
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel
from swift_sim_bridge.gap.residuals.sensor_correction import correct
from swift_sim_bridge.gap.residuals.variants import Variants
from swift_sim_bridge.physics.terms.air import AIR_DENSITY

MIN_HEIGHT_RADII = 0.5  # lower bound of the height over ground in rotor radii, as in the simulator's ground effect
RATE, SPECIFIC_FORCE, ANGULAR_ACCELERATION, SPEED = "rad/s", "m/s^2", "rad/s^2", "m/s"  # units
FEATURES_OF_LAYER = {"force": "motion", "moment": "motion", "imu": "motion", "vio": "motion", "command": "command"}


@dataclass(frozen=True)
class Features:
    """Features of one channel.

    Attributes:
        names: (q,) names; a component of a body vector ends with its axis.
        units: (q,) units.
        values: (m, q) values, filtered as the residual.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: np.ndarray


def build_features(residual_model: ResidualModel, variants: Variants) -> list[Features]:
    """Return the features of each channel of a recording, in the order of the channels.

    Modelled quantities are those of the first variant of the vehicle.
    """
    recording = residual_model.recording
    shared = {"": _features(residual_model, _constant_and_time(recording))}
    if recording.has_motion:
        moving = list(_motion(residual_model, variants))
        shared["motion"] = _features(residual_model, [*_constant_and_time(recording), *moving])
    if recording.has("voltage", "rotor_speed"):
        power = _averaged(residual_model, [*_constant_and_time(recording), *_battery(recording)])
        shared[ELECTRICAL_POWER] = power
        shared[VOLTAGE] = replace(power, values=power.values - power.values.mean(axis=0))  # as the residual
    if recording.command_link:
        shared["command"] = _features(residual_model, [*_constant_and_time(recording), *_sent_commands(recording)])
    if recording.rate_loop:
        shared["command"] = _features(residual_model, [*_constant_and_time(recording), *_rate_loop(recording)])
    if recording.motor_record is not None:
        for i, rotor in enumerate(_rotors(recording, variants)):
            shared[f"{ROTOR_SPEED}_{i + 1}"] = _features(residual_model, [*_constant_and_time(recording), *rotor])
    found = []
    for channel in residual_model.channels:
        kind = channel.id if channel.id in shared else FEATURES_OF_LAYER.get(channel.layer, "")
        found.append(shared.get(kind, shared[""]))
    return found


def _averaged(residual_model: ResidualModel, rows) -> Features:
    """Return features from rows of name, unit and values (n,), averaged as the residuals of the battery."""
    names, unit, values = zip(*rows, strict=True)
    smooth = averaged(np.stack(values, axis=-1), residual_model.recording.dt)
    return Features(names, unit, smooth[residual_model.filter.rows])


def _features(residual_model: ResidualModel, rows) -> Features:
    """Return features from rows of name, unit and values (n,), low-passed as the residuals."""
    names, unit, values = zip(*rows, strict=True)
    return Features(names, unit, apply(residual_model.filter.smooth, np.stack(values, axis=-1)))


def _components(name: str, unit: str, values, letters=AXES) -> Iterator:
    """Yield the components of a vector (n, k), with * in the name replaced by their letters."""
    for i, letter in enumerate(letters):
        yield name.replace("*", letter), unit, values[:, i]


def _constant_and_time(recording) -> list:
    t = recording.t - recording.t[0]
    return [("1", "", np.ones_like(t)), ("t", "s", t)]


def _motion(residual_model: ResidualModel, variants: Variants) -> Iterator:
    """Yield velocities, body rates and axes of the world in the body, and with rotor speeds forces and moments."""
    recording = residual_model.recording
    corrected = correct(recording, variants.sensors[0])
    moving, omega = corrected.moving, corrected.gyro_body
    v = geometry.rotate_inverse(moving.q_world_body, moving.v_world)
    speed, lateral = np.linalg.norm(v, axis=1), np.hypot(v[:, 0], v[:, 1])
    yield from _components("v_*", SPEED, v)
    yield from _components("|v| v_*", "m^2/s^2", speed[:, None] * v)
    yield "|v|", SPEED, speed
    yield "v_xy^2", "m^2/s^2", lateral**2
    yield "v_xy v_z", "m^2/s^2", lateral * v[:, 2]
    yield "min(v_z, 0)", SPEED, np.minimum(v[:, 2], 0.0)
    mixed = ((0, 1), (0, 2), (1, 2))
    yield from _components(
        "v_*",
        "m^2/s^2",
        np.stack([v[:, i] * v[:, j] for i, j in mixed], axis=-1),
        [f"{AXES[i]} v_{AXES[j]}" for i, j in mixed],
    )
    yield from _components("omega_*", RATE, omega)
    pairs = [(i, j) for i in range(3) for j in range(i, 3)]
    yield from _components(
        "omega_*",
        "rad^2/s^2",
        np.stack([omega[:, i] * omega[:, j] for i, j in pairs], axis=-1),
        [f"{AXES[i]} omega_{AXES[j]}" for i, j in pairs],
    )
    up = geometry.rotate_inverse(moving.q_world_body, np.broadcast_to([0.0, 0.0, 1.0], v.shape))
    east = geometry.rotate_inverse(moving.q_world_body, np.broadcast_to([1.0, 0.0, 0.0], v.shape))
    north = geometry.rotate_inverse(moving.q_world_body, np.broadcast_to([0.0, 1.0, 0.0], v.shape))
    for name, axes in (("up", up), ("east", east), ("north", north)):
        yield from _components(f"{name}_*", "", axes)
    if recording.has("rotor_speed"):
        yield from _forces(recording, variants, corrected, v)


def _forces(recording, variants: Variants, corrected, v) -> Iterator:
    """Yield products of thrust, rotor speeds and velocities, and the modelled forces and moments.

    Args:
        recording: the recording.
        variants: the vehicle, as first variant.
        corrected: the recording without known sensor errors.
        v: (n, 3) velocity in the body, m/s.
    """
    vehicle = variants.vehicles[0]
    rotor_speed, lift = recording.rotor_speed, vehicle.thrust_coefficient / vehicle.mass
    mean, spin = rotor_speed.mean(axis=1), np.array([rotor.spin for rotor in vehicle.rotors], dtype=float)
    slope = derivative(rotor_speed, recording.dt)
    inputs = physics_replay.MeasuredMotion(
        corrected.moving.p_world,
        corrected.moving.q_world_body,
        corrected.moving.v_world,
        corrected.gyro_body,
        rotor_speed,
        slope,
    )
    force, turn = (part[0] for part in physics_replay.forces(variants.nominal_parameters, inputs))
    thrust = lift * np.sum(rotor_speed**2, axis=1)
    yield "thrust", SPECIFIC_FORCE, thrust
    yield from _components(
        "thrust *", SPECIFIC_FORCE, lift * rotor_speed**2, [f"of rotor {i + 1}" for i in range(rotor_speed.shape[1])]
    )
    yield from _components("Omega v_*", units.product(RATE, SPEED), mean[:, None] * v)
    yield from _components("thrust v_*", "m^2/s^3", thrust[:, None] * v)
    yield from _components("modelled turn *", ANGULAR_ACCELERATION, turn)
    yield from _components("modelled force *", SPECIFIC_FORCE, force[:, :2], "xy")
    bend, t = derivative(force, recording.dt), (recording.t - recording.t[0])[:, None]
    yield from _components("rate of modelled force *", "m/s^3", bend)
    yield from _components("t modelled turn *", RATE, t * turn)  # as of clocks that drift apart
    yield from _components("t rate of modelled force *", SPECIFIC_FORCE, t * bend)
    yield "sum of spin Omega'", ANGULAR_ACCELERATION, slope @ spin
    yield from _components(
        "sum of spin Omega omega_*", "rad^2/s^2", (rotor_speed @ spin)[:, None] * corrected.gyro_body[:, :2], "xy"
    )
    height = np.maximum(corrected.moving.p_world[:, 2], MIN_HEIGHT_RADII * vehicle.rotor_radius)
    yield "thrust (R/4h)^2", SPECIFIC_FORCE, thrust * (0.25 * vehicle.rotor_radius / height) ** 2
    induced = np.sqrt(
        np.maximum(thrust * vehicle.mass, 1e-6)
        / (2 * AIR_DENSITY * np.pi * vehicle.rotor_radius**2 * rotor_speed.shape[1])
    )
    sinking = np.clip(-v[:, 2] / induced, 0.0, 2.0)
    yield "thrust sink (2 - sink)", SPECIFIC_FORCE, thrust * sinking * (2.0 - sinking)


def _battery(recording) -> Iterator:
    """Yield the current, its model and the charge; without a measured current its model alone."""
    cubed = np.sum(recording.rotor_speed**3, axis=1)
    drawn = recording.current if recording.has("current") else cubed
    unit = "A" if recording.has("current") else "rad^3/s^3"
    if recording.has("current"):
        yield "current", unit, drawn
    yield "sum Omega^3", "rad^3/s^3", cubed
    yield "charge", units.product(unit, "s"), np.cumsum(drawn) * recording.dt


def _sent_commands(recording) -> Iterator:
    """Yield the commands that were sent, without delay, and their slopes where every pass of the loop has a row.

    Between slower rows commands are a nuisance; what it leaves of a slope is no lag.
    """
    line = recording.command_link
    at = np.stack([np.interp(recording.t, line.passes.t, column) for column in line.held(0.0).T], axis=-1)
    rates, throttle = at[:, :3], at[:, 3]
    yield from _components("rate sent *", RATE, rates)
    yield from _components("rate sent *^3", "rad^3/s^3", rates**3)
    yield "throttle", "", throttle
    yield "throttle^2", "", throttle**2
    if not line.row_s:
        yield from _components("slope of rate sent *", ANGULAR_ACCELERATION, derivative(rates, recording.dt))
        yield "slope of throttle", "1/s", derivative(at[:, 3:], recording.dt)[:, 0]


def _rate_loop(recording) -> Iterator:
    """Yield the inputs of the rate loop: setpoints, measured rates, their errors, and the throttle."""
    log = recording.rate_loop

    def at(values):
        return np.stack([np.interp(recording.t, log.t, column) for column in values.T], axis=-1)

    setpoint, gyro, throttle = at(log.setpoint_body), at(log.gyro_body), at(log.mixer_throttle[:, None])
    error = setpoint - gyro
    yield from _components("setpoint *", RATE, setpoint)
    yield from _components("slope of setpoint *", ANGULAR_ACCELERATION, derivative(setpoint, recording.dt))
    yield from _components("gyro *", RATE, gyro)
    yield from _components("slope of gyro *", ANGULAR_ACCELERATION, derivative(gyro, recording.dt))
    yield from _components("error *", RATE, error)
    yield from _components("integral of error *", "rad", np.cumsum(error, axis=0) * recording.dt)
    yield from _components("throttle error *", RATE, throttle * error)
    yield from _components("throttle slope of gyro *", ANGULAR_ACCELERATION, throttle * derivative(gyro, recording.dt))
    yield "throttle", "", throttle[:, 0]


def _rotors(recording, variants: Variants) -> Iterator[list]:
    """Yield for each rotor the features of its speed, delayed as by its motor; speeds are modelled, not measured."""
    motor_record, motor = recording.motor_record, variants.vehicles[0].motor
    follows = partial(lagged, dt=recording.dt, time=0.5 * (motor.time_constant_up + motor.time_constant_down))
    speed = physics_replay.rotor_speeds(variants.nominal_parameters, motor_record)[0]
    command = np.concatenate([motor_record.command, motor_record.command[-1:]])
    for i in range(speed.shape[1]):
        u, omega, volts = (
            np.interp(recording.t, motor_record.t, part) for part in (command[:, i], speed[:, i], motor_record.voltage)
        )
        slope = derivative(omega[:, None], recording.dt)[:, 0]
        supply = [("current", "A", recording.current)] if recording.has("current") else []
        rows = [
            ("u", "", u),
            ("sqrt(u)", "", np.sqrt(u)),
            ("U", "V", volts),
            ("U sqrt(u)", "V", volts * np.sqrt(u)),
            ("Omega", RATE, omega),
            ("Omega'", ANGULAR_ACCELERATION, slope),
            ("min(Omega', 0)", ANGULAR_ACCELERATION, np.minimum(slope, 0.0)),
            *supply,
        ]
        yield [(name, unit, follows(values)) for name, unit, values in rows]

"""Residuals of force and moment, and of the inertial sensors against the pose."""

from typing import NamedTuple

import numpy as np

from swift_ros import geometry
from swift_ros.vehicle import GRAVITY
from swift_sim_bridge.gap.recording.recording import Recording
from swift_sim_bridge.gap.residuals import physics_replay
from swift_sim_bridge.gap.residuals.filters import Filter, apply_to_batch, derivative
from swift_sim_bridge.gap.residuals.kinematics import Kinematics
from swift_sim_bridge.gap.residuals.sensor_correction import accelerometer_errors
from swift_sim_bridge.physics.state import Parameters


class Wrench(NamedTuple):
    """What the rotor speeds give for each of b variants, body frame.

    Attributes:
        specific_force: (b, n, 3) m/s^2.
        turn_acceleration: (b, n, 3) rad/s^2.
    """

    specific_force: np.ndarray
    turn_acceleration: np.ndarray


def modelled_wrench(
    recording: Recording, kinematics: Kinematics, parameters: Parameters, rotor_speed: np.ndarray | None
) -> Wrench:
    """Return specific force and angular acceleration that the rotor speeds give b variants of the vehicle.

    Where the rotor speeds are unknown, the measured values take their place; for the angular acceleration also where
    only the rotors' common speed is known.

    Args:
        recording: the recording.
        kinematics: its motion without the errors of the sensors.
        parameters: of b variants.
        rotor_speed: (n, r) rad/s, or (b, n, r) where each variant has its own; None where they are unknown.
    """
    motion = (*kinematics.moving[:3], kinematics.gyro_body)
    return _modelled(recording, motion, parameters, rotor_speed, len(parameters.mass))


def wrench_changes(
    recording: Recording, motions: list[Kinematics], parameters: Parameters, rotor_speed: np.ndarray | None
) -> list[Wrench]:
    """Return what other motions change in the `modelled_wrench` (1, n, 3) of one vehicle.

    Args:
        recording: the recording.
        motions: the motion, and b others; a difference between them is zero where nothing changes.
        parameters: of one vehicle, (1, ...).
        rotor_speed: (n, r) or (1, n, r) rad/s; None where they are unknown.

    Returns:
        The wrench of each of the others minus that of the first motion.
    """
    if rotor_speed is not None:
        rotor_speed = rotor_speed.reshape(rotor_speed.shape[-2:])
    parts = zip(*((*one.moving[:3], one.gyro_body) for one in motions), strict=True)
    wrench = _modelled(recording, tuple(np.stack(part) for part in parts), parameters, rotor_speed, len(motions))
    return [Wrench(*(part[i : i + 1] - part[:1] for part in wrench)) for i in range(1, len(motions))]


def _modelled(recording: Recording, motion, parameters: Parameters, rotor_speed, count: int) -> Wrench:
    """Return the wrench of `count` variants of vehicle or motion: position, attitude, velocity and gyro."""
    gyro = motion[-1]
    if rotor_speed is None:
        force = recording.specific_force_body if recording.has("specific_force_body") else np.zeros_like(gyro)
    else:
        measured = physics_replay.MeasuredMotion(*motion, rotor_speed, derivative(rotor_speed, recording.dt))
        force, turn = physics_replay.forces(parameters, measured)
        if recording.has("single_rotor_speeds"):
            return Wrench(force, turn)
    shape = count, *gyro.shape[-2:]
    return Wrench(np.broadcast_to(force, shape), np.broadcast_to(derivative(gyro, recording.dt), shape))


def wrench_residuals(
    recording: Recording, low: Filter, kinematics: Kinematics, wrench: Wrench, terms: dict
) -> dict[str, np.ndarray]:
    """Return the residuals of force, accelerometer, moment and gyro by group, (1 or b, m, 3).

    The pose takes the place of an IMU that was not recorded.

    Args:
        recording: the recording.
        low: the filter.
        kinematics: its motion without the errors of the sensors.
        wrench: force and angular acceleration of b variants.
        terms: sensor terms.
    """
    found = accelerometer_residuals(recording, low, kinematics, wrench, terms)
    if recording.has("single_rotor_speeds"):
        found["moment"] = kinematics.turn_acceleration - filtered_turn(recording, low, wrench)
    found["gyro"] = kinematics.rate_difference[None]
    return found


def filtered_turn(recording: Recording, low: Filter, wrench: Wrench) -> np.ndarray:
    """Return the angular acceleration (b, m, 3) rad/s^2 of b variants, filtered as the measured one."""
    smooth = low.smooth if recording.gyro_measured else low.smooth_twice  # rates of the attitude are means
    return apply_to_batch(smooth, wrench.turn_acceleration)


def filtered_force(low: Filter, kinematics: Kinematics, wrench: Wrench) -> np.ndarray:
    """Return the specific force (b, m, 3) m/s^2 of b variants, body frame, filtered as that of the pose."""
    return _in_body(_smooth_in_world(wrench.specific_force, low, kinematics), kinematics)


def accelerometer_residuals(
    recording: Recording, low: Filter, kinematics: Kinematics, wrench: Wrench, terms: dict
) -> dict[str, np.ndarray]:
    """Return the residuals that depend on the accelerometer by group, (1 or b, m, 3) m/s^2.

    `force` is the measured minus the modelled specific force, `accelerometer` the pose's minus the measured one.
    Without an accelerometer, `force` is the pose's minus the modelled one.

    Args:
        recording: the recording.
        low: the filter.
        kinematics: its motion without the errors of the sensors.
        wrench: force and angular acceleration of b variants.
        terms: sensor terms.
    """
    if not recording.has("specific_force_body"):
        return {"force": _pose_minus(wrench.specific_force, low, kinematics)} if recording.has("rotor_speed") else {}
    found = {}
    force, turn = wrench if recording.has("rotor_speed") else (part[:1] for part in wrench)
    true = recording.specific_force_body - accelerometer_errors(terms, kinematics.gyro_body, force, turn)
    if recording.has("rotor_speed"):
        found["force"] = apply_to_batch(low.smooth, true - force)
    return found | {"accelerometer": _pose_minus(true, low, kinematics)}


def _pose_minus(force, low: Filter, kinematics: Kinematics) -> np.ndarray:
    """Return the specific force of the pose minus another one (b, n, 3), low-passed: (b, m, 3) m/s^2, body frame."""
    smooth = _smooth_in_world(force, low, kinematics)
    return _in_body(kinematics.acceleration + [0.0, 0.0, GRAVITY] - smooth, kinematics)


def _smooth_in_world(force, low: Filter, kinematics: Kinematics) -> np.ndarray:
    """Return a specific force (b, n, 3) of the body frame, low-passed as that of the pose: (b, m, 3), world."""
    in_world = geometry.rotate(np.broadcast_to(kinematics.moving.q_world_body, (*force.shape[:-1], 4)), force)
    return apply_to_batch(low.smooth_twice, in_world)


def _in_body(in_world, kinematics: Kinematics) -> np.ndarray:
    """Return vectors (b, m, 3) of the world in the body frame."""
    return geometry.rotate_inverse(np.broadcast_to(kinematics.q_world_body, (*in_world.shape[:-1], 4)), in_world)

"""A controller that tracks a recorded path with any vehicle, whatever controller flew the recording."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from swift_ros import geometry
from swift_ros.vehicle import GRAVITY, Vehicle, motor_command_for_speed
from swift_sim_bridge.gap.recording.rate_pid import rate_pid_from_vehicle
from swift_sim_bridge.physics.rigid_body import apply

# With these gains the damping ratio of position and tilt is 0.78, that of yaw 0.82.
POSITION_GAIN, VELOCITY_GAIN = 5.0, 3.5  # 1/s^2 and 1/s
ATTITUDE_GAIN = np.array([9.0, 9.0, 3.0])  # 1/s, lower in yaw, where rotors have little torque
RATE_GAIN = np.array([22.0, 22.0, 8.0])  # 1/s, where the vehicle file has none
MIN_COLLECTIVE = 0.1  # of the weight: keeps the rotors turning, which control the attitude
MIN_COMMAND = 0.02  # lowest motor command


class Setpoint(NamedTuple):
    """What b vehicles track at one time.

    Attributes:
        p_world: (b, 3) m.
        v_world: (b, 3) m/s.
        a_world: (b, 3) m/s^2.
        q_world_body: (b, 4) attitude of the recording, which gives the heading.
        omega_body: (b, 3) rad/s, added to the rates of the attitude control.
        gyro_noise: (b, 3) rad/s, noise of the gyro that the rate loop reads.
    """

    p_world: jax.Array
    v_world: jax.Array
    a_world: jax.Array
    q_world_body: jax.Array
    omega_body: jax.Array
    gyro_noise: jax.Array


class Controller(NamedTuple):
    """Parameters of the controller.

    Attributes:
        allocation: (r, 4) from collective thrust N and moments N m to the rotors' squared speeds.
        rate_gain: (3,) 1/s.
    """

    allocation: jax.Array
    rate_gain: jax.Array


def controller_for(vehicle: Vehicle, dtype) -> Controller:
    """Return the controller of a vehicle, with the rate gains of its file where it has some."""
    position, spin = (np.array([getattr(rotor, key) for rotor in vehicle.rotors]) for key in ("position", "spin"))
    lift, torque = vehicle.thrust_coefficient, vehicle.torque_coefficient
    effect = np.stack([np.full(len(spin), lift), lift * position[:, 1], -lift * position[:, 0], -torque * spin])
    loop = rate_pid_from_vehicle(vehicle)
    return Controller(jnp.asarray(np.linalg.pinv(effect)), jnp.asarray(RATE_GAIN if loop is None else loop.kp, dtype))


def tracking_command(state, voltage, setpoint: Setpoint, parameters, controller: Controller):
    """Return the motor commands (b, r) that take vehicles along the path.

    Args:
        state: of b vehicles.
        voltage: (b,) V.
        setpoint: what to track.
        parameters: of the vehicles.
        controller: parameters of the controller.
    """
    p, v, a, q, omega, gyro_noise = setpoint
    up = jnp.array([0.0, 0.0, 1.0], p.dtype)
    force = a + POSITION_GAIN * (p - state.p_world) + VELOCITY_GAIN * (v - state.v_world) + GRAVITY * up
    ups = jnp.broadcast_to(up, p.shape)
    force_direction = geometry.normalize(force)
    recorded_direction = geometry.rotate(q, ups)
    axis = geometry.cross(recorded_direction, force_direction)
    cosine = jnp.sum(recorded_direction * force_direction, axis=-1, keepdims=True)
    tilt = geometry.normalize(jnp.concatenate([axis, 1.0 + cosine], axis=-1))
    q_setpoint = geometry.quaternion_multiply(tilt, q)
    q_error = geometry.quaternion_multiply(geometry.quaternion_conjugate(state.q_world_body), q_setpoint)
    q_error = q_error * jnp.where(q_error[..., 3:] < 0, -1.0, 1.0)
    rates = omega + 2.0 * ATTITUDE_GAIN.astype(p.dtype) * q_error[..., :3]
    measured = state.omega_body
    momentum = apply(parameters.inertia, measured)
    rate_error = controller.rate_gain * (rates - measured - gyro_noise)
    moment = apply(parameters.inertia, rate_error) + geometry.cross(measured, momentum)
    collective = parameters.mass * jnp.sum(force * geometry.rotate(state.q_world_body, ups), axis=-1, keepdims=True)
    collective = jnp.maximum(collective, MIN_COLLECTIVE * parameters.mass * GRAVITY)
    squared = apply(controller.allocation, jnp.concatenate([collective, moment], axis=-1))
    low, high = parameters.motors.min_speed, parameters.motors.max_speed
    speed = jnp.sqrt(jnp.clip(squared, low * low, high * high))
    command = motor_command_for_speed(speed, voltage[..., None], parameters.motors.map_coefficients)
    return jnp.clip(command, MIN_COMMAND, 1.0)

"""What spinning rotors do to the body: thrust, reaction torque, and the moments of their inertia (Methods, eqs 2-3)."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp


def thrust_wrench(motion, rotors):
    """Return (force, moment) (..., 3): c_l Omega_i^2 up at each hub, and c_d Omega_i^2 against its spin."""
    squared = motion.rotor_speed * motion.rotor_speed
    thrust = rotors.thrust_coefficient * squared
    x, y = rotors.position[..., 0], rotors.position[..., 1]
    collective = jnp.sum(thrust, axis=-1)
    moment_x = jnp.sum(y * thrust, axis=-1)
    moment_y = -jnp.sum(x * thrust, axis=-1)
    moment_z = -jnp.sum(rotors.spin * rotors.torque_coefficient * squared, axis=-1)
    zero = jnp.zeros_like(collective)
    return jnp.stack([zero, zero, collective], axis=-1), jnp.stack([moment_x, moment_y, moment_z], axis=-1)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RotorGyroscopic:
    """inertia: kg m^2 of one rotor with its propeller about its axis (J_{m+p} of the Methods)."""

    inertia: float


def gyroscopic(motion, coefficients, parameters):
    """Return the wrench of the rotors' angular momentum h: spin-up torque -dh/dt and gyroscopic moment -omega x h."""
    spin_inertia = coefficients.inertia[..., None] * parameters.rotors.spin
    h = jnp.sum(spin_inertia * motion.rotor_speed, axis=-1)
    h_rate = jnp.sum(spin_inertia * motion.rotor_acceleration, axis=-1)
    omega = motion.omega_body
    moment = jnp.stack([-omega[..., 1] * h, omega[..., 0] * h, -h_rate], axis=-1)
    return jnp.zeros_like(moment), moment

"""What spinning rotors do to the body: thrust, reaction torque, and the moments of their inertia (Methods, eqs 2-3)."""

from dataclasses import dataclass

import jax

from swift_sim_bridge.physics.terms.motion import along_z
from swift_sim_bridge.physics.terms.vectors import ZERO, Vector, parts, scale, total


def thrust_forces(instant):
    """Return the thrusts c_l Omega_i^2 up at each hub, n Vectors."""
    return along_z(instant.thrust)


def reaction(instant):
    """Return the moment of the rotors' drag torques: c_d Omega_i^2 each, against its spin."""
    hubs = instant.hubs
    torques = zip(hubs.spin, hubs.torque_coefficient, instant.squared_speed, strict=True)
    return Vector(z=-total(spin * c * squared for spin, c, squared in torques))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RotorGyroscopic:
    """inertia: kg m^2 of one rotor with its propeller about its axis (J_{m+p} of the Methods), about 1e-5."""

    inertia: float


def gyroscopic(instant, coefficients, parameters):
    """Return the wrench of the rotors' angular momentum h: spin-up torque -dh/dt and gyroscopic moment -omega x h."""
    inertia = [coefficients.inertia * spin for spin in instant.hubs.spin]
    h = total(one * speed for one, speed in zip(inertia, instant.rotor_speed, strict=True))
    h_rate = total(one * rate for one, rate in zip(inertia, instant.rotor_acceleration, strict=True))
    omega = instant.omega_body
    return ZERO, Vector(-omega.y * h, omega.x * h, -h_rate)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ThrustAxisTilt:
    """tilt: (2,) rad of the rotors' axes about the body's x and y axes, 0.005..0.035 (0.3..2 deg)."""

    tilt: tuple[float, float]


def thrust_axis_tilt(instant, coefficients):
    """Return forces T_i (e_y, -e_x, 0) at the hubs: the thrust's part across the body's z axis, for small tilts e."""
    e_x, e_y = parts(coefficients.tilt)
    return tuple(scale(thrust, Vector(e_y, -e_x)) for thrust in instant.thrust)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RotorGain:
    """gain: (n,) share by which each motor's steady speed is off, -0.05..0.05."""

    gain: tuple[float, ...]


def rotor_gain(coefficients, remembered, count):
    """Return the factors 1 + gain_i of the motors' steady speeds."""
    return tuple(1.0 + gain for gain in parts(coefficients.gain))


def one_gain_a_rotor(coefficients, vehicle):
    """Raise ValueError when there is not one gain for each rotor."""
    if len(coefficients.gain) != len(vehicle.rotors):
        raise ValueError(f"must have {len(vehicle.rotors)} entries in 'gain', one a rotor")


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class MotorHeat:
    """speed_loss: 1/K, share of the steady speed lost a kelvin, 0..5e-4; warming: K a watt of the vehicle's electrical
    power once settled, about 0.1; time_constant: s, 20..100."""

    speed_loss: float
    warming: float = 0.1
    time_constant: float = 40.0


def cool_motors(coefficients, zero, normal, count):
    """Return motors as warm as the air."""
    return {"warmth": zero}


def warm_motors(remembered, passed, coefficients, parameters):
    """Return the motors' warmth (K above the air) after a step: a first-order lag behind the power."""
    share = passed.dt / coefficients.time_constant
    target = coefficients.warming * passed.power_w
    return {"warmth": remembered["warmth"] + share * (target - remembered["warmth"])}


def motor_heat(coefficients, remembered, count):
    """Return the factors 1 - speed_loss warmth of the steady speeds: hot windings resist, hot magnets weaken."""
    return (1.0 - coefficients.speed_loss * remembered["warmth"],) * count if remembered else (1.0,) * count

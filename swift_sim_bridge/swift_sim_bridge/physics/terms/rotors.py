"""Thrust, reaction torque and gyroscopic moments of the rotors (Methods, eqs 2-3), and errors of their speeds."""

from dataclasses import dataclass

import jax

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.effects import (
    FORCE_CHANNELS,
    MASS_AND_THRUST_RANGE,
    MIN_THRUST_TO_WEIGHT,
    MOMENT_CHANNELS,
    MOTOR_CHANNELS,
    Effect,
    Parameter,
    scalar_parameter,
    vector_parameters,
)
from swift_sim_bridge.physics.terms.motion import along_z
from swift_sim_bridge.physics.terms.term import Term
from swift_sim_bridge.physics.terms.vectors import ZERO, Vector, parts, scale, total


def thrust_forces(instant):
    """Return the thrusts c_l Omega_i^2 along the body's z axis at each hub, n Vectors."""
    return along_z(instant.thrust)


def reaction(instant):
    """Return the moment of the rotors' drag torques: c_d Omega_i^2 each, opposite to its spin."""
    hubs = instant.hubs
    torques = zip(hubs.spin, hubs.torque_coefficient, instant.squared_speed, strict=True)
    return Vector(z=-total(spin * c * squared for spin, c, squared in torques))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RotorGyroscopic:
    """Angular momentum of the rotors.

    Attributes:
        inertia: kg m^2 of one rotor with its propeller about its axis (J_{m+p} of the Methods), about 1e-5.
    """

    inertia: float


def gyroscopic(instant, coefficients, parameters):
    """Return the wrench of the rotors' angular momentum h: spin-up torque -dh/dt and gyroscopic moment -omega x h."""
    inertia = [coefficients.inertia * spin for spin in instant.hubs.spin]
    h = total(signed * speed for signed, speed in zip(inertia, instant.rotor_speed, strict=True))
    h_rate = total(signed * rate for signed, rate in zip(inertia, instant.rotor_acceleration, strict=True))
    omega = instant.omega_body
    return ZERO, Vector(-omega.y * h, omega.x * h, -h_rate)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ThrustAxisTilt:
    """Misalignment of the rotors' axes.

    Attributes:
        tilt: (2,) rad about the body's x and y axes, 0.005 to 0.035 (0.3 to 2 deg).
    """

    tilt: tuple[float, float]


def thrust_axis_tilt(instant, coefficients):
    """Return forces T_i (e_y, -e_x, 0) at the hubs: the lateral part of the thrust, for small tilts e."""
    e_x, e_y = parts(coefficients.tilt)
    return tuple(scale(thrust, Vector(e_y, -e_x)) for thrust in instant.thrust)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RotorGain:
    """Relative error of each motor's steady speed.

    Attributes:
        gain: (n,), -0.05 to 0.05.
    """

    gain: tuple[float, ...]


def rotor_gain(coefficients, memory, count):
    """Return the factors 1 + gain_i of the motors' steady speeds."""
    return tuple(1.0 + gain for gain in parts(coefficients.gain))


def has_gain_for_each_rotor(coefficients, vehicle):
    """Raise ValueError when there is not one gain for each rotor."""
    if len(coefficients.gain) != len(vehicle.rotors):
        raise ValueError(f"must have {len(vehicle.rotors)} entries in 'gain', one a rotor")


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class MotorHeat:
    """Loss of speed by warm motors.

    Attributes:
        speed_loss: 1/K, share of the steady speed lost for each kelvin, 0 to 5e-4.
        warming: K/W, steady temperature rise for each watt of the vehicle's electrical power, about 0.1.
        time_constant: s, 20 to 100.
    """

    speed_loss: float
    warming: float = 0.1
    time_constant: float = 40.0


def cool_motors(coefficients, zero, normal, count):
    """Return motors at the temperature of the air."""
    return {"warmth": zero}


def warm_motors(memory, step, coefficients, parameters):
    """Return the motors' temperature (K above the air) after a step: a first-order lag behind the power."""
    share = step.dt / coefficients.time_constant
    target = coefficients.warming * step.power_w
    return {"warmth": memory["warmth"] + share * (target - memory["warmth"])}


def motor_heat(coefficients, memory, count):
    """Return the factors 1 - speed_loss warmth of the steady speeds: warm windings and magnets lose torque."""
    return (1.0 - coefficients.speed_loss * memory["warmth"],) * count if memory else (1.0,) * count


def coefficient_effects(vehicle: Vehicle) -> tuple[Effect, ...]:
    """Return the effects of the file's thrust and torque coefficients."""
    thrust, torque = vehicle.thrust_coefficient, vehicle.torque_coefficient
    least, most = MASS_AND_THRUST_RANGE
    return (
        Effect(
            id="thrust_coefficient",
            layer="force",
            parameters=(
                Parameter(
                    "thrust_coefficient",
                    "N s^2/rad^2",
                    ("thrust_coefficient",),
                    step=0.005 * thrust,
                    low=max(least, MIN_THRUST_TO_WEIGHT / vehicle.thrust_to_weight) * thrust,
                    high=most * thrust,
                ),
            ),
            equation="T = c_l Omega^2",
            sentence="each rotor gives {thrust_coefficient:.4g} Omega^2 N of thrust",
            manoeuvre="roll and pitch doublets at several thrusts",
            channels=FORCE_CHANNELS,
        ),
        Effect(
            id="torque_coefficient",
            layer="moment",
            parameters=(
                Parameter(
                    "torque_coefficient",
                    "N m s^2/rad^2",
                    ("torque_coefficient",),
                    step=0.01 * torque,
                    low=0.3 * torque,
                    high=3.0 * torque,
                ),
            ),
            equation="tau_z = -sum s_i c_d Omega_i^2",
            sentence="the rotors' drag torque is {torque_coefficient:.4g} Omega^2 N m",
            manoeuvre="yaw steps at constant thrust",
            channels=MOMENT_CHANNELS,
        ),
    )


def gain_effects(vehicle: Vehicle, gates: int) -> tuple[Effect, ...]:
    """Return the effect of speed errors of the motors, one gain for each."""
    count = len(vehicle.rotors)
    return (
        Effect(
            id="rotor_gain",
            layer="motor",
            parameters=vector_parameters("gain", "", "rotor_gain", step=0.002, bounds=(-0.3, 0.3), count=count),
            equation="Omega_ss,i (1 + gain_i)",
            sentence="the motors' speeds are off by {values} (shares)",
            manoeuvre="hover and throttle punches",
            channels=MOTOR_CHANNELS,
            idle={"rotor_gain": {"gain": [0.0] * count}},
        ),
    )


TERMS = {
    "thrust_axis_tilt": Term(
        ThrustAxisTilt,
        hubs=thrust_axis_tilt,
        idle={"tilt": [0.0, 0.0]},
        example={"tilt": [0.02, -0.01]},
        effects=(
            Effect(
                id="thrust_axis_tilt",
                layer="force",
                parameters=vector_parameters("tilt", "rad", "thrust_axis_tilt", step=1e-3, bounds=(-0.2, 0.2), count=2),
                equation="F += T (e_y, -e_x, 0)",
                sentence="the rotors' axes are tilted by {values} rad",
                manoeuvre="throttle punches, level",
                channels=FORCE_CHANNELS,
            ),
        ),
    ),
    "rotor_gyroscopic": Term(
        RotorGyroscopic,
        wrench=gyroscopic,
        idle={"inertia": 0.0},
        example={"inertia": 1e-5},
        effects=(
            Effect(
                id="rotor_gyroscopic",
                layer="moment",
                parameters=(scalar_parameter("inertia", "kg m^2", "rotor_gyroscopic", step=5e-7, low=0.0, high=1e-3),),
                equation="tau = -dh/dt - omega x h, h = J_p sum s_i Omega_i e_z",
                sentence="each rotor has an inertia of {inertia:.3g} kg m^2",
                manoeuvre="fast rolls and pitches during yaw turns",
                channels=MOMENT_CHANNELS,
            ),
        ),
    ),
    "rotor_gain": Term(
        RotorGain,
        motor=rotor_gain,
        check=has_gain_for_each_rotor,
        idle={"gain": [0.0, 0.0, 0.0, 0.0]},
        example={"gain": [0.02, -0.03, 0.04, 0.01]},
        effects=gain_effects,
    ),
    "motor_heat": Term(
        MotorHeat,
        motor=motor_heat,
        start=cool_motors,
        advance=warm_motors,
        idle={"speed_loss": 0.0},
        example={"speed_loss": 4e-4, "warming": 0.2, "time_constant": 20.0},
        units={"speed_loss": "1/K", "warming": "K/W", "time_constant": "s"},
    ),
}

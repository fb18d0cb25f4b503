"""The pack: open-circuit line, ohmic and RC drop, and the current that the rotors' power draws (Methods, battery)."""

import jax.numpy as jnp


def power(rotor_speed, torque_coefficient, battery):
    """Return the electrical power (...) W of rotors at (..., n) rad/s and of the avionics."""
    mechanical = jnp.sum(torque_coefficient * rotor_speed * rotor_speed * rotor_speed, axis=-1)
    return mechanical / battery.efficiency + battery.avionics_w


def voltage_and_current(power_w, charge, rc_voltage, battery):
    """Return (U (...) V, I (...) A) under a load of `power_w`.

    U = E - R I with I = P/U is the larger root of U^2 - E U + R P = 0; beyond the most that the pack can give
    (P > E^2 / 4R) the voltage stays at E/2.
    """
    source = battery.open_circuit_full - battery.open_circuit_slope * charge / battery.capacity - rc_voltage
    discriminant = source * source - 4.0 * battery.resistance * power_w
    voltage = 0.5 * (source + jnp.sqrt(jnp.maximum(discriminant, 0.0)))
    return voltage, power_w / voltage


def discharge(charge, rc_voltage, current, dt, battery):
    """Return (charge, rc_voltage) after `dt` s at a constant current; the RC branch exactly."""
    keep = jnp.exp(-dt / battery.rc_time)
    target = current * battery.rc_resistance
    return charge + current * dt, target + keep * (rc_voltage - target)

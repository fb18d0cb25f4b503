"""The pack: open-circuit line or curve, ohmic and RC drops, the current that the rotors draw (Methods, battery).

    U = E(share used) - R I - U_rc - U_rc2,   I = (sum c_d Omega^3 / efficiency + avionics) / U,
    R = resistance (1 + temperature_slope (T - 25)),   heat_capacity T' = R I^2

A grey box after Bauersfeld and Scaramuzza 2022 ("Range, endurance, and optimal speed estimates for multicopters"). What
a vehicle file does not give is None in `state.Battery` and costs nothing; the second branch's voltage, the energy drawn
and the temperature are remembered beside the state (`start`).
"""

import jax.numpy as jnp

from swift_sim_bridge.physics.terms.vectors import total

REFERENCE_CELSIUS = 25.0


def power(rotor_speed, torque_coefficient, battery):
    """Return the electrical power (...) W of rotors at (..., n) rad/s and of the avionics."""
    mechanical = jnp.sum(torque_coefficient * rotor_speed * rotor_speed * rotor_speed, axis=-1)
    return mechanical / battery.efficiency + battery.avionics_w


def power_of(rotor_speeds, torque_coefficients, battery):
    """Return the same by components, of n rotor speeds and coefficients (...)."""
    mechanical = total(c * speed * speed * speed for c, speed in zip(torque_coefficients, rotor_speeds, strict=True))
    return mechanical / battery.efficiency + battery.avionics_w


def start(battery, zero) -> dict:
    """Return what the pack remembers beside its charge and first branch, at rest: by name, shaped as `zero`."""
    remembered = {}
    if battery.rc2_resistance is not None:
        remembered["rc2_voltage"] = zero
    if battery.energy is not None:
        remembered["energy"] = zero
    if battery.heat_capacity is not None:
        remembered["celsius"] = zero + battery.temperature
    return remembered


def open_circuit(charge, battery, remembered):
    """Return E (...) V after `charge` A s, by the line or by the curve over the share used."""
    if battery.open_circuit_curve is None and battery.energy is None:
        return battery.open_circuit_full - battery.open_circuit_slope * charge / battery.capacity
    used = charge / battery.capacity
    if battery.energy is not None and remembered:
        used = remembered["energy"] / battery.energy
    if battery.open_circuit_curve is None:
        return battery.open_circuit_full - battery.open_circuit_slope * used
    return _along(battery.open_circuit_curve, used)


def _along(curve, share):
    """Return the curve (..., k), given at evenly spaced shares 0..1, at `share` (...), straight between and beyond."""
    last = curve.shape[-1] - 1
    slopes = [last * (curve[..., i + 1] - curve[..., i]) for i in range(last)]
    value = curve[..., 0] + slopes[0] * share
    for i in range(1, last):
        value = value + (slopes[i] - slopes[i - 1]) * jnp.maximum(share - i / last, 0.0)
    return value


def resistance(battery, remembered):
    """Return R (...) ohm at the pack's temperature."""
    if battery.temperature_slope is None:
        return battery.resistance
    celsius = (remembered or {}).get("celsius", battery.temperature)
    return battery.resistance * (1.0 + battery.temperature_slope * (celsius - REFERENCE_CELSIUS))


def voltage_and_current(power_w, charge, rc_voltage, battery, remembered=None):
    """Return (U (...) V, I (...) A) under a load of `power_w`.

    U = E - R I with I = P/U is the larger root of U^2 - E U + R P = 0; beyond the most that the pack can give
    (P > E^2 / 4R) the voltage stays at E/2. Without `remembered` the second branch is at rest.
    """
    source = open_circuit(charge, battery, remembered) - rc_voltage
    if remembered and "rc2_voltage" in remembered:
        source = source - remembered["rc2_voltage"]
    discriminant = source * source - 4.0 * resistance(battery, remembered) * power_w
    voltage = 0.5 * (source + jnp.sqrt(jnp.maximum(discriminant, 0.0)))
    return voltage, power_w / voltage


def discharge(charge, rc_voltage, current, dt, battery):
    """Return (charge, rc_voltage) after `dt` s at a constant current; the RC branch exactly."""
    return charge + current * dt, _relaxed(rc_voltage, current, dt, battery.rc_resistance, battery.rc_time)


def _relaxed(voltage, current, dt, branch_resistance, time):
    target = current * branch_resistance
    return target + jnp.exp(-dt / time) * (voltage - target)


def remember(remembered, power_w, current, dt, battery) -> dict:
    """Return what the pack remembers (see `start`) after `dt` s under a constant load."""
    moved = dict(remembered)
    if "rc2_voltage" in moved:
        moved["rc2_voltage"] = _relaxed(moved["rc2_voltage"], current, dt, battery.rc2_resistance, battery.rc2_time)
    if "energy" in moved:
        moved["energy"] = moved["energy"] + power_w * dt
    if "celsius" in moved:
        heat_w = resistance(battery, remembered) * current * current
        moved["celsius"] = moved["celsius"] + heat_w * dt / battery.heat_capacity
    return moved

"""The battery pack: open-circuit voltage, ohmic and RC drops, and the current of the rotors (Methods, battery).

    U = E(share used) - R I - U_rc - U_rc2,   I = (sum c_d Omega^3 / efficiency + avionics) / U,
    R = resistance (1 + temperature_slope (T - 25)),   heat_capacity T' = R I^2

A grey-box model after Bauersfeld and Scaramuzza 2022 ("Range, endurance, and optimal speed estimates for
multicopters"). A key that the vehicle file lacks is None in `state.Battery` and is not simulated. The voltage of the
second branch, the energy drawn and the temperature are kept in the state's memory (`start`).
"""

import jax.numpy as jnp

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.effects import Effect, Parameter
from swift_sim_bridge.physics.terms.vectors import is_zero, total

REFERENCE_CELSIUS = 25.0  # deg C at which the vehicle file gives the resistance
UNITS = {  # of the keys of the vehicle file's `battery` that flights determine
    "open_circuit_full": "V",
    "open_circuit_slope": "V",
    "resistance": "ohm",
    "rc_resistance": "ohm",
    "rc_time": "s",
    "efficiency": "",
    "avionics_w": "W",
}


def power(rotor_speed, torque_coefficient, battery):
    """Return the electrical power (...) W of rotors at (..., n) rad/s and of the avionics."""
    mechanical = jnp.sum(torque_coefficient * rotor_speed * rotor_speed * rotor_speed, axis=-1)
    return mechanical / battery.efficiency + battery.avionics_w


def power_of(rotor_speeds, torque_coefficients, battery):
    """Return the power by components, of n rotor speeds and coefficients (...)."""
    mechanical = total(c * speed * speed * speed for c, speed in zip(torque_coefficients, rotor_speeds, strict=True))
    return mechanical / battery.efficiency + battery.avionics_w


def start(battery, zero) -> dict:
    """Return the pack's memory beside its charge and first branch, at rest: by name, shaped as `zero`."""
    memory = {}
    if battery.rc2_resistance is not None:
        memory["rc2_voltage"] = zero
    if battery.energy is not None:
        memory["energy"] = zero
    if battery.heat_capacity is not None:
        memory["celsius"] = zero + battery.temperature
    return memory


def open_circuit(charge, battery, memory):
    """Return the open-circuit voltage E (...) V after `charge` A s."""
    if battery.open_circuit_curve is None and battery.energy is None:
        return battery.open_circuit_full - battery.open_circuit_slope * charge / battery.capacity
    used = charge / battery.capacity
    if battery.energy is not None and memory:
        used = memory["energy"] / battery.energy
    if battery.open_circuit_curve is None:
        return battery.open_circuit_full - battery.open_circuit_slope * used
    return _along(battery.open_circuit_curve, used)


def _along(curve, share):
    """Return a curve (..., k), given at evenly spaced shares 0..1, at `share` (...), linear between and beyond."""
    last = curve.shape[-1] - 1
    slopes = [last * (curve[..., i + 1] - curve[..., i]) for i in range(last)]
    value = curve[..., 0] + slopes[0] * share
    for i in range(1, last):
        value = value + (slopes[i] - slopes[i - 1]) * jnp.maximum(share - i / last, 0.0)
    return value


def resistance(battery, memory):
    """Return R (...) ohm at the pack's temperature."""
    if battery.temperature_slope is None:
        return battery.resistance
    celsius = (memory or {}).get("celsius", battery.temperature)
    return battery.resistance * (1.0 + battery.temperature_slope * (celsius - REFERENCE_CELSIUS))


def voltage_and_current(power_w, charge, rc_voltage, battery, memory=None):
    """Return (U (...) V, I (...) A) under a load of `power_w`.

    U = E - R I with I = P/U is the larger root of U^2 - E U + R P = 0; above the largest power of the pack
    (P > E^2 / 4R) the voltage stays at E/2. Without `memory` the second branch is at rest.
    """
    source = open_circuit(charge, battery, memory) - rc_voltage
    if memory and "rc2_voltage" in memory:
        source = source - memory["rc2_voltage"]
    discriminant = source * source - 4.0 * resistance(battery, memory) * power_w
    voltage = 0.5 * (source + jnp.sqrt(jnp.maximum(discriminant, 0.0)))
    return voltage, power_w / voltage


def with_added_voltage(voltage, current, power_w, added):
    """Return (U (...) V, I (...) A) with `added` V, as an equation of the vehicle file gives; a plain zero is none."""
    if is_zero(added):
        return voltage, current
    return voltage + added, power_w / (voltage + added)


def discharge(charge, rc_voltage, current, dt, battery):
    """Return (charge, rc_voltage) after `dt` s at a constant current; exact for the RC branch."""
    return charge + current * dt, _relaxed(rc_voltage, current, dt, battery.rc_resistance, battery.rc_time)


def _relaxed(voltage, current, dt, branch_resistance, time):
    """Return the voltage of an RC branch after `dt` s at a constant current."""
    target = current * branch_resistance
    return target + jnp.exp(-dt / time) * (voltage - target)


def advance_memory(memory, power_w, current, dt, battery) -> dict:
    """Return the pack's memory (see `start`) after `dt` s under a constant load."""
    moved = dict(memory)
    if "rc2_voltage" in moved:
        moved["rc2_voltage"] = _relaxed(moved["rc2_voltage"], current, dt, battery.rc2_resistance, battery.rc2_time)
    if "energy" in moved:
        moved["energy"] = moved["energy"] + power_w * dt
    if "celsius" in moved:
        heat_w = resistance(battery, memory) * current * current
        moved["celsius"] = moved["celsius"] + heat_w * dt / battery.heat_capacity
    return moved


def effects(vehicle: Vehicle) -> tuple[Effect, ...]:
    """Return the effect of a pack with another resistance and discharge slope."""
    steps_and_bounds = {
        "resistance": (0.05 * vehicle.battery.resistance + 1e-4, 1.0),
        "open_circuit_slope": (0.05, 50.0),
    }
    return (
        Effect(
            id="battery_sag",
            layer="motor",
            parameters=tuple(
                Parameter(key, UNITS[key], ("battery", key), step, 0.0, high)
                for key, (step, high) in steps_and_bounds.items()
            ),
            equation="U = U_oc - slope charge / capacity - R I - U_rc",
            sentence="the pack has {resistance:.4g} ohm and loses {open_circuit_slope:.3g} V over a discharge",
            manoeuvre="load steps, and the same manoeuvre with a full and a nearly empty pack",
            channels=("voltage", "rotor_speed"),
        ),
    )

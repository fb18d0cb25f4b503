"""Nominal twins of a recording that knows no place: its commands drive the file's motors and pack as on a test bench.

A flight controller's own log is one. Motors and battery can be diagnosed by it, and nothing of the air. Where it has
only one of commands and rotor speeds, there is nothing to hold the motors against: the pack alone is on the bench, and
the recorded speeds load it, or those that the file's motors make of the commands.
"""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from swift_ros.recording.flight_table import FlightTable, Samples
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.nominal import reference_flights, rotor_speed_model
from swift_sim_bridge.gap.recording.motor_record import MotorRecord, motor_record_of
from swift_sim_bridge.gap.recording.recording import Recording
from swift_sim_bridge.identification import grid
from swift_sim_bridge.physics import battery, motors
from swift_sim_bridge.physics.state import parameters_from_vehicle
from swift_sim_bridge.physics.terms import registry
from swift_sim_bridge.physics.terms.vectors import stack

WANDERING = 0.03  # of the commands: each twin is driven a little otherwise
WANDERING_HZ = 2.0


def reference_tables(
    table: FlightTable, recording: Recording, vehicle: Vehicle, count: int, seed: int
) -> list[FlightTable]:
    """Return `count` nominal twins of a recording without a pose, with its channels at its rates."""
    sheet, found, rng = reference_flights.estimate_noise_sheet(table, vehicle), [], np.random.default_rng([seed, 15])
    loop = recording.rate_loop
    for number in range(count):
        phase, hz = 2 * np.pi * rng.random(len(vehicle.rotors)), WANDERING_HZ * rng.uniform(0.5, 1.5)

        def wandering(t, phase=phase, hz=hz):
            return WANDERING * np.sin(2 * np.pi * hz * t[:, None] + phase)

        driven, motor_record = table, recording.motor_record
        if loop:  # what drives the motors is what such a loop asks, with more or less throttle
            asked = Samples(loop.t, loop.simulate_motors(wandering(loop.t)[:, 0], rng))
            driven = replace(table, channels={**table.channels, "motor_command": asked})
            motor_record, wandering = motor_record_of(driven, vehicle), _steady
        flown = _flown(driven, motor_record, vehicle, wandering)
        channels = {
            name: _measured(flown.get(name), samples, name, sheet, rng) for name, samples in table.channels.items()
        }
        if loop:
            channels["motor_command"] = asked
        found.append(replace(table, name=f"twin {number + 1} of {table.name}", channels=channels, rejections=()))
    return found


def _steady(t):
    return np.zeros((len(t), 1))


def _flown(table: FlightTable, motor_record: MotorRecord | None, vehicle: Vehicle, wandering) -> dict[str, Samples]:
    """Return what a twin does: motors and pack under the commands, or the pack alone under the rotor speeds.
    wandering: by which share both are other at times t (n,) s, (n, r)."""
    if motor_record is None and "rotor_speed" not in table:
        motor_record = rotor_speed_model.motor_record_of(table, vehicle)
    if motor_record is None:
        speeds = table["rotor_speed"]
        speed = speeds.values * (1.0 + wandering(speeds.t))
        voltage, current = _loaded(vehicle, speeds.t, speed, grid.at(table["voltage"], speeds.t))
        return {
            "rotor_speed": Samples(speeds.t, speed),
            "voltage": Samples(speeds.t, voltage),
            "current": Samples(speeds.t, current),
        }
    command = np.clip(motor_record.command * (1.0 + wandering(motor_record.t[:-1])), 0.0, 1.0)
    speed, voltage, current = (np.asarray(part) for part in _driven(vehicle, motor_record, command))
    return {
        "rotor_speed": Samples(motor_record.t, speed),
        "motor_command": Samples(motor_record.t[:-1], command),
        "voltage": Samples(motor_record.t, voltage),
        "current": Samples(motor_record.t, current),
    }


def _measured(truth: Samples | None, recorded: Samples, name: str, sheet: dict, rng) -> Samples:
    """Return what the instrument would have said, at its own times; what no bench shows is left as recorded."""
    if truth is None:
        return recorded
    columns = truth.values.reshape(len(truth.t), -1).T
    values = np.stack([np.interp(recorded.t, truth.t, column) for column in columns], axis=-1)
    if name == "motor_command":
        rows = np.clip(np.searchsorted(truth.t, recorded.t + 1e-6, "right") - 1, 0, None)
        return Samples(recorded.t, truth.values[rows])
    noise = sheet.get(reference_flights.SHEET[name], 0.0) * rng.standard_normal(values.shape)
    noisy = values * (1.0 + noise) if name == "rotor_speed" else values + noise
    return Samples(recorded.t, noisy.reshape(recorded.values.shape))


def _driven(vehicle: Vehicle, motor_record, command):
    """Return rotor speeds (n, r), voltage (n,) and current (n,) under commands (n - 1, r)."""
    parameters = parameters_from_vehicle(vehicle, np.float64)
    inputs = np.append(np.diff(motor_record.t), 0.0), np.concatenate([command, command[-1:]])
    return _run(parameters, motor_record.rotor_speed[0], _used(vehicle, motor_record.voltage[0]), inputs)


def _loaded(vehicle: Vehicle, t, rotor_speed, voltage) -> tuple[np.ndarray, np.ndarray]:
    """Return voltage (n,) and current (n,) of the pack under rotors at these speeds (n, r), where it began at this
    voltage (n,)."""
    parameters = parameters_from_vehicle(vehicle, np.float64)
    inputs = np.append(np.diff(t), 0.0), rotor_speed
    return tuple(np.asarray(part) for part in _discharged(parameters, _used(vehicle, voltage[0]), inputs))


def _used(vehicle: Vehicle, voltage: float) -> float:
    """Return the charge A s that the pack has given where it stands at a voltage."""
    pack = vehicle.battery
    short = pack.open_circuit_full - voltage
    used = np.clip(short / pack.open_circuit_slope, 0.0, 1.0) * pack.capacity if pack.open_circuit_slope else 0.0
    return float(used)


class _Pack(NamedTuple):
    """charge A s that was given, rc_voltage V, and what else the pack remembers (see `battery.start`)."""

    charge: jax.Array
    rc_voltage: jax.Array
    remembered: dict


def _begun(parameters, used) -> _Pack:
    return _Pack(used, jnp.zeros_like(used), battery.start(parameters.battery, jnp.zeros_like(used)))


def _under(parameters, pack: _Pack, speed, dt) -> tuple[_Pack, tuple]:
    """Return the pack after dt s under rotors at these speeds (r,), and its voltage and current before."""
    power_w = battery.power(speed, parameters.rotors.torque_coefficient, parameters.battery)
    told = voltage, current = battery.voltage_and_current(
        power_w, pack.charge, pack.rc_voltage, parameters.battery, pack.remembered
    )
    charge, rc_voltage = battery.discharge(pack.charge, pack.rc_voltage, current, dt, parameters.battery)
    return _Pack(charge, rc_voltage, battery.advance_memory(pack.remembered, power_w, current, dt, parameters.battery)), told


@jax.jit
def _discharged(parameters, used, inputs):
    def step(pack, now):
        dt, speed = now
        return _under(parameters, pack, speed, dt)

    return jax.lax.scan(step, _begun(parameters, jnp.asarray(used)), inputs)[1]


@jax.jit
def _run(parameters, first, used, inputs):
    factor = jnp.ones_like(first)
    for factors in registry.motor_factors({}, parameters):
        factor = factor * stack(factors)

    def step(state, now):
        speed, pack = state
        dt, command = now
        pack, (voltage, current) = _under(parameters, pack, speed, dt)
        target = factor * motors.steady_speed(command, voltage, parameters.motors)
        lagged = stack(motors.lag(tuple(speed), tuple(target), dt, parameters.motors))
        return (lagged, pack), (speed, voltage, current)

    return jax.lax.scan(step, (first, _begun(parameters, jnp.asarray(used))), inputs)[1]

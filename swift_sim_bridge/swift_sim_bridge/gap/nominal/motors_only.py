"""Reference flights of a recording without a pose: its commands drive the file's motors and battery.

A flight controller's own log is such a recording. It shows motors and battery, and nothing of the vehicle's motion.
Where it has only commands or only rotor speeds, the battery alone is simulated: its load are the recorded rotor speeds,
or those that the file's motors reach with the commands.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from swift_ros.recording.flight_table import FlightTable, Samples
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.nominal.noise_sheet import NOISE_KEYS, estimate_noise_sheet
from swift_sim_bridge.gap.recording.motor_record import (
    STAMP_TOLERANCE_S,
    MotorRecord,
    motor_record_of,
    record_from_commands,
)
from swift_sim_bridge.gap.recording.recording import Recording
from swift_sim_bridge.gap.residuals import pack_replay
from swift_sim_bridge.identification import grid
from swift_sim_bridge.physics.state import parameters_from_vehicle

VARIATION = 0.03  # relative change of the commands, different in each reference flight; larger is less like the flight
VARIATION_HZ = 2.0  # mean frequency of that change


class Variation(NamedTuple):
    """A relative change of r motor commands, or of rotor speeds, over time.

    Attributes:
        phase: (r,) rad.
        hz: frequency.
    """

    phase: np.ndarray
    hz: float

    def at(self, t) -> np.ndarray:
        """Return the relative change (n, r) at times t (n,) s."""
        return VARIATION * np.sin(2 * np.pi * self.hz * t[:, None] + self.phase)


def reference_tables(
    table: FlightTable, recording: Recording, vehicle: Vehicle, count: int, seed: int
) -> list[FlightTable]:
    """Return reference flights of a recording without a pose, with its channels at its rates.

    Args:
        table: the recording as it was measured.
        recording: the same on its grid.
        vehicle: the vehicle as its file describes it.
        count: number of reference flights.
        seed: seed of their random numbers.
    """
    sheet, found, rng = estimate_noise_sheet(table, vehicle), [], np.random.default_rng([seed, 15])
    loop = recording.rate_loop
    for number in range(count):
        phase, hz = 2 * np.pi * rng.random(len(vehicle.rotors)), VARIATION_HZ * rng.uniform(0.5, 1.5)
        variation: Variation | None = Variation(phase, hz)
        driven, record = table, recording.motor_record
        if loop:  # the rate loop drives the motors, with a varied throttle
            simulated = Samples(loop.t, loop.simulate_motors(variation.at(loop.t)[:, 0], rng))
            driven = replace(table, channels={**table.channels, "motor_command": simulated})
            record, variation = motor_record_of(driven, vehicle), None
        flown = _simulated(driven, record, vehicle, variation)
        channels = {
            name: _measured(flown.get(name), samples, name, sheet, rng) for name, samples in table.channels.items()
        }
        if loop:
            channels["motor_command"] = simulated
        name = f"reference flight {number + 1} of {table.name}"
        found.append(replace(table, name=name, channels=channels, rejections=()))
    return found


def _simulated(
    table: FlightTable, record: MotorRecord | None, vehicle: Vehicle, variation: Variation | None
) -> dict[str, Samples]:
    """Return the channels of motors and battery under the commands, or of the battery under the rotor speeds.

    Args:
        table: the recording.
        record: its motor record if it has one.
        vehicle: the vehicle.
        variation: relative change of commands or rotor speeds, None for none.
    """

    def varied(values, t):
        return values * (1.0 + (variation.at(t) if variation else np.zeros((len(t), 1))))

    if record is None and "rotor_speed" not in table:
        record = record_from_commands(table, vehicle)
    if record is None:
        speeds = table["rotor_speed"]
        speed = varied(speeds.values, speeds.t)
        voltage, current = _battery_under_load(vehicle, speeds.t, speed, grid.at(table["voltage"], speeds.t))
        return {
            "rotor_speed": Samples(speeds.t, speed),
            "voltage": Samples(speeds.t, voltage),
            "current": Samples(speeds.t, current),
        }
    t = record.step_t
    command = np.clip(varied(record.step_command, t[:-1]), 0.0, 1.0)
    speed, voltage, current = (np.asarray(part) for part in _motors_and_battery(vehicle, record, command))
    return {
        "rotor_speed": Samples(t, speed),
        "motor_command": Samples(t[:-1], command),
        "voltage": Samples(t, voltage),
        "current": Samples(t, current),
    }


def _measured(truth: Samples | None, recorded: Samples, name: str, sheet: dict, rng) -> Samples:
    """Return a simulated channel at the times of the recorded one, with noise; one that is not simulated unchanged."""
    if truth is None:
        return recorded
    columns = truth.values.reshape(len(truth.t), -1).T
    values = np.stack([np.interp(recorded.t, truth.t, column) for column in columns], axis=-1)
    if name == "motor_command":
        rows = np.clip(np.searchsorted(truth.t, recorded.t + STAMP_TOLERANCE_S, "right") - 1, 0, None)
        return Samples(recorded.t, truth.values[rows])
    noise = sheet.get(NOISE_KEYS[name], 0.0) * rng.standard_normal(values.shape)
    noisy = values * (1.0 + noise) if name == "rotor_speed" else values + noise
    return Samples(recorded.t, noisy.reshape(recorded.values.shape))


def _motors_and_battery(vehicle: Vehicle, record: MotorRecord, command):
    """Return rotor speeds (k + 1, r) rad/s, voltage V and current A under the commands (k, r) of a record's steps."""
    parameters = parameters_from_vehicle(vehicle, np.float64)
    inputs = np.append(np.diff(record.step_t), 0.0), np.concatenate([command, command[-1:]])
    return pack_replay.driven(parameters, record.rotor_speed[0], _used_charge(vehicle, record.voltage[0]), inputs)


def _battery_under_load(vehicle: Vehicle, t, rotor_speed, voltage) -> tuple[np.ndarray, np.ndarray]:
    """Return voltage (n,) V and current (n,) A under rotors at these speeds (n, r), from the first voltage (n,) on."""
    parameters = parameters_from_vehicle(vehicle, np.float64)
    inputs = np.append(np.diff(t), 0.0), rotor_speed
    return tuple(
        np.asarray(part) for part in pack_replay.discharged(parameters, _used_charge(vehicle, voltage[0]), inputs)
    )


def _used_charge(vehicle: Vehicle, voltage: float) -> float:
    """Return the charge A s that the battery has delivered when its voltage is this one."""
    pack = vehicle.battery
    below_full = pack.open_circuit_full - voltage
    used = np.clip(below_full / pack.open_circuit_slope, 0.0, 1.0) * pack.capacity if pack.open_circuit_slope else 0.0
    return float(used)

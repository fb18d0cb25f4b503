"""Rotor speeds that nobody measured: what the vehicle file's motors make of the recorded commands."""

from dataclasses import replace

import jax
import numpy as np

from swift_ros.flight_table import FlightTable, Samples
from swift_ros.vehicle import GRAVITY, Vehicle
from swift_sim_bridge.gap import replay
from swift_sim_bridge.gap.check import Drive
from swift_sim_bridge.identification import grid


def completed(table: FlightTable, vehicle: Vehicle) -> FlightTable:
    """Return the flight with rotor speeds, replayed from its motor commands at the measured voltage where they were not
    recorded. The commands then tell nothing more."""
    if "rotor_speed" in table or "motor_command" not in table:
        return table
    command = table["motor_command"]
    voltage = np.full(len(command.t), vehicle.battery.reference_voltage)
    if "voltage" in table:
        voltage = grid.at(table["voltage"], command.t)
    steady = np.full(len(vehicle.rotors), hover_speed(vehicle))
    drive = Drive(command.t, command.values[:-1], np.broadcast_to(steady, (len(command.t), len(steady))), voltage)
    with jax.enable_x64(True):
        speed = replay.rotor_speeds(replay.parameters_of([vehicle]), drive)[0]
    channels = {name: samples for name, samples in table.channels.items() if name != "motor_command"}
    return replace(table, channels={**channels, "rotor_speed": Samples(command.t, speed)})


def hover_speed(vehicle: Vehicle) -> float:
    """Return the rotors' speed rad/s in hover."""
    return float(np.sqrt(vehicle.mass * GRAVITY / (len(vehicle.rotors) * vehicle.thrust_coefficient)))

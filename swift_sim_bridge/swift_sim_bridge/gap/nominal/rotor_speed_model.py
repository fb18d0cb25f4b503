"""Rotor speeds that nobody measured: what the vehicle file's motors make of the recorded commands.

No two motors are alike, and their differences are larger than what turns the vehicle: only what the rotors have in
common is taken from commands.
"""

from dataclasses import replace

import jax
import numpy as np

from swift_ros.recording.flight_table import FlightTable, Samples
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.recording.recording import Drive, refuse_other_rotors
from swift_sim_bridge.gap.residuals import physics_replay
from swift_sim_bridge.identification import grid


def completed(table: FlightTable, vehicle: Vehicle) -> FlightTable:
    """Return the flight with the rotors' common speed, replayed from the motor commands at the measured voltage, where
    no speeds were recorded. Of the motors the commands then tell nothing more. Raises UsageError for another number of
    rotors."""
    if "rotor_speed" in table or "motor_command" not in table:
        return table
    refuse_other_rotors(table, vehicle)
    drive = drive_of(table, vehicle)
    with jax.enable_x64(True):
        speed = physics_replay.rotor_speeds(physics_replay.parameters_of([vehicle]), drive)[0]
    common = np.broadcast_to(np.sqrt(np.mean(speed**2, axis=1, keepdims=True)), speed.shape)
    told = grid.known(table, ["voltage"] if "voltage" in table else [], drive.t, open_ended=True)
    return replace(table, channels={**table.channels, "rotor_speed": Samples(drive.t[told], common[told])}, spun=True)


def drive_of(table: FlightTable, vehicle: Vehicle) -> Drive:
    """Return the motors' inputs by the commands alone, and rotors that begin as in hover."""
    command = table["motor_command"]
    voltage = np.full(len(command.t), vehicle.battery.reference_voltage)
    if "voltage" in table:
        voltage = grid.at(table["voltage"], command.t)
    steady = np.full(len(vehicle.rotors), vehicle.hover_speed)
    return Drive(command.t, command.values[:-1], np.broadcast_to(steady, (len(command.t), len(steady))), voltage)

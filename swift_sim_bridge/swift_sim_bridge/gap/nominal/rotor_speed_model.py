"""Rotor speeds that nobody measured: what the vehicle file's motors make of the recorded commands.

No two motors are alike, and their differences are larger than what turns the vehicle: only what the rotors have in
common is taken from commands.
"""

from dataclasses import replace

import jax
import numpy as np

from swift_ros.recording.flight_table import FlightTable, Samples
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.recording.motor_record import MotorRecord
from swift_sim_bridge.gap.recording.recording import require_rotor_count
from swift_sim_bridge.gap.residuals import physics_replay
from swift_sim_bridge.identification import grid


def with_modelled_rotor_speeds(table: FlightTable, vehicle: Vehicle) -> FlightTable:
    """Return the flight with the rotors' common speed, replayed from the motor commands at the measured voltage, where
    no speeds were recorded. Of the motors the commands then tell nothing more. Raises UsageError for another number of
    rotors."""
    if "rotor_speed" in table or "motor_command" not in table:
        return table
    require_rotor_count(table, vehicle)
    motor_record = motor_record_of(table, vehicle)
    with jax.enable_x64(True):
        speed = physics_replay.rotor_speeds(physics_replay.stack_parameters([vehicle]), motor_record)[0]
    common = np.broadcast_to(np.sqrt(np.mean(speed**2, axis=1, keepdims=True)), speed.shape)
    told = grid.known(table, ["voltage"] if "voltage" in table else [], motor_record.t, open_ended=True)
    return replace(
        table,
        channels={**table.channels, "rotor_speed": Samples(motor_record.t[told], common[told])},
        rotor_speed_modelled=True,
    )


def motor_record_of(table: FlightTable, vehicle: Vehicle) -> MotorRecord:
    """Return the motors' inputs by the commands alone, and rotors that begin as in hover."""
    command = table["motor_command"]
    voltage = np.full(len(command.t), vehicle.battery.reference_voltage)
    if "voltage" in table:
        voltage = grid.at(table["voltage"], command.t)
    steady = np.full(len(vehicle.rotors), vehicle.hover_speed)
    return MotorRecord(command.t, command.values[:-1], np.broadcast_to(steady, (len(command.t), len(steady))), voltage)

"""Rotor speeds that were not measured: those that the vehicle file's motors reach with the recorded commands.

Differences between real motors are larger than those between commands that rotate the vehicle. Only the rotors' common
speed is therefore modelled.
"""

from dataclasses import replace

import jax
import numpy as np

from swift_ros.recording.flight_table import FlightTable, Samples
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.recording.command_rows import command_rows_of, loop_interval_s
from swift_sim_bridge.gap.recording.motor_record import MotorRecord
from swift_sim_bridge.gap.recording.recording import require_rotor_count
from swift_sim_bridge.gap.residuals import physics_replay
from swift_sim_bridge.identification import grid


def with_modelled_rotor_speeds(table: FlightTable, vehicle: Vehicle) -> FlightTable:
    """Return the flight with the rotors' common speed from the motor commands, where no rotor speeds were measured.

    The commands then give no information about the motors.

    Raises:
        UsageError: the flight has another number of rotors than the vehicle.
    """
    if "rotor_speed" in table or "motor_command" not in table:
        return table
    require_rotor_count(table, vehicle)
    record = record_from_commands(table, vehicle)
    with jax.enable_x64(True):
        speed = physics_replay.rotor_speeds(physics_replay.stack_parameters([vehicle]), record)[0]
    common = np.broadcast_to(np.sqrt(np.mean(speed**2, axis=1, keepdims=True)), speed.shape)
    known = grid.known(table, ["voltage"] if "voltage" in table else [], record.t, open_ended=True)
    modelled = Samples(record.t[known], common[known])
    return replace(table, channels={**table.channels, "rotor_speed": modelled}, rotor_speed_modelled=True)


def record_from_commands(table: FlightTable, vehicle: Vehicle) -> MotorRecord:
    """Return motor commands and voltage of a flight, with the rotor speeds of a hover."""
    command = table["motor_command"]
    voltage = np.full(len(command.t), vehicle.battery.reference_voltage)
    if "voltage" in table:
        voltage = grid.at(table["voltage"], command.t)
    hover = np.full(len(vehicle.rotors), vehicle.hover_speed)
    rows = command_rows_of(command, table.sampling.get("motor_command"), loop_interval_s(vehicle))
    speeds = np.broadcast_to(hover, (len(command.t), len(hover)))
    return MotorRecord(command.t, command.values[:-1], speeds, voltage, rows)

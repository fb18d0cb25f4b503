"""Rotor speeds that were not measured: those that the vehicle file's motors reach with the recorded commands.

Differences between real motors are larger than those between commands that rotate the vehicle. Beside a gyro, only the
rotors' common speed is therefore modelled. A pose without a gyro shows so little that each rotor's own speed is
modelled, and differences between the motors are among the effects that are tested.
"""

from dataclasses import replace

import jax
import numpy as np

from swift_ros.recording.flight_table import FlightTable, Samples
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.recording.motor_record import driving_record_of, record_from_commands
from swift_sim_bridge.gap.recording.recording import require_rotor_count
from swift_sim_bridge.gap.residuals import physics_replay
from swift_sim_bridge.identification import grid


def with_modelled_rotor_speeds(table: FlightTable, vehicle: Vehicle) -> FlightTable:
    """Return the flight with rotor speeds from the motor commands, where none were measured.

    With the rotors' common speed the commands give no information about the motors.

    Raises:
        UsageError: the flight has another number of rotors than the vehicle.
    """
    if "rotor_speed" in table or "motor_command" not in table:
        return table
    require_rotor_count(table, vehicle)
    driven = driving_record_of(table, vehicle)
    record = driven or record_from_commands(table, vehicle)
    with jax.enable_x64(True):
        speed = physics_replay.rotor_speeds(physics_replay.stack_parameters([vehicle]), record)[0]
    if driven is None:
        speed = np.broadcast_to(np.sqrt(np.mean(speed**2, axis=1, keepdims=True)), speed.shape)
    known = grid.known(table, ["voltage"] if "voltage" in table else [], record.t, open_ended=True)
    modelled = Samples(record.t[known], speed[known])
    return replace(table, channels={**table.channels, "rotor_speed": modelled}, rotor_speed_modelled=True)

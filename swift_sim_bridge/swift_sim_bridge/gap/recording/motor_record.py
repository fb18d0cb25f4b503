"""Motor commands, rotor speeds and voltage of a recording at the rate of the rotor speeds."""

from dataclasses import dataclass, replace

import numpy as np

from swift_ros.recording.flight_table import FlightTable, Samples
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.recording.command_rows import (
    MAX_STEP_S,
    CommandRows,
    command_rows_of,
    loop_interval_s,
    with_sent_part,
)
from swift_sim_bridge.identification import grid

COMMANDS_PER_SPEED = 1.5  # ratio of sample rates above which several commands act between two rotor speeds
STAMP_TOLERANCE_S = 1e-6  # time stamps are written in whole microseconds


@dataclass(frozen=True)
class MotorRecord:
    """Inputs and response of the motors at the times of the rotor speeds.

    Attributes:
        t: (n,) s.
        command: (n - 1, r), 0..1; acts from each time to the next, as a mean.
        rotor_speed: (n, r) rad/s.
        voltage: (n,) V; None where it is that of the vehicle's own battery under the load of its rotors.
        rows: the commands, where their rows are slower than the loop; None where every command was recorded.
    """

    t: np.ndarray
    command: np.ndarray
    rotor_speed: np.ndarray
    voltage: np.ndarray | None
    rows: CommandRows | None = None

    @property
    def steps(self) -> int:
        """Number of steps of a replay between two rotor speeds."""
        return 1 if self.rows is None else max(1, int(np.ceil(np.median(np.diff(self.t)) / MAX_STEP_S - 0.01)))

    @property
    def step_t(self) -> np.ndarray:
        """Times (k + 1,) s between which the k steps of a replay lie."""
        share = np.arange(self.steps) / self.steps
        return np.append((self.t[:-1, None] + np.diff(self.t)[:, None] * share).ravel(), self.t[-1])

    @property
    def step_command(self) -> np.ndarray:
        """The command (k, r) of each step."""
        if self.rows is None:
            return self.command
        t = self.step_t
        return self.rows.at(0.5 * (t[1:] + t[:-1]))


def motor_record_of(table: FlightTable, vehicle: Vehicle) -> MotorRecord | None:
    """Return the motors' inputs and response.

    Returns:
        None where motor commands or rotor speeds were not measured, or where the recording skips some of the commands
        that the motors received. Without a measured voltage, the reference voltage of the vehicle file is used.
    """
    if "motor_command" not in table or "rotor_speed" not in table or table.rotor_speed_modelled or table.skips_commands:
        return None
    command, speed = table["motor_command"], table["rotor_speed"]
    inside = (speed.t >= command.t[0]) & (speed.t <= command.t[-1] + 1.5 / command.rate_hz)
    t = speed.t[inside]
    voltage = grid.at(table["voltage"], t) if "voltage" in table else np.full(len(t), vehicle.battery.reference_voltage)
    rows = command_rows_of(command, table.sampling.get("motor_command"), loop_interval_s(vehicle))
    rows = rows and with_sent_part(rows, table)
    return MotorRecord(t, _acting(command, t), speed.values[inside], voltage, rows)


def record_from_commands(table: FlightTable, vehicle: Vehicle) -> MotorRecord:
    """Return motor commands and voltage of a flight, with the rotor speeds of a hover.

    Without a measured voltage, the reference voltage of the vehicle file is used.
    """
    command = table["motor_command"]
    voltage = np.full(len(command.t), vehicle.battery.reference_voltage)
    if "voltage" in table:
        voltage = grid.at(table["voltage"], command.t)
    hover = np.full(len(vehicle.rotors), vehicle.hover_speed)
    rows = command_rows_of(command, table.sampling.get("motor_command"), loop_interval_s(vehicle))
    speeds = np.broadcast_to(hover, (len(command.t), len(hover)))
    return MotorRecord(command.t, command.values[:-1], speeds, voltage, rows)


def driving_record_of(table: FlightTable, vehicle: Vehicle) -> MotorRecord | None:
    """Return the commands that drive the motors of each vehicle that a recording is compared with.

    None where rotor speeds or body rates were measured, or where the recording skips some of the commands.
    """
    measured = "rotor_speed" in table and not table.rotor_speed_modelled
    pose = "p_world" in table and "q_world_body" in table
    if measured or "motor_command" not in table or not pose or "gyro_body" in table or table.skips_commands:
        return None
    record = record_from_commands(table, vehicle)
    return record if "voltage" in table else replace(record, voltage=None)


def _acting(command: Samples, t) -> np.ndarray:
    """Return the command (n - 1, r) that acts from each of the times t (n,) s to the next: the mean of several."""
    row = np.clip(np.searchsorted(command.t, t + STAMP_TOLERANCE_S, "right") - 1, 0, None)
    if command.rate_hz < COMMANDS_PER_SPEED * (len(t) - 1) / (t[-1] - t[0]):
        return command.values[row[:-1]]
    total = np.concatenate(
        [np.zeros((1, command.values.shape[1])), np.cumsum(np.diff(command.t)[:, None] * command.values[:-1], axis=0)]
    )
    acted = total[row] + (t - command.t[row])[:, None] * command.values[row]
    return np.diff(acted, axis=0) / np.diff(t)[:, None]

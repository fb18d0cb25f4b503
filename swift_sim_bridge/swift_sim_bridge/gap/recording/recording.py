"""A recording as the tool reads it: its channels at common times, each through the same short filter. Pure."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from swift_ros import geometry
from swift_ros.errors import UsageError
from swift_ros.recording.checks import Rejection
from swift_ros.recording.flight_table import FlightTable, Samples
from swift_ros.vehicle import GRAVITY, Vehicle
from swift_sim_bridge.gap.recording import consistency, gate_observations
from swift_sim_bridge.gap.recording.betaflight_log import RateLoopLog, read_rate_loop_log
from swift_sim_bridge.gap.recording.channel_names import names_with_columns
from swift_sim_bridge.gap.recording.command_link import Line, read_command_link
from swift_sim_bridge.gap.recording.gate_observations import GateObservations
from swift_sim_bridge.gap.recording.rate_pid import RatePid, rate_pid_from_vehicle
from swift_sim_bridge.identification import grid
from swift_sim_bridge.sensors.clock import Moving
from swift_sim_bridge.sensors.terms import sensor_terms

MODEL_HZ = 170.0  # the physics is evaluated at most so often: the filter leaves nothing beyond 12 Hz
LEAST_S, LEAST_FLOWN_S = 5.0, 3.0
BURN_IN = 6.0  # time constants after which the motors have forgotten their first speed
STILL_S, STILL_M, CARRIED = 0.2, 0.02, 0.8  # a vehicle that stands, by its motion and by how little its rotors lift
DENSER = 1.5  # times as many commands as rotor speeds: several act between two of these
CLEAR_M = 0.2  # from where it stood: nothing touches it any more
LIFTS = 0.1  # of its weight: what lifts less lies somewhere, its rotors off


@dataclass(frozen=True)
class MotorRecord:
    """The motors' inputs and answer at the recording's own rate: t (n,) s; command (n - 1, r) that acts from each time
    to the next; rotor_speed (n, r); voltage (n,)."""

    t: np.ndarray
    command: np.ndarray
    rotor_speed: np.ndarray
    voltage: np.ndarray


@dataclass(frozen=True)
class Recording:
    """One flight at even times t (n,) s. Channels as `FlightTable` names them, None where missing; v_world is derived
    from the position where `by_velocity` is false; good (n,): where all that is there was measured; flown (n,): where
    the vehicle flies, by its file, and its motors have forgotten their first speed; drive: None without motor commands
    and rotor speeds; line: the commands' way, loop: the log of a Betaflight's rate loop, or why these are not known;
    rejections: what was left out; gate_observations: gates in images, None where there were none or no pose tells from where;
    rotor_speed_modelled, skips_commands: as `FlightTable` has them; holes: where (n,) VIO, motor commands, voltage or current were not
    recorded for long, by channel of those that have such times.
    """

    name: str
    t: np.ndarray
    p_world: np.ndarray | None
    q_world_body: np.ndarray | None
    v_world: np.ndarray | None
    gyro_body: np.ndarray | None
    specific_force_body: np.ndarray | None
    rotor_speed: np.ndarray | None
    voltage: np.ndarray | None
    current: np.ndarray | None
    p_vio: np.ndarray | None
    q_vio_body: np.ndarray | None
    velocity_measured: bool
    good: np.ndarray
    flown: np.ndarray
    motor_record: MotorRecord | None
    line: Line | str
    loop: RateLoopLog | str
    rejections: tuple[Rejection, ...] = ()
    gate_observations: GateObservations | None = None
    rotor_speed_modelled: bool = False
    skips_commands: bool = False
    holes: Mapping[str, np.ndarray] = field(default_factory=dict)

    @property
    def dt(self) -> float:
        return float(self.t[1] - self.t[0])

    @property
    def command_link(self) -> Line | None:
        """The commands' way where it is known."""
        return self.line if isinstance(self.line, Line) else None

    @property
    def rate_loop(self) -> RateLoopLog | None:
        """The log of a Betaflight's rate loop where it tells anything."""
        return self.loop if isinstance(self.loop, RateLoopLog) else None

    @cached_property
    def single_rotor_speeds(self) -> np.ndarray | None:
        """The rotor speeds, unless only what they have in common was recorded: then they all say the same."""
        speed = self.rotor_speed
        return None if speed is None or np.all(speed == speed[:, :1]) else speed

    @cached_property
    def pose_spline(self) -> CubicSpline:
        """Position, attitude, not yet of length one, and velocity (10,) at any time: by splines, since a mean of
        neighbours is calmer than either, by which a delay would be the better the farther between samples it falls."""
        flips = np.sum(self.q_world_body[1:] * self.q_world_body[:-1], axis=1, keepdims=True) < 0
        q = self.q_world_body * np.concatenate([[[1.0]], np.where(np.cumsum(flips, axis=0) % 2, -1.0, 1.0)])
        return CubicSpline(self.t, np.concatenate([self.p_world, q, self.v_world], axis=1))

    def hole(self, *channels: str) -> np.ndarray:
        """Return when (n,) one of these was not recorded for long."""
        nowhere = np.zeros(len(self.t), bool)
        return np.any([nowhere, *(self.holes[one] for one in channels if one in self.holes)], axis=0)

    def has(self, *channels: str) -> bool:
        """Return whether all these channels are there."""
        return all(getattr(self, STANDS_IN.get(channel, channel), None) is not None for channel in channels)


STANDS_IN = {
    "motor_command": "motor_record",
    "omega_command_body": "command_link",
    "thrust_command": "command_link",
}  # for a channel
SYNCHRONOUS_CHANNELS = ("p_world", "q_world_body", "gyro_body", "specific_force_body", "rotor_speed")
BESIDE = ("p_vio", "q_vio_body", "motor_command", "voltage", "current")
VECTORS = ("p_world", "v_world", "gyro_body", "specific_force_body", "rotor_speed", "voltage", "current", "p_vio")


def read_recording(
    table: FlightTable, vehicle: Vehicle, firmware: RatePid | None = None, simulated: bool = False
) -> Recording:
    """Return the table at even times. firmware: the loop that flew, where it knows other numbers than the vehicle;
    simulated: a twin's, in which nothing can contradict itself, and which may see no gate where the recording does.

    Raises UsageError when it is too short, has another number of rotors, or contradicts itself.
    """
    require_rotor_count(table, vehicle)
    table = _without_echo(table)
    there = [name for name in SYNCHRONOUS_CHANNELS if name in table]
    fine = grid.uniform_times(table, *there)
    if len(fine) < 2 or fine[-1] - fine[0] < LEAST_S:
        together = names_with_columns(there)
        if not len(fine):
            raise UsageError(f"{table.name}: {together} were never recorded at the same time; check their clocks")
        raise UsageError(
            f"{table.name}: {together} were recorded together for {fine[-1] - fine[0]:.1f} s, less than "
            f"{LEAST_S:g} s; fly for longer"
        )
    rate = 1.0 / (fine[1] - fine[0])
    stride = int(np.ceil(rate / MODEL_HZ - 1e-6))
    t = fine[::stride]
    values = {name: _thinned(_at(table[name], fine), stride) for name in VECTORS if name in table}
    for name in (name for name in ("q_world_body", "q_vio_body") if name in table):
        values[name] = geometry.normalize(_thinned(_attitude(table[name], fine), stride))
    velocity_measured = "v_world" in values
    if not velocity_measured and "p_world" in values:
        values["v_world"] = np.gradient(values["p_world"], t, axis=0)
    used = [*there, *(["v_world"] if velocity_measured else [])]
    recording = Recording(
        table.name,
        t,
        *(
            values.get(name)
            for name in (
                "p_world",
                "q_world_body",
                "v_world",
                "gyro_body",
                "specific_force_body",
                "rotor_speed",
                "voltage",
                "current",
                "p_vio",
                "q_vio_body",
            )
        ),
        velocity_measured,
        grid.known(table, used, t),
        in_flight(values, t, vehicle),
        motor_record_of(table, vehicle),
        read_command_link(table, firmware or rate_pid_from_vehicle(vehicle)),
        read_rate_loop_log(table, vehicle),
        table.rejections,
        rotor_speed_modelled=table.rotor_speed_modelled,
        skips_commands=table.skips_commands,
        holes=_holes(table, t),
    )
    flown_s, moved = np.count_nonzero(recording.good & recording.flown) * recording.dt, True
    if recording.p_world is not None:
        moved = np.linalg.norm(np.ptp(recording.p_world, axis=0)) > CLEAR_M
    if not simulated and (flown_s or moved) and (wrong := consistency.found(table, recording, vehicle)):
        raise UsageError(f"{table.name}: {wrong}")
    if not flown_s:
        raise UsageError(
            f"{table.name}: its rotors never lift the vehicle by its file, or never while all channels "
            "were recorded; give a flight, with rotor speeds in rad/s"
        )
    if flown_s < LEAST_FLOWN_S:
        raise UsageError(
            f"{table.name}: it flies for only {flown_s:.1f} s while all channels were recorded, less than "
            f"{LEAST_FLOWN_S:g} s; fly for longer"
        )
    if table.detected_gates is None or not recording.has("p_world", "q_world_body", "gyro_body"):
        return recording
    moving = Moving(recording.p_world, recording.q_world_body, recording.v_world, recording.gyro_body)
    found = gate_observations.associate_gates(table.detected_gates, t, moving, sensor_terms(vehicle))
    odd, stamps = len(table.detected_gates.t) - len(found.t), table.detected_gates.t
    reason = f"{odd} of {len(stamps)} lie near no gate of the map, near two of them, or jump"
    left_out = (Rejection(float(stamps[0]), float(stamps[-1]), "gates in images", reason),) if odd else ()
    kept = found if len(found.t) or simulated else None
    return replace(recording, gate_observations=kept, rejections=(*table.rejections, *left_out))


def require_rotor_count(table: FlightTable, vehicle: Vehicle) -> None:
    """Raise UsageError for a flight with more or fewer rotors than the vehicle."""
    for name in (name for name in ("rotor_speed", "motor_command") if name in table):
        if (count := table[name].values.shape[1]) != len(vehicle.rotors):
            raise UsageError(
                f"{table.name} has {count} rotors, the vehicle {len(vehicle.rotors)}; give the vehicle "
                "file of this flight"
            )


def _without_echo(table: FlightTable) -> FlightTable:
    """Return the table without an odometry that is the truth played again, as where a recording has none of its own."""
    if "p_vio" not in table or "p_world" not in table:
        return table
    _, own, other = np.intersect1d(table["p_vio"].t, table["p_world"].t, return_indices=True)
    if not len(own) or not np.array_equal(table["p_vio"].values[own], table["p_world"].values[other]):
        return table
    return replace(table, channels={name: samples for name, samples in table.channels.items() if "vio" not in name})


def _at(samples: Samples, t) -> np.ndarray:
    """Return a channel at times t, cubic where it is slower than these."""
    if samples.rate_hz > 0.9 / (t[1] - t[0]) or len(samples.t) < 4:
        return grid.at(samples, t)
    return CubicSpline(samples.t, samples.values)(np.clip(t, samples.t[0], samples.t[-1]))


def _holes(table: FlightTable, t) -> dict[str, np.ndarray]:
    """Return by channel beside those that a flight must have where (n,) nothing was recorded for long, ends too."""
    found = {name: ~grid.known(table, [name], t, open_ended=True) for name in BESIDE if name in table}
    return {name: hole for name, hole in found.items() if hole.any()}


def _attitude(samples: Samples, t) -> np.ndarray:
    turned = np.cumsum(np.concatenate([[False], np.sum(samples.values[1:] * samples.values[:-1], axis=1) < 0])) % 2
    return _at(Samples(samples.t, samples.values * np.where(turned, -1.0, 1.0)[:, None]), t)


def _thinned(values, stride: int) -> np.ndarray:
    """Return every stride-th row of a channel (n, ...) behind a short bell, the same for all channels."""
    if stride == 1:
        return values
    weights = grid.bell(stride)
    columns = values.reshape(len(values), -1).T
    padded = [np.convolve(np.pad(column, stride, mode="edge"), weights, "valid")[::stride] for column in columns]
    return np.stack(padded, axis=-1).reshape(-1, *values.shape[1:])


def in_flight(values: dict, t, vehicle: Vehicle) -> np.ndarray:
    """Return where (n,) a vehicle flies and its motors have forgotten their first speed, by its file."""
    found = t > t[0] + BURN_IN * max(vehicle.motor.time_constant_up, vehicle.motor.time_constant_down)
    if "rotor_speed" not in values:
        return found
    lift = vehicle.thrust_coefficient * np.sum(values["rotor_speed"] ** 2, axis=1) / vehicle.mass
    found &= lift >= LIFTS * GRAVITY
    return found & ~grounded(values["p_world"], lift, t[1] - t[0]) if "p_world" in values else found


def grounded(p_world, lift, dt: float) -> np.ndarray:
    """Return where (n,) a vehicle stands before it takes off and after it has landed: something carries it there, and
    pushes until it is clear. p_world (n, 3) m; lift (n,): thrust over mass, m/s^2."""
    found, moment = np.zeros(len(lift), bool), max(1, round(STILL_S / dt))
    for order in (slice(None), slice(None, None, -1)):
        away = np.linalg.norm(p_world[order] - p_world[order][0], axis=1)
        if np.median(lift[order][:moment]) < CARRIED * GRAVITY and away[:moment].max() < STILL_M:
            found[order] |= np.cumsum(away > CLEAR_M) == 0
    return found


def motor_record_of(table: FlightTable, vehicle: Vehicle) -> MotorRecord | None:
    """Return the motors' inputs and answer; None where one of them was not measured, or not all that they heard."""
    if "motor_command" not in table or "rotor_speed" not in table or table.rotor_speed_modelled or table.skips_commands:
        return None
    command, speed = table["motor_command"], table["rotor_speed"]
    inside = (speed.t >= command.t[0]) & (speed.t <= command.t[-1] + 1.5 / command.rate_hz)
    t = speed.t[inside]
    voltage = grid.at(table["voltage"], t) if "voltage" in table else np.full(len(t), vehicle.battery.reference_voltage)
    return MotorRecord(t, _acting(command, t), speed.values[inside], voltage)


def _acting(command: Samples, t) -> np.ndarray:
    """Return the command (n - 1, r) that acts from each of the times t (n,) s to the next; of several their mean."""
    row = np.clip(np.searchsorted(command.t, t + 1e-6, "right") - 1, 0, None)
    if command.rate_hz < DENSER * (len(t) - 1) / (t[-1] - t[0]):
        return command.values[row[:-1]]
    total = np.concatenate(
        [np.zeros((1, command.values.shape[1])), np.cumsum(np.diff(command.t)[:, None] * command.values[:-1], axis=0)]
    )
    acted = total[row] + (t - command.t[row])[:, None] * command.values[row]
    return np.diff(acted, axis=0) / np.diff(t)[:, None]

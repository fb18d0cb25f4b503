"""A recording as the gap tool reads it: all channels on one uniform time grid, each through the same short filter."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from swift_ros import geometry
from swift_ros.errors import UsageError
from swift_ros.recording.checks import Rejection
from swift_ros.recording.flight_table import FlightTable, Samples
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.recording import consistency
from swift_sim_bridge.gap.recording.betaflight_log import RateLoopLog, read_rate_loop_log
from swift_sim_bridge.gap.recording.channel_names import names_with_columns
from swift_sim_bridge.gap.recording.command_link import CommandLink, read_command_link
from swift_sim_bridge.gap.recording.command_rows import CommandRows, undeclared_rows_s
from swift_sim_bridge.gap.recording.flight_phase import CLEARANCE_M, in_flight
from swift_sim_bridge.gap.recording.gate_observations import GateObservations, associate_gates
from swift_sim_bridge.gap.recording.motor_record import MotorRecord, driving_record_of, motor_record_of
from swift_sim_bridge.gap.recording.rate_pid import RatePid, rate_pid_from_vehicle
from swift_sim_bridge.gap.recording.unavailable import Unavailable
from swift_sim_bridge.identification import grid
from swift_sim_bridge.sensors.clock import Moving
from swift_sim_bridge.sensors.terms import sensor_terms

MAX_GRID_HZ = 170.0  # bounds the number of evaluations of the physics; the residuals' filter passes nothing above 12 Hz
# The statistical tests compare the seconds of a flight with one another, and need several of them.
MIN_DURATION_S = 5.0  # shortest span with all synchronous channels
MIN_FLOWN_S = 3.0  # shortest flight in it
NEARLY_AS_FAST = 0.9  # of the grid's rate: a channel at this rate or above is interpolated on straight lines
MIN_SPLINE_SAMPLES = 4  # a cubic spline needs as many

SYNCHRONOUS_CHANNELS = ("p_world", "q_world_body", "gyro_body", "specific_force_body", "rotor_speed")
INTERMITTENT_CHANNELS = ("p_vio", "q_vio_body", "motor_command", "voltage", "current")  # may begin late or pause
VECTORS = ("p_world", "v_world", "gyro_body", "specific_force_body", "rotor_speed", "voltage", "current", "p_vio")
QUATERNIONS = ("q_world_body", "q_vio_body")
EVALUATED_AS = {  # by channel: the attribute that holds it, together with the channels that it is compared with
    "motor_command": "motor_record",
    "omega_command_body": "command_link",
    "thrust_command": "command_link",
}


@dataclass(frozen=True)
class Recording:
    """One flight on a uniform time grid. Channels that were not recorded are None.

    Attributes:
        name: for a reader.
        t: (n,) s, uniform.
        p_world: (n, 3) m.
        q_world_body: (n, 4), x, y, z, w.
        v_world: (n, 3) m/s.
        gyro_body: (n, 3) rad/s; the rates of the attitude where no gyro was recorded.
        specific_force_body: (n, 3) m/s^2.
        rotor_speed: (n, r) rad/s.
        voltage: (n,) V.
        current: (n,) A.
        p_vio: (n, 3) m, in the frame of the odometry.
        q_vio_body: (n, 4).
        velocity_measured: whether `v_world` was recorded; it is the derivative of the position otherwise.
        gyro_measured: whether `gyro_body` was recorded.
        good: (n,) bool, where all synchronous channels were measured.
        flown: (n,) bool, see `flight_phase.in_flight`.
        motor_record: motor commands with the rotor speeds that they cause.
        driven: motor commands that give the rotor speeds of each vehicle that the recording is compared with, where
            neither these nor body rates were measured (see `driving_record_of`).
        command_link: commands as sent and as received by the rate loop.
        rate_loop: log of a Betaflight's rate loop.
        unavailable: by "command_link" and "rate_loop": why it is None.
        rejections: parts of the recording that were left out.
        gate_observations: gates in images; None without images or without a pose.
        rotor_speed_modelled: as in `FlightTable`.
        skips_commands: as in `FlightTable`.
        one_clock: as in `FlightTable`.
        gaps: by intermittent channel that has such times: where (n,) it was not recorded for long.
        undeclared_rows_s: by channel the time between two rows, where it is open what the channel did there.
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
    gyro_measured: bool
    good: np.ndarray
    flown: np.ndarray
    motor_record: MotorRecord | None
    driven: MotorRecord | None
    command_link: CommandLink | None
    rate_loop: RateLoopLog | None
    unavailable: Mapping[str, Unavailable] = field(default_factory=dict)
    rejections: tuple[Rejection, ...] = ()
    gate_observations: GateObservations | None = None
    rotor_speed_modelled: bool = False
    skips_commands: bool = False
    one_clock: bool = False
    gaps: Mapping[str, np.ndarray] = field(default_factory=dict)
    undeclared_rows_s: Mapping[str, float] = field(default_factory=dict)

    @property
    def dt(self) -> float:
        """The time step of the grid, s."""
        return float(self.t[1] - self.t[0])

    @cached_property
    def single_rotor_speeds(self) -> np.ndarray | None:
        """The rotor speeds (n, r) rad/s where each rotor has its own; None where only a common speed was recorded."""
        speed = self.rotor_speed
        return None if speed is None or np.all(speed == speed[:, :1]) else speed

    @cached_property
    def pose_spline(self) -> CubicSpline:
        """Position, attitude (not normalised) and velocity (10,) as a function of time.

        A mean of two samples is less noisy than either, so that straight lines would favour a delay of half a sample;
        splines do not.
        """
        flips = np.sum(self.q_world_body[1:] * self.q_world_body[:-1], axis=1, keepdims=True) < 0
        q = self.q_world_body * np.concatenate([[[1.0]], np.where(np.cumsum(flips, axis=0) % 2, -1.0, 1.0)])
        return CubicSpline(self.t, np.concatenate([self.p_world, q, self.v_world], axis=1))

    @property
    def has_motion(self) -> bool:
        """Whether a pose was recorded; body rates follow from it where no gyro was recorded."""
        return self.has("p_world", "q_world_body")

    @property
    def stand_ins(self) -> frozenset[str]:
        """The channels without which the physics is compared all the same, because others stand in for them.

        The pose gives accelerations in place of an IMU; motors and battery of the vehicle, driven by the recorded
        commands, give rotor speeds and voltage.
        """
        imu = {"gyro_body", "specific_force_body"} if self.has_motion and not self.gyro_measured else set()
        return frozenset(imu | ({"motor_command", "voltage"} if self.driven else set()))

    def with_motor_rows(self, rows: CommandRows) -> "Recording":
        """Return the recording with other motor commands between its rows."""
        name = "driven" if self.driven else "motor_record"
        return replace(self, **{name: replace(getattr(self, name), rows=rows)})

    def in_gap(self, *channels: str) -> np.ndarray:
        """Return where (n,) at least one of these channels was not recorded for long."""
        nowhere = np.zeros(len(self.t), bool)
        return np.any([nowhere, *(self.gaps[name] for name in channels if name in self.gaps)], axis=0)

    def has(self, *channels: str) -> bool:
        """Return whether all these channels can be evaluated."""
        return all(
            getattr(self, EVALUATED_AS.get(channel, channel), None) is not None
            and (channel != "gyro_body" or self.gyro_measured)
            for channel in channels
        )


def read_recording(
    table: FlightTable, vehicle: Vehicle, firmware: RatePid | None = None, simulated: bool = False
) -> Recording:
    """Return a flight table on a uniform time grid.

    Args:
        table: the flight.
        vehicle: the vehicle as its file describes it.
        firmware: the rate loop that flew, where its parameters differ from the vehicle file's.
        simulated: the table is a reference flight: its channels are not checked against one another, and it may have
            no gate observations where the recording has some.

    Raises:
        UsageError: the flight is too short, has another number of rotors, or contradicts itself.
    """
    require_rotor_count(table, vehicle)
    table = _without_copied_odometry(table)
    present = [name for name in SYNCHRONOUS_CHANNELS if name in table]
    fine = _common_times(table, present)
    stride = int(np.ceil(1.0 / (fine[1] - fine[0]) / MAX_GRID_HZ - 1e-6))
    t = fine[::stride]
    values = _resampled(table, fine, stride)
    velocity_measured = "v_world" in values
    if not velocity_measured and "p_world" in values:
        values["v_world"] = np.gradient(values["p_world"], t, axis=0)
    gyro_measured = "gyro_body" in values
    if not gyro_measured and "q_world_body" in values:
        values["gyro_body"] = consistency.body_rates(values["q_world_body"], t[1] - t[0])
    recording = Recording(
        name=table.name,
        t=t,
        **{name: values.get(name) for name in (*VECTORS, *QUATERNIONS)},
        velocity_measured=velocity_measured,
        gyro_measured=gyro_measured,
        good=grid.known(table, [*present, *(["v_world"] if velocity_measured else [])], t),
        flown=in_flight(values, t, vehicle),
        motor_record=motor_record_of(table, vehicle),
        driven=driving_record_of(table, vehicle),
        **_evaluated_controllers(table, vehicle, firmware),
        rejections=table.rejections,
        rotor_speed_modelled=table.rotor_speed_modelled,
        skips_commands=table.skips_commands,
        one_clock=table.one_clock,
        gaps=_gaps(table, t),
        undeclared_rows_s=undeclared_rows_s(table, vehicle),
    )
    _require_flight(table, recording, vehicle, simulated)
    return _with_gates(recording, table, vehicle, simulated)


def with_command_rows(
    recording: Recording, table: FlightTable, vehicle: Vehicle, rows: CommandRows, firmware: RatePid | None = None
) -> Recording:
    """Return the recording with other motor commands between its rows, and its command link with them.

    Args:
        recording: the recording.
        table: the flight that it was read from.
        vehicle: the vehicle as its file describes it.
        rows: the motor commands.
        firmware: see `read_recording`.
    """
    link = (
        read_command_link(table, firmware or rate_pid_from_vehicle(vehicle), rows) if recording.command_link else None
    )
    kept = recording.command_link if isinstance(link, Unavailable) else link
    return replace(recording.with_motor_rows(rows), command_link=kept)


def require_rotor_count(table: FlightTable, vehicle: Vehicle) -> None:
    """Raise UsageError for a flight with more or fewer rotors than the vehicle."""
    for name in (name for name in ("rotor_speed", "motor_command") if name in table):
        if (count := table[name].values.shape[1]) != len(vehicle.rotors):
            raise UsageError(
                f"{table.name} has {count} rotors, the vehicle {len(vehicle.rotors)}; give the vehicle "
                "file of this flight"
            )


def _without_copied_odometry(table: FlightTable) -> FlightTable:
    """Return the table without an odometry whose position is a copy of the pose: it holds no information."""
    if "p_vio" not in table or "p_world" not in table:
        return table
    _, of_vio, of_pose = np.intersect1d(table["p_vio"].t, table["p_world"].t, return_indices=True)
    if not len(of_vio) or not np.array_equal(table["p_vio"].values[of_vio], table["p_world"].values[of_pose]):
        return table
    return replace(table, channels={name: samples for name, samples in table.channels.items() if "vio" not in name})


def _common_times(table: FlightTable, present: list[str]) -> np.ndarray:
    """Return uniform times (k,) s at which all present synchronous channels are recorded."""
    fine = grid.uniform_times(table, *present)
    if len(fine) < 2 or fine[-1] - fine[0] < MIN_DURATION_S:
        together = names_with_columns(present)
        if not len(fine):
            raise UsageError(f"{table.name}: {together} were never recorded at the same time; check their clocks")
        raise UsageError(
            f"{table.name}: {together} were recorded together for {fine[-1] - fine[0]:.1f} s, less than "
            f"{MIN_DURATION_S:g} s; fly for longer"
        )
    return fine


def _resampled(table: FlightTable, fine, stride: int) -> dict[str, np.ndarray]:
    """Return the channels at every stride-th of the times `fine` (k,) s, low-passed."""
    values = {name: _thinned(_interpolated(table[name], fine), stride) for name in VECTORS if name in table}
    for name in (name for name in QUATERNIONS if name in table):
        values[name] = geometry.normalize(_thinned(_attitude(table[name], fine), stride))
    return values


def at_times_of_recording(samples: Samples, t) -> np.ndarray:
    """Return a channel (n, k) at the uniform times t (n,) s of a recording, low-passed as the recorded channels."""
    dt = t[1] - t[0]
    stride = max(1, round(samples.rate_hz * dt))
    fine = t[0] + np.arange(stride * (len(t) - 1) + 1) * dt / stride
    return _thinned(grid.at(samples, fine), stride)


def _interpolated(samples: Samples, t) -> np.ndarray:
    """Return a channel at times t; by a cubic spline where its rate is clearly below the rate of t."""
    if samples.rate_hz > NEARLY_AS_FAST / (t[1] - t[0]) or len(samples.t) < MIN_SPLINE_SAMPLES:
        return grid.at(samples, t)
    return CubicSpline(samples.t, samples.values)(np.clip(t, samples.t[0], samples.t[-1]))


def _attitude(samples: Samples, t) -> np.ndarray:
    """Return quaternions (n, 4) at times t, not normalised, without jumps between q and -q."""
    flipped = np.cumsum(np.concatenate([[False], np.sum(samples.values[1:] * samples.values[:-1], axis=1) < 0])) % 2
    return _interpolated(Samples(samples.t, samples.values * np.where(flipped, -1.0, 1.0)[:, None]), t)


def _thinned(values, stride: int) -> np.ndarray:
    """Return every stride-th row of a channel (n, ...) after a raised-cosine window, the same for all channels."""
    if stride == 1:
        return values
    weights = grid.bell(stride)
    columns = values.reshape(len(values), -1).T
    padded = [np.convolve(np.pad(column, stride, mode="edge"), weights, "valid")[::stride] for column in columns]
    return np.stack(padded, axis=-1).reshape(-1, *values.shape[1:])


def _evaluated_controllers(table: FlightTable, vehicle: Vehicle, firmware: RatePid | None) -> dict:
    """Return the fields `command_link`, `rate_loop` and `unavailable` of a recording."""
    found = {
        "command_link": read_command_link(table, firmware or rate_pid_from_vehicle(vehicle)),
        "rate_loop": read_rate_loop_log(table, vehicle),
    }
    unavailable = {name: value for name, value in found.items() if isinstance(value, Unavailable)}
    return {name: None if name in unavailable else value for name, value in found.items()} | {
        "unavailable": unavailable
    }


def _gaps(table: FlightTable, t) -> dict[str, np.ndarray]:
    """Return by intermittent channel where (n,) nothing was recorded for long, including before its first sample."""
    found = {name: ~grid.known(table, [name], t, open_ended=True) for name in INTERMITTENT_CHANNELS if name in table}
    return {name: gap for name, gap in found.items() if gap.any()}


def _require_flight(table: FlightTable, recording: Recording, vehicle: Vehicle, simulated: bool) -> None:
    """Raise UsageError where the recording contradicts itself or holds too little flight."""
    flown_s, moved = np.count_nonzero(recording.good & recording.flown) * recording.dt, True
    if recording.p_world is not None:
        moved = np.linalg.norm(np.ptp(recording.p_world, axis=0)) > CLEARANCE_M
    if not simulated and (flown_s or moved) and (wrong := consistency.contradiction(table, recording, vehicle)):
        raise UsageError(f"{table.name}: {wrong}")
    if not flown_s:
        raise UsageError(
            f"{table.name}: its rotors never lift the vehicle by its file, or never while all channels "
            "were recorded; give a flight, with rotor speeds in rad/s"
        )
    if flown_s < MIN_FLOWN_S:
        raise UsageError(
            f"{table.name}: it flies for only {flown_s:.1f} s while all channels were recorded, less than "
            f"{MIN_FLOWN_S:g} s; fly for longer"
        )


def _with_gates(recording: Recording, table: FlightTable, vehicle: Vehicle, simulated: bool) -> Recording:
    """Return the recording with its gate observations, where images and a pose were recorded."""
    if table.detected_gates is None or not recording.has("p_world", "q_world_body", "gyro_body"):
        return recording
    moving = Moving(recording.p_world, recording.q_world_body, recording.v_world, recording.gyro_body)
    found = associate_gates(table.detected_gates, recording.t, moving, sensor_terms(vehicle))
    stamps = table.detected_gates.t
    dropped = len(stamps) - len(found.t)
    reason = f"{dropped} of {len(stamps)} lie near no gate of the map, near two of them, or jump"
    rejection = (Rejection(float(stamps[0]), float(stamps[-1]), "gates in images", reason),) if dropped else ()
    kept = found if len(found.t) or simulated else None
    return replace(recording, gate_observations=kept, rejections=(*table.rejections, *rejection))

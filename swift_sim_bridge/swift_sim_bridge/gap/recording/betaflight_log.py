"""The log of Betaflight's rate loop, and a replay of the loop with the settings of the vehicle file.

A blackbox holds gyro (after the loop's filters), setpoint, feed-forward and motor commands of each logged pass. The
feed-forward term depends on receiver frames, which the log lacks: both sides of the comparison use the logged one. P, I
and D are replayed by the simulator's own loop, with its limits, relaxation and filters.
"""

from dataclasses import dataclass, replace
from functools import cached_property, partial

import jax
import jax.numpy as jnp
import numpy as np
from scipy import ndimage, signal

from swift_ros.errors import UsageError
from swift_ros.recording.flight_table import FlightTable, Samples
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.flight_controller.configuration.controller_section import controller_from_vehicle
from swift_sim_bridge.flight_controller.configuration.vehicle_profile import profile_from_vehicle
from swift_sim_bridge.flight_controller.rate_loop import filters, loop, mixer
from swift_sim_bridge.gap.recording.unavailable import Unavailable

AXES = ("roll", "pitch", "yaw")
NEEDED = ("gyro_body", "omega_command_body", "motor_command")
NEGLIGIBLE_DEMAND = 5e-4  # of the motors' range: one step of DShot
LIMIT_MARGIN = 2e-3  # of the motors' range: closer to its ends a motor command is clipped
MIN_LOG_HZ = 400.0  # with fewer logged passes the D term, a derivative, is not reproduced
MIN_SHARED_SAMPLES = 0.9  # share of the motor commands with gyro and setpoint at the same time
MAX_REPLAY_HZ = 2000.0  # bounds the replayed passes per second
REFERENCE_REFINEMENTS = (1, 2, 4)  # passes per logged row in reference flights, as factor: a log does not show it
MAX_CLIPPED_S = 0.25  # longest time at a motor's limit over which the throttle is interpolated
SMOOTH_THROTTLE_S = 0.02  # averages the steps of receiver frames and of DShot
INTEGRAL_WINDOW_S = 2.0  # over which rounding errors of the gyro, integrated by the I term, stay small
SETTLING_S = 0.5  # time after which D and the low-pass filters no longer depend on their unknown initial state
CURVE_POINTS = 2001  # samples of the thrust linearisation's curve for its inverse


@dataclass(frozen=True)
class RateLoopLog:
    """n logged passes of a rate loop.

    Attributes:
        t: (n,) s.
        step_s: time between two rows.
        gyro_body: (n, 3) rad/s, filtered.
        setpoint_body: (n, 3) rad/s.
        feedforward: (n, 3) share of the motors' range.
        motors: (n, 4) motor commands, 0..1.
        vehicle: gives the settings with which the motor commands are interpreted.
    """

    t: np.ndarray
    step_s: float
    gyro_body: np.ndarray
    setpoint_body: np.ndarray
    feedforward: np.ndarray
    motors: np.ndarray
    vehicle: Vehicle

    @cached_property
    def profile(self):
        """The loop's profile for the logged signals."""
        return profile_for_log(profile_from_vehicle(self.vehicle))

    @cached_property
    def outputs(self) -> np.ndarray:
        """The mixer's outputs (n, 4), 0..1 of the motors' range, outside of it where a motor is at a limit."""
        profile = self.profile
        share = (self.motors - float(profile.motor_idle)) / (1.0 - float(profile.motor_idle))
        if profile.motor_output_limit is not None:
            share = share / float(profile.motor_output_limit)
        if profile.thrust_linear is not None:
            even = np.linspace(0.0, 1.0, CURVE_POINTS)
            share = np.interp(share, even * (1.0 + float(profile.thrust_linear.amount) * (1.0 - even) ** 2), even)
        return share

    @cached_property
    def unclipped(self) -> np.ndarray:
        """Where (n,) no motor is at an end of its range."""
        return np.all((self.outputs > LIMIT_MARGIN) & (self.outputs < 1.0 - LIMIT_MARGIN), axis=1)

    @cached_property
    def mixer_throttle(self) -> np.ndarray:
        """The throttle (n,) at the mixer's input, 0..1: the mean output; interpolated while a motor is at a limit."""
        window = max(1, round(MAX_CLIPPED_S / self.step_s))
        known = self.unclipped | (ndimage.maximum_filter1d(self.unclipped, window) == 0)
        return np.interp(self.t, self.t[known], self.outputs.mean(axis=1)[known])

    def loop_throttle(self, mixer_throttle) -> np.ndarray:
        """Return the throttle (n,) at the loop's input for a throttle (n,) at the mixer's.

        It is without the firmware's boost, and smooth, because anti-gravity differentiates it. It is zero where all
        motors idle: there the firmware holds the I term at zero.
        """
        count = max(1, round(SMOOTH_THROTTLE_S / self.step_s))
        plain = _unboosted(mixer_throttle, profile_from_vehicle(self.vehicle), self.step_s)
        smooth = ndimage.uniform_filter1d(ndimage.uniform_filter1d(plain, count), count)
        return np.where(self.outputs.max(axis=1) < LIMIT_MARGIN, 0.0, np.clip(smooth, LIMIT_MARGIN, 1.0))

    @cached_property
    def demand(self) -> np.ndarray:
        """The demand (n, 3) of roll, pitch and yaw from the motors' differences, share of their range."""
        signs = mixer.MIX * np.array([1.0, 1.0, float(self.profile.yaw_direction)])[:, None]
        return self.outputs @ signs.T / len(signs.T)

    @cached_property
    def observable(self) -> np.ndarray:
        """Where (n,) the motors show the demand: no motor and no axis at a limit, and the filters settled."""
        limit = np.asarray(self.profile.pidsum_limit) / mixer.PID_MIXER_SCALING
        within_limit = np.all(np.abs(self.demand) < limit - LIMIT_MARGIN, axis=1)
        since = self.t - self.t[np.maximum.accumulate(np.where(self._segment_begins, np.arange(len(self.t)), 0))]
        return self.unclipped & within_limit & (since >= SETTLING_S)

    @cached_property
    def _segment_begins(self) -> np.ndarray:
        """Where (n,) a part of the log without gap begins."""
        return np.diff(self.t, prepend=-np.inf) > 1.5 * self.step_s

    def residual(self, vehicles) -> np.ndarray:
        """Return logged minus replayed demand (b, n, 3) with the settings of each of b vehicles.

        Both are without their mean over INTEGRAL_WINDOW_S: the initial value of the I term is unknown, and the
        smallest error in its input grows with time. Zero where the demand is not observable.
        """
        return self._without_mean(self.demand - self.replayed(vehicles))

    def correlation(self) -> np.ndarray:
        """Return the correlation (3,), -1..1, of logged and replayed demand with the settings of the file."""
        both = np.stack([self.demand, self.replayed([self.vehicle])[0]])
        logged, replayed = self._without_mean(both)[:, self.observable]
        return np.sum(logged * replayed, axis=0) / np.maximum(
            np.linalg.norm(logged, axis=0) * np.linalg.norm(replayed, axis=0), 1e-12
        )

    def _without_mean(self, values) -> np.ndarray:
        """Return values (b, n, 3) minus their moving mean, zero where the demand is not observable."""
        centred = np.where(self.observable[:, None], values, 0.0)
        size = round(INTEGRAL_WINDOW_S / self.step_s)
        for rows in np.split(np.arange(len(self.t)), np.flatnonzero(self._segment_begins)[1:]):
            observable, mean = self.observable[rows, None], partial(ndimage.uniform_filter1d, size=size)
            share = np.maximum(mean(observable.astype(float), axis=0), 1e-9)
            centred[:, rows] -= np.where(observable, mean(centred[:, rows], axis=1) / share, 0.0)
        return centred

    def replayed(self, vehicles, gyro_body=None, mixer_throttle=None, refinement: int = 1) -> np.ndarray:
        """Return the demand (b, n, 3) of the loop with the settings of each of b vehicles.

        Args:
            vehicles: the vehicles.
            gyro_body: (n, 3) rad/s in place of the logged gyro.
            mixer_throttle: (n,) in place of the logged throttle.
            refinement: factor on the number of passes between two rows.
        """
        profiles = [profile_for_log(profile_from_vehicle(vehicle)) for vehicle in vehicles]
        stacked = {name: jnp.stack([getattr(profile, name) for profile in profiles]) for name in ("kp", "ki", "kd")}
        gyro = self.gyro_body if gyro_body is None else gyro_body
        throttle = self.loop_throttle(self.mixer_throttle if mixer_throttle is None else mixer_throttle)
        inputs = (self.setpoint_body, gyro, throttle, self.feedforward * mixer.PID_MIXER_SCALING)
        loop_hz = min(profiles[0].loop_hz or MAX_REPLAY_HZ, MAX_REPLAY_HZ)
        passes = refinement * max(1, round(loop_hz * self.step_s))
        pid_sum = _replay(replace(profiles[0], **stacked), tuple(map(jnp.asarray, inputs)), passes, self.step_s)
        return np.moveaxis(np.asarray(pid_sum), 1, 0) / mixer.PID_MIXER_SCALING

    def simulate_motors(self, throttle_share, rng) -> np.ndarray:
        """Return the motor commands (n, 4) of a reference flight: a loop with the file's settings.

        The gyro is the logged one plus its rounding error. The number of passes between two rows is drawn.

        Args:
            throttle_share: (n,) relative change of the throttle.
            rng: random generator.
        """
        gyro = self.gyro_body + resolution(self.gyro_body) * (rng.random(self.gyro_body.shape) - 0.5)
        throttle = np.clip(self.mixer_throttle * (1.0 + throttle_share), 0.0, 1.0)
        refinement = int(rng.choice(REFERENCE_REFINEMENTS))
        demand = self.replayed([self.vehicle], gyro, throttle, refinement)[0] * mixer.PID_MIXER_SCALING
        motors = np.asarray(mixer.mix(jnp.asarray(demand), jnp.asarray(throttle), self.profile)[0])
        step = resolution(self.motors)
        return np.clip(np.round(motors / step) * step if step else motors, 0.0, 1.0)


def _unboosted(throttle, profile, step_s: float) -> np.ndarray:
    """Return the stick's throttle (n,) for the mixer's throttle (n,): the inverse of `throttle_path.pass_throttle`."""
    if profile.thrust_linear is not None:
        amount, even = float(profile.thrust_linear.amount), np.linspace(0.0, 1.0, CURVE_POINTS)
        linearised = even / (1.0 + (amount - 0.5 * amount * amount) * (1.0 - even) ** 2)
        throttle = np.interp(throttle, linearised, even)
    if profile.throttle_boost is not None:
        gain = float(profile.throttle_boost.gain)
        share = float(filters.pt1_gain(profile.throttle_boost.cutoff_hz, step_s))
        numerator = np.array([1.0, share - 1.0])
        denominator = np.array([1.0 + gain - gain * share, (1.0 + gain) * (share - 1.0)])
        initial = signal.lfilter_zi(numerator, denominator) * throttle[0]
        throttle, _ = signal.lfilter(numerator, denominator, throttle, zi=initial)
    return throttle


def with_pid_gains(vehicle: Vehicle) -> Vehicle:
    """Return the vehicle with the P, I and D gains of its Betaflight dump as parameters that can change."""
    if "dump" not in vehicle.controller or "pid" in vehicle.controller:
        return vehicle
    gains = {axis: list(values) for axis, values in vars(controller_from_vehicle(vehicle).pid).items()}
    return replace(vehicle, controller={**vehicle.controller, "pid": gains})


def profile_for_log(profile):
    """Return a loop's profile without the stages before a log's signals: gyro filters, setpoint smoothing, throttle."""
    return replace(
        profile,
        gyro_filters=(),
        rpm_filter=None,
        dynamic_notch=None,
        smoothing=None,
        setpoint_slew=None,
        airmode=None,
        throttle_limit=None,
        throttle_boost=None,
        sag_compensation=None,
        watch_runaway=True,
        serial_phase_s=0.0,
    )


def resolution(values) -> float:
    """Return the step in which a channel (n, k) was written, zero where it was not rounded."""
    steps = np.diff(np.unique(np.round(values, 9)))
    step = float(steps.min()) if len(steps) else 0.0
    return step if np.allclose(steps / step, np.round(steps / step), atol=0.02) and step > 1e-7 else 0.0


@partial(jax.jit, static_argnames=("passes", "step_s"))
def _replay(profile, inputs, passes: int, step_s: float):
    """Return the sums of P, I, D and feed-forward (n, b, 3) in PID units."""
    shape = profile.kp.shape
    start = loop.initial_loop_state(jnp.zeros(shape), profile)
    before = tuple(jnp.concatenate([part[:1], part[:-1]]) for part in inputs)

    def step(state, now):
        for number in range(1, passes + 1):
            setpoint, gyro, throttle, feedforward = (
                jnp.broadcast_to(old + (new - old) * (number / passes), (shape[0], *new.shape))
                for old, new in zip(*now, strict=True)
            )
            if profile.feedforward is not None:  # with a minimum of D, the feed-forward raises D
                unscaled = feedforward / jnp.maximum(profile.feedforward.gain, 1e-9)
                state.terms["smooth_feedforward"] = (unscaled,) * 3
            measured = loop.LoopInput(setpoint, throttle, gyro)
            state, _ = loop.rate_loop_step(state, measured, profile, step_s / passes)
        pid_sum = state.terms["pid_sum"]
        return state, pid_sum if profile.feedforward is not None else pid_sum + feedforward

    return jax.lax.scan(step, start, (before, inputs))[1]


def read_rate_loop_log(table: FlightTable, vehicle: Vehicle) -> RateLoopLog | Unavailable:
    """Return the log of a flight controller's rate loop, or why it cannot be evaluated."""
    if missing := [name for name in NEEDED if name not in table]:
        return Unavailable(missing=tuple(missing))
    if vehicle.controller.get("type") != "betaflight":
        return Unavailable("the flight controller's loop is not Betaflight's")
    if "p_world" in table:
        return Unavailable("only a flight controller's own log shows it, without a pose; diagnose that log alone")
    try:
        profile = profile_from_vehicle(vehicle)
    except UsageError as error:
        return Unavailable(str(error))
    motors, gyro, setpoint = (table[name] for name in ("motor_command", "gyro_body", "omega_command_body"))
    if motors.values.shape[1] != mixer.MIX.shape[1]:
        return Unavailable(f"only the mixer of a quad X is replayed, not one of {motors.values.shape[1]} motors")
    if motors.rate_hz < MIN_LOG_HZ:
        return Unavailable(
            f"motor commands come at {motors.rate_hz:.0f} Hz, below {MIN_LOG_HZ:.0f}; log more of the loop's passes"
        )
    t, rows = _shared_times(motors, gyro, setpoint)
    if len(t) < MIN_SHARED_SAMPLES * len(motors.t):
        return Unavailable("gyro, setpoint and motor commands are not recorded at the same times")
    if reason := _not_invertible(profile, "feedforward_body" in table):
        return Unavailable(reason)
    feedforward = np.zeros((len(t), 3))
    if "feedforward_body" in table:
        logged = table["feedforward_body"]
        feedforward = np.stack([np.interp(t, logged.t, column) for column in logged.values.T], axis=-1)
    found = RateLoopLog(
        t=t,
        step_s=1.0 / motors.rate_hz,
        gyro_body=gyro.values[rows[1]],
        setpoint_body=setpoint.values[rows[2]],
        feedforward=feedforward,
        motors=motors.values[rows[0]],
        vehicle=vehicle,
    )
    if not found.observable.any():
        return Unavailable("a motor stands at its end, or an axis at its limit, all the time")
    return found


def _shared_times(*channels: Samples) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return the times (n,) s that all channels have, and the row (n,) of each channel there."""
    stamps = [np.round(channel.t, 6) for channel in channels]
    t = stamps[0]
    for other in stamps[1:]:
        t = np.intersect1d(t, other)
    return t, [np.searchsorted(times, t) for times in stamps]


def _not_invertible(profile, feedforward_logged: bool) -> str:
    """Return why the motor commands do not determine the demand of a loop with this profile, empty if they do."""
    if profile.sag_compensation is not None:
        return "voltage compensation (vbat_sag_compensation) changes the motors' range, which is not replayed"
    if profile.mixer_type == "DYNAMIC" or (profile.airmode is not None and not profile.airmode.enabled):
        return "without airmode, or with the mixer DYNAMIC, the motors do not show the demand of the rate loop"
    if profile.feedforward is not None and not feedforward_logged:
        return "feed-forward is on and was not logged (blackbox_disable_pids = OFF logs it)"
    return ""

"""What Betaflight's rate loop asked of the motors, by its own log, against what the file's settings make of the same
gyro and setpoint. Pure.

A blackbox has gyro (as the loop filtered it), setpoint, feed-forward and motors of one pass. Feed-forward is made of
receiver frames, which a log lacks: it is taken as logged on both sides. P, I and D are replayed by the simulator's own
loop, with its limits, relaxation and filters.
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

AXES = ("roll", "pitch", "yaw")
LEAST = 5e-4  # of the motors' range: a step of DShot, for which nobody cares
EDGE = 2e-3  # of the motors' range: nearer to its ends a motor tells no more what was asked
SLOWEST_HZ = 400.0  # of a log, for D to be what it was
PASSES_HZ, FINER = 2000.0, (1, 2, 4)  # passes a second to replay at most; times as many as a twin may have
MOMENT_S = 0.25  # for which a motor may stand at an end, and the throttle is that of before and after
SMOOTH_S = 0.02  # of throttle, which comes in the steps of receiver frames and of DShot
AROUND_S = 2.0  # over which an I term that is summed from rounded numbers does not yet run away
FORGOTTEN_S = 0.5  # after which D and the low-passes have forgotten how they began
NEEDED = ("gyro_body", "omega_command_body", "motor_command")


@dataclass(frozen=True)
class RateLoopLog:
    """Passes of a rate loop, step_s apart: t (n,) s; gyro_body, setpoint_body (n, 3) rad/s; feedforward (n, 3) and
    motors (n, 4), share of the motors' range; vehicle: by whose settings the motors are read."""

    t: np.ndarray
    step_s: float
    gyro_body: np.ndarray
    setpoint_body: np.ndarray
    feedforward: np.ndarray
    motors: np.ndarray
    vehicle: Vehicle

    @cached_property
    def profile(self):
        return given(profile_from_vehicle(self.vehicle))

    @cached_property
    def outputs(self) -> np.ndarray:
        """What the mixer gave (n, 4), 0..1 of the motors' range, beyond it where a motor stands at an end."""
        profile = self.profile
        share = (self.motors - float(profile.motor_idle)) / (1.0 - float(profile.motor_idle))
        if profile.motor_output_limit is not None:
            share = share / float(profile.motor_output_limit)
        if profile.thrust_linear is not None:
            even = np.linspace(0.0, 1.0, 2001)
            share = np.interp(share, even * (1.0 + float(profile.thrust_linear.amount) * (1.0 - even) ** 2), even)
        return share

    @cached_property
    def inside(self) -> np.ndarray:
        """Where (n,) no motor stands at an end of its range."""
        return np.all((self.outputs > EDGE) & (self.outputs < 1.0 - EDGE), axis=1)

    @cached_property
    def mixed(self) -> np.ndarray:
        """The throttle (n,) that went to the mixer, 0..1: what the motors have in common, over moments in which one of
        them stands at an end as before and after."""
        known = self.inside | (ndimage.maximum_filter1d(self.inside, max(1, round(MOMENT_S / self.step_s))) == 0)
        return np.interp(self.t, self.t[known], self.outputs.mean(axis=1)[known])

    def throttle(self, mixed) -> np.ndarray:
        """Return the throttle (n,) that the loop flew where this one (n,) went to the mixer: without the firmware's
        boost, and smooth, as anti-gravity takes its derivative; zero where all motors idle: then the I term is held at
        zero."""
        count = max(1, round(SMOOTH_S / self.step_s))
        plain = _unboosted(mixed, profile_from_vehicle(self.vehicle), self.step_s)
        smooth = ndimage.uniform_filter1d(ndimage.uniform_filter1d(plain, count), count)
        return np.where(self.outputs.max(axis=1) < EDGE, 0.0, np.clip(smooth, EDGE, 1.0))

    @cached_property
    def demand(self) -> np.ndarray:
        """What the motors' differences were (n, 3), roll, pitch and yaw, share of their range."""
        signs = mixer.MIX * np.array([1.0, 1.0, float(self.profile.yaw_direction)])[:, None]
        return self.outputs @ signs.T / len(signs.T)

    @cached_property
    def told(self) -> np.ndarray:
        """Where (n,) the motors tell the demand: none at an end, no axis at its limit, the filters settled."""
        limit = np.asarray(self.profile.pidsum_limit) / mixer.PID_MIXER_SCALING
        free = np.all(np.abs(self.demand) < limit - EDGE, axis=1)
        since = self.t - self.t[np.maximum.accumulate(np.where(self._begins, np.arange(len(self.t)), 0))]
        return self.inside & free & (since >= FORGOTTEN_S)

    @cached_property
    def _begins(self) -> np.ndarray:
        return np.diff(self.t, prepend=-np.inf) > 1.5 * self.step_s

    def residual(self, vehicles) -> np.ndarray:
        """Return logged less replayed demand (b, n, 3) by the settings of each vehicle, zero where nothing tells.

        Both without their mean over the seconds around: what the I term had summed before is not known, and the least
        error of what it sums grows with time.
        """
        return self._without_mean(self.demand - self.replayed(vehicles))

    def agreement(self) -> np.ndarray:
        """Return how logged and replayed demand go together (3,), -1..1, by the settings of the file."""
        logged, replayed = self._without_mean(np.stack([self.demand, self.replayed([self.vehicle])[0]]))[:, self.told]
        return np.sum(logged * replayed, axis=0) / np.maximum(
            np.linalg.norm(logged, axis=0) * np.linalg.norm(replayed, axis=0), 1e-12
        )

    def _without_mean(self, values) -> np.ndarray:
        """Return values (b, n, 3) less their mean over the seconds around, zero where nothing tells."""
        apart = np.where(self.told[:, None], values, 0.0)
        for part in np.split(np.arange(len(self.t)), np.flatnonzero(self._begins)[1:]):
            told, around = self.told[part, None], partial(ndimage.uniform_filter1d, size=round(AROUND_S / self.step_s))
            share = np.maximum(around(told.astype(float), axis=0), 1e-9)
            apart[:, part] -= np.where(told, around(apart[:, part], axis=1) / share, 0.0)
        return apart

    def replayed(self, vehicles, gyro_body=None, mixed=None, finer: int = 1) -> np.ndarray:
        """Return the demand (b, n, 3) that the loop makes of gyro and setpoint by the settings of each vehicle;
        gyro_body (n, 3) rad/s, mixed (n,): another gyro and throttle than the log's; finer: times as many passes."""
        profiles = [given(profile_from_vehicle(one)) for one in vehicles]
        stacked = {name: jnp.stack([getattr(one, name) for one in profiles]) for name in ("kp", "ki", "kd")}
        gyro = self.gyro_body if gyro_body is None else gyro_body
        throttle = self.throttle(self.mixed if mixed is None else mixed)
        inputs = (self.setpoint_body, gyro, throttle, self.feedforward * mixer.PID_MIXER_SCALING)
        passes = finer * max(1, round(min(profiles[0].loop_hz or PASSES_HZ, PASSES_HZ) * self.step_s))
        pid_sum = _replay(replace(profiles[0], **stacked), tuple(map(jnp.asarray, inputs)), passes, self.step_s)
        return np.moveaxis(np.asarray(pid_sum), 1, 0) / mixer.PID_MIXER_SCALING

    def twin(self, throttle_share, rng) -> np.ndarray:
        """Return the motors (n, 4) of a loop with the file's settings and a gyro that the log rounds to what it holds;
        throttle_share (n,): by how much it flies with more throttle. How often a loop passes between two rows, no log
        tells: each twin's does as often as may be."""
        gyro = self.gyro_body + rounding(self.gyro_body) * (rng.random(self.gyro_body.shape) - 0.5)
        mixed = np.clip(self.mixed * (1.0 + throttle_share), 0.0, 1.0)
        demand = self.replayed([self.vehicle], gyro, mixed, int(rng.choice(FINER)))[0] * mixer.PID_MIXER_SCALING
        motors = np.asarray(mixer.mix(jnp.asarray(demand), jnp.asarray(mixed), self.profile)[0])
        step = rounding(self.motors)
        return np.clip(np.round(motors / step) * step if step else motors, 0.0, 1.0)


def _unboosted(throttle, profile, step_s: float) -> np.ndarray:
    """Return the throttle (n,) of the stick, of the one (n,) that went to the mixer (`throttle_path.pass_throttle`)."""
    if profile.thrust_linear is not None:
        amount, even = float(profile.thrust_linear.amount), np.linspace(0.0, 1.0, 2001)
        bent = even / (1.0 + (amount - 0.5 * amount * amount) * (1.0 - even) ** 2)
        throttle = np.interp(throttle, bent, even)
    if profile.throttle_boost is not None:
        gain = float(profile.throttle_boost.gain)
        share = float(filters.pt1_gain(profile.throttle_boost.cutoff_hz, step_s))
        above, below = np.array([1.0, share - 1.0]), np.array([1.0 + gain - gain * share, (1.0 + gain) * (share - 1.0)])
        throttle, _ = signal.lfilter(above, below, throttle, zi=signal.lfilter_zi(above, below) * throttle[0])
    return throttle


def with_pid_gains(vehicle: Vehicle) -> Vehicle:
    """Return the vehicle with P, I and D of its Betaflight beside the dump that tells them, where they can change."""
    if "dump" not in vehicle.controller or "pid" in vehicle.controller:
        return vehicle
    gains = {axis: list(values) for axis, values in vars(controller_from_vehicle(vehicle).pid).items()}
    return replace(vehicle, controller={**vehicle.controller, "pid": gains})


def given(profile):
    """Return a loop's profile for what a log has behind it already: filtered gyro, smoothed setpoint, throttle."""
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


def rounding(values) -> float:
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
            setpoint, gyro, throttle, ahead = (
                jnp.broadcast_to(old + (new - old) * (number / passes), (shape[0], *new.shape))
                for old, new in zip(*now, strict=True)
            )
            if profile.feedforward is not None:  # D looks ahead by it, where D has a minimum
                own = ahead / jnp.maximum(profile.feedforward.gain, 1e-9)
                state.terms["smooth_feedforward"] = (own,) * 3
            measured = loop.LoopInput(setpoint, throttle, gyro)
            state, _ = loop.rate_loop_step(state, measured, profile, step_s / passes)
        pid_sum = state.terms["pid_sum"]
        return state, pid_sum if profile.feedforward is not None else pid_sum + ahead

    return jax.lax.scan(step, start, (before, inputs))[1]


def read_rate_loop_log(table: FlightTable, vehicle: Vehicle) -> RateLoopLog | str:
    """Return what a flight controller's own log tells of its rate loop, or why it tells nothing."""
    missing = [name for name in NEEDED if name not in table]
    if missing:
        return f"the recording lacks {', '.join(missing)}"
    if vehicle.controller.get("type") != "betaflight":
        return "the flight controller's loop is not Betaflight's"
    if "p_world" in table:
        return "only a flight controller's own log tells it, without a pose; diagnose that alone"
    try:
        profile = profile_from_vehicle(vehicle)
    except UsageError as error:
        return str(error)
    motors, gyro, setpoint = (table[name] for name in ("motor_command", "gyro_body", "omega_command_body"))
    if motors.values.shape[1] != mixer.MIX.shape[1]:
        return f"the mixer of {motors.values.shape[1]} motors is not replayed, that of a quad X alone is"
    if motors.rate_hz < SLOWEST_HZ:
        return f"motor commands come at {motors.rate_hz:.0f} Hz, below {SLOWEST_HZ:.0f}; log more of the loop's passes"
    t, rows = _shared(motors, gyro, setpoint)
    if len(t) < 0.9 * len(motors.t):
        return "gyro, setpoint and motor commands are not recorded at the same times"
    if wrong := _unread(profile, "feedforward_body" in table):
        return wrong
    feedforward = np.zeros((len(t), 3))
    if "feedforward_body" in table:
        told = table["feedforward_body"]
        feedforward = np.stack([np.interp(t, told.t, column) for column in told.values.T], axis=-1)
    found = RateLoopLog(
        t,
        1.0 / motors.rate_hz,
        gyro.values[rows[1]],
        setpoint.values[rows[2]],
        feedforward,
        motors.values[rows[0]],
        vehicle,
    )
    return found if found.told.any() else "a motor stands at its end, or an axis at its limit, all the time"


def _shared(*channels: Samples) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return the times (n,) s that all channels have, and the row (n,) of each channel there."""
    stamps = [np.round(one.t, 6) for one in channels]
    t = stamps[0]
    for other in stamps[1:]:
        t = np.intersect1d(t, other)
    return t, [np.searchsorted(one, t) for one in stamps]


def _unread(profile, logged: bool) -> str:
    """Return why the motors do not tell the demand of a loop with this profile, nothing if they do; logged: whether
    feed-forward is."""
    if profile.sag_compensation is not None:
        return "voltage compensation (vbat_sag_compensation) changes the motors' range, which is not replayed"
    if profile.mixer_type == "DYNAMIC" or (profile.airmode is not None and not profile.airmode.enabled):
        return "without airmode, or with the mixer DYNAMIC, the motors do not tell what was asked of them"
    if profile.feedforward is not None and not logged:
        return "feed-forward is on and was not logged (blackbox_disable_pids = OFF logs it)"
    return ""

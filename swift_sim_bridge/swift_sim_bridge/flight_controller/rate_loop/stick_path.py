"""From receiver frames to what each pass of the rate loop flies: smoothing, feed-forward, the latch of airmode.

Betaflight 4.5, rc.c (`updateRcRefreshRate`, `processRcSmoothingFilter`, `calculateFeedforward`), core.c (`processRx`),
pid.c (`accelerationLimit`). Setpoints in deg/s; a frame is taken once, smoothing runs every pass.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import jax.numpy as jnp

from swift_sim_bridge.flight_controller.rate_loop import filters

HALF_TRAVEL_US = 500.0
FRAMES_HZ = 100.0  # the rate at which MSP brings sticks
INTERVAL_MIN_S, INTERVAL_MAX_S = 0.00095, 0.0655
SLOWEST_SMOOTHING_HZ = 15.0
RATE_GAIN = 0.1  # of the low-pass, a step a frame, on the rate of the frames
CUTOFF_FRAMES = 4  # from one look at the cutoffs to the next


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Smoothing:
    """Cutoffs of the PT3s on setpoint, throttle and feed-forward: cutoff_hz (..., 3) with frames at FRAMES_HZ;
    share (..., 3): what they are of the rate of the frames, 0 where they do not follow it."""

    cutoff_hz: jax.Array
    share: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Feedforward:
    """gain (..., 3) on deg/s^2; smooth, jitter, boost, transition, max_rate_limit (...): as the firmware uses them, the
    first the share kept; max_rate (..., 3) deg/s at full stick; averaging: frames."""

    gain: jax.Array
    smooth: jax.Array
    jitter: jax.Array
    boost: jax.Array
    transition: jax.Array
    max_rate_limit: jax.Array
    max_rate: jax.Array
    averaging: int = field(default=1, metadata={"static": True})


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Airmode:
    """start (...): throttle 0..1 from which the I term runs with the throttle closed too; enabled: by feature."""

    start: jax.Array
    enabled: bool = field(default=True, metadata={"static": True})


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Sticks:
    """The stick positions from which a setpoint was computed.

    Attributes:
        deflection: (..., 3), -1 to 1, FLU.
        levelled: (...) bool, angle mode is on.
    """

    deflection: jax.Array
    levelled: jax.Array


class ReceiverFrame(NamedTuple):
    """One command of the receiver, as the flight controller decodes it.

    Attributes:
        setpoint_omega_body: (..., 3) rad/s, FLU.
        throttle: (...), 0 (closed) to 1.
        armed: (...) bool; disarmed motors stop.
        sticks: stick positions of the setpoint; None where they are unknown: the rate curves then count as straight
            lines, which matters for jitter reduction and feed-forward transition alone.
        interval_s: (...) s since the previous frame; None: the interval of FRAMES_HZ.
    """

    setpoint_omega_body: jax.Array
    throttle: jax.Array
    armed: jax.Array
    sticks: Sticks | None = None
    interval_s: jax.Array | None = None


def at_rest(profile, zero) -> dict:
    """Return the memory (by name) of the terms that `profile` has; `zero` (..., 3) gives shape and type."""
    memory, scalar = {}, zero[..., 0]
    if profile.smoothing is not None:
        memory |= {"smooth_setpoint": (zero,) * 3, "smooth_throttle": (zero[..., :1],) * 3}
        pace = {"interval_s": scalar + 1.0 / FRAMES_HZ, "rate_hz": scalar + FRAMES_HZ, "frames": scalar}
        memory["pace"] = pace | {"cutoff_hz": zero + profile.smoothing.cutoff_hz}
    if profile.feedforward is not None:
        names = ("deflection", "setpoint", "speed", "acceleration", "change_us")
        frame = dict.fromkeys(names, zero) | {"duplicate": zero > 0, "count": scalar}
        frame["interval_s"] = scalar + 1.0 / FRAMES_HZ
        frame["recent"] = jnp.zeros((*zero.shape, profile.feedforward.averaging), zero.dtype)
        memory |= {"frame": frame, "feedforward": zero, "smooth_feedforward": (zero,) * 3}
    if profile.airmode is not None:
        memory |= {"airmode": scalar > 0, "airborne": scalar > 0, "levelled": scalar > 0}
    if profile.setpoint_slew is not None:
        memory |= {"slewed": zero}
    return memory


def take_frame(memory: dict, frame: ReceiverFrame, setpoint, profile) -> dict:
    """Return the memory after a receiver frame; `setpoint` (..., 3) is the frame's setpoint in deg/s."""
    sticks = frame.sticks
    memory, scalar = dict(memory), jnp.zeros_like(setpoint[..., 0])
    interval_s = scalar + (1.0 / FRAMES_HZ if frame.interval_s is None else frame.interval_s)
    if profile.smoothing is not None:
        memory["pace"] = _paced(memory["pace"], interval_s, profile.smoothing)
    if profile.airmode is not None:
        latched = memory["airmode"] | (frame.throttle >= profile.airmode.start)
        memory["airmode"] = latched & frame.armed if profile.airmode.enabled else memory["airmode"]
        memory["airborne"] = frame.armed & (memory["airmode"] | (frame.throttle > 0))
        if sticks is not None:
            memory["levelled"] = sticks.levelled
    if profile.feedforward is not None:
        term = profile.feedforward
        deflection = setpoint / term.max_rate if sticks is None else sticks.deflection
        interval_s = jnp.clip(interval_s, INTERVAL_MIN_S, INTERVAL_MAX_S)
        memory["frame"], feedforward = _feedforward(memory["frame"], setpoint, deflection, interval_s, term)
        if sticks is not None:
            feedforward = jnp.where(sticks.levelled[..., None] & (jnp.arange(3) < 2), 0.0, feedforward)
        memory["feedforward"] = feedforward
    return memory


def _paced(pace: dict, interval_s, term: Smoothing) -> dict:
    """Return the memory of the frames' rate after an interval (...) s: the filters follow it, in whole Hz.

    Neither a break in the frames nor an interval about twice the last counts.
    """
    valid = (interval_s >= INTERVAL_MIN_S) & (interval_s <= INTERVAL_MAX_S)
    counts = valid & (jnp.abs(interval_s - pace["interval_s"]) < 0.875 * pace["interval_s"])
    rate_hz = pace["rate_hz"] + jnp.where(counts, RATE_GAIN * (1.0 / interval_s - pace["rate_hz"]), 0.0)
    due = counts & (pace["frames"] == 0)
    wanted = jnp.maximum(SLOWEST_SMOOTHING_HZ, jnp.floor(rate_hz[..., None] * term.share))
    wanted = jnp.where((term.share > 0) & due[..., None], wanted, pace["cutoff_hz"])
    # rc.c: the throttle's filter is looked at with the setpoint's alone.
    fixed = (wanted[..., :1] == pace["cutoff_hz"][..., :1]) & (jnp.arange(3) == 1)
    return {
        "interval_s": jnp.where(valid, interval_s, pace["interval_s"]),
        "rate_hz": rate_hz,
        "frames": jnp.where(valid, jnp.where(counts, (pace["frames"] + 1) % CUTOFF_FRAMES, pace["frames"]), 0.0),
        "cutoff_hz": jnp.where(fixed, pace["cutoff_hz"], wanted),
    }


def _feedforward(frame: dict, setpoint, deflection, interval_s, term: Feedforward):
    """Return (memory, feed-forward (..., 3) deg/s^2) of a frame: speed and acceleration of the setpoint, attenuated."""
    rate = 1.0 / interval_s[..., None]
    # rc.c: roll, the first axis, overwrites the interval before; pitch and yaw find the new one in its place.
    slower = 1.0 / (interval_s[..., None] + jnp.stack([frame["interval_s"], interval_s, interval_s], axis=-1))
    smooth, boost = term.smooth[..., None], term.boost[..., None]
    change_us = HALF_TRAVEL_US * jnp.abs(deflection - frame["deflection"])
    calm = jnp.maximum(1.0 - (change_us + frame["change_us"]) / (2.0 * jnp.maximum(term.jitter, 1e-6)[..., None]), 0.0)
    steady = jnp.where(change_us < term.jitter[..., None], 1.0 - calm * calm, 1.0)

    moved, repeated = change_us > 0, frame["duplicate"]
    rate = jnp.where(moved & repeated, slower, rate)
    onward = frame["speed"] + jnp.where(jnp.abs(setpoint) < 0.95 * term.max_rate, frame["acceleration"], 0.0)
    speed = jnp.where(moved, (setpoint - frame["setpoint"]) * rate, jnp.where(repeated, 0.0, onward))
    before = jnp.where(~moved & repeated, 0.0, frame["speed"])
    bend = jnp.where(moved & ~repeated, 1.0, 0.0)

    speed = before + smooth * (speed - before)
    acceleration = (speed - before) * rate * 0.01
    acceleration = frame["acceleration"] + smooth * (acceleration - frame["acceleration"])
    total = speed + acceleration * boost * steady * bend

    transition = term.transition[..., None]
    share = jnp.abs(deflection) / jnp.maximum(transition, 1e-6)
    total = jnp.where(jnp.abs(deflection) < transition, total * share, total)
    recent = jnp.concatenate([total[..., None], frame["recent"][..., :-1]], axis=-1)
    count = jnp.minimum(frame["count"] + 1.0, term.averaging)
    total = jnp.sum(recent, axis=-1) / count[..., None] * steady

    limit = jnp.maximum((term.max_rate - jnp.abs(setpoint)) * term.max_rate_limit[..., None], 0.0)
    limited = (total * setpoint > 0) & (term.max_rate_limit[..., None] > 0) & (jnp.arange(3) < 2)
    total = jnp.where(limited, jnp.clip(total, -limit, limit), total)
    kept = {
        "deflection": deflection,
        "setpoint": setpoint,
        "speed": speed,
        "acceleration": acceleration * bend,
        "change_us": change_us,
        "duplicate": ~moved,
        "count": count,
        "recent": recent,
        "interval_s": interval_s,
    }
    return kept, total


def pass_sticks(setpoint, throttle, memory: dict, profile, dt):
    """Return (setpoint (..., 3) deg/s, throttle (...), memory) that one pass flies; where there is feed-forward its
    smoothed value is the last part of `smooth_feedforward`."""
    memory = dict(memory)
    if profile.smoothing is not None:
        cutoff_hz = [memory["pace"]["cutoff_hz"][..., i] for i in range(3)]
        memory["smooth_setpoint"], setpoint = _pt3(memory["smooth_setpoint"], setpoint, cutoff_hz[0], dt)
        memory["smooth_throttle"], smooth = _pt3(memory["smooth_throttle"], throttle[..., None], cutoff_hz[1], dt)
        throttle = smooth[..., 0]
        if profile.feedforward is not None:
            past = memory["smooth_feedforward"]
            memory["smooth_feedforward"], _ = _pt3(past, memory["feedforward"], cutoff_hz[2], dt)
    if profile.setpoint_slew is not None:
        most = profile.setpoint_slew * dt
        slewed = memory["slewed"] + jnp.clip(setpoint - memory["slewed"], -most, most)
        setpoint = memory["slewed"] = jnp.where(most > 0, slewed, setpoint)
    return setpoint, throttle, memory


def _pt3(memory, value, cutoff_hz, dt):
    return filters.chain(memory, value, filters.pt1_gain(cutoff_hz * filters.CUTOFF_CORRECTIONS[3], dt))

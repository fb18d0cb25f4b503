"""From receiver frames to the setpoint of each pass of the rate loop: smoothing, feed-forward, state of airmode.

Setpoints are in deg/s. A frame is processed once; smoothing runs in every pass. Source: Betaflight 4.5, rc.c
(`updateRcRefreshRate`, `processRcSmoothingFilter`, `calculateFeedforward`), core.c (`processRx`), pid.c
(`accelerationLimit`).
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import jax.numpy as jnp

from swift_sim_bridge.flight_controller.rate_loop import filters

HALF_TRAVEL_US = 500.0  # of a stick
FRAMES_HZ = 100.0  # rate of MSP stick frames
INTERVAL_MIN_S, INTERVAL_MAX_S = 0.00095, 0.0655  # between frames; outside, the firmware ignores an interval (rc.c)
SLOWEST_SMOOTHING_HZ = 15.0  # lower bound of a smoothing cutoff (rc.c)
RATE_GAIN = 0.1  # of the low-pass on the frame rate, one step per frame
CUTOFF_FRAMES = 4  # frames between two updates of the cutoffs


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Smoothing:
    """Cutoffs of the PT3 low-passes on setpoint, throttle and feed-forward.

    Attributes:
        cutoff_hz: (..., 3) Hz, for frames at FRAMES_HZ.
        share: (..., 3), ratio of cutoff to frame rate; 0 for a cutoff that does not follow the frame rate.
    """

    cutoff_hz: jax.Array
    share: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Feedforward:
    """Coefficients of feed-forward; see the firmware's `feedforward_*` settings.

    Attributes:
        gain: (..., 3) on deg/s^2.
        smooth: (...), share of a new value in the smoothed one.
        jitter: (...) us, stick movement below which feed-forward is reduced.
        boost: (...) of the setpoint's acceleration.
        transition: (...), deflection below which feed-forward is reduced.
        max_rate_limit: (...), limit of feed-forward near full stick.
        max_rate: (..., 3) deg/s at full stick.
        averaging: number of frames that are averaged.
    """

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
    """Airmode.

    Attributes:
        start: (...), throttle 0 to 1; once exceeded, the I term is active at closed throttle too.
        enabled: whether the feature AIRMODE is on.
    """

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
        memory["pace"] = _frame_rate_memory(memory["pace"], interval_s, profile.smoothing)
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


def _frame_rate_memory(pace: dict, interval_s, term: Smoothing) -> dict:
    """Return the memory of the frame rate after an interval (...) s; the cutoffs follow it in whole Hz.

    A pause, and an interval of about twice the last one, are ignored.
    """
    valid = (interval_s >= INTERVAL_MIN_S) & (interval_s <= INTERVAL_MAX_S)
    accepted = valid & (jnp.abs(interval_s - pace["interval_s"]) < 0.875 * pace["interval_s"])
    rate_hz = pace["rate_hz"] + jnp.where(accepted, RATE_GAIN * (1.0 / interval_s - pace["rate_hz"]), 0.0)
    due = accepted & (pace["frames"] == 0)
    wanted = jnp.maximum(SLOWEST_SMOOTHING_HZ, jnp.floor(rate_hz[..., None] * term.share))
    wanted = jnp.where((term.share > 0) & due[..., None], wanted, pace["cutoff_hz"])
    # rc.c: the throttle's cutoff is updated only when that of the setpoint changes.
    fixed = (wanted[..., :1] == pace["cutoff_hz"][..., :1]) & (jnp.arange(3) == 1)
    return {
        "interval_s": jnp.where(valid, interval_s, pace["interval_s"]),
        "rate_hz": rate_hz,
        "frames": jnp.where(valid, jnp.where(accepted, (pace["frames"] + 1) % CUTOFF_FRAMES, pace["frames"]), 0.0),
        "cutoff_hz": jnp.where(fixed, pace["cutoff_hz"], wanted),
    }


def _feedforward(frame: dict, setpoint, deflection, interval_s, term: Feedforward):
    """Return (memory, feed-forward (..., 3) deg/s^2) of a frame, from the setpoint's speed and acceleration."""
    rate = 1.0 / interval_s[..., None]
    # rc.c: roll, the first axis, overwrites the previous interval; pitch and yaw then use the new one.
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
    new_frame = {
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
    return new_frame, total


def pass_sticks(setpoint, throttle, memory: dict, profile, dt):
    """Return (setpoint (..., 3) deg/s, throttle (...), memory) of one pass.

    With feed-forward, its smoothed value is the last part of the memory's `smooth_feedforward`.
    """
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
        max_change = profile.setpoint_slew * dt
        slewed = memory["slewed"] + jnp.clip(setpoint - memory["slewed"], -max_change, max_change)
        setpoint = memory["slewed"] = jnp.where(max_change > 0, slewed, setpoint)
    return setpoint, throttle, memory


def _pt3(memory, value, cutoff_hz, dt):
    return filters.chain(memory, value, filters.pt1_gain(cutoff_hz * filters.CUTOFF_CORRECTIONS[3], dt))

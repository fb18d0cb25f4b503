"""What the firmware does with the throttle before it mixes, and what the throttle does to gains and filters.

Betaflight 4.5, mixer.c (`mixTable`, `applyThrottleLimit`, `updateDynLpfCutoffs`) and pid.c (`pidUpdateTpaFactor`,
`pidUpdateAntiGravityThrottleFilter`, `pidCompensateThrustLinearization`). A term is a record of its coefficients, None
in the profile where it is off; what it says acts on the next pass of the loop, as in the firmware.
"""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp

from swift_sim_bridge.flight_controller.rate_loop import filters

ANTI_GRAVITY_KI, ANTI_GRAVITY_KP = 0.34, 0.0034  # pid.h
SWEEP_STEPS, SWEEP_PERIOD_S = 100.0, 0.005  # mixer.c: the throttle that moves cutoffs has 100 steps, each 5 ms or more


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ThrottleLimit:
    """share (...): 0..1 of the range; kind: SCALE or CLIP."""

    share: jax.Array
    kind: str = field(metadata={"static": True})


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ThrottleBoost:
    """gain (...): of what passes a high-pass at cutoff_hz (...)."""

    gain: jax.Array
    cutoff_hz: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Tpa:
    """Attenuation of D, or of P and D, by throttle: rate, low_rate (...) 0..1; breakpoint, low_breakpoint (...) 0..1;
    on_p: P too; low_always: the low part returns whenever the throttle does."""

    rate: jax.Array
    breakpoint: jax.Array
    low_rate: jax.Array
    low_breakpoint: jax.Array
    on_p: bool = field(metadata={"static": True})
    low_always: bool = field(metadata={"static": True})


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class AntiGravity:
    """More I and P while the throttle moves: gain, p_gain (...); cutoff_hz (...) of the throttle's derivative."""

    gain: jax.Array
    p_gain: jax.Array
    cutoff_hz: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Sweep:
    """A low-pass whose cutoff the throttle moves from low_hz to high_hz (...), bent by expo (...) 0..10; kind as
    `filters.Lowpass`."""

    low_hz: jax.Array
    high_hz: jax.Array
    expo: jax.Array
    kind: str = field(default="PT1", metadata={"static": True})


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ThrustLinear:
    """amount (...): 0..1.5 of thrust linearisation."""

    amount: jax.Array


def at_rest(profile, zero) -> dict:
    """Return the memory (by name) of the terms that `profile` has; `zero` (...) gives shape and type."""
    memory = {}
    if profile.anti_gravity is not None:
        memory |= {"throttle_before": zero, "anti_gravity": (zero[..., None],) * 2, "anti_gravity_d": zero}
    if profile.tpa is not None:
        memory |= {"tpa": jnp.ones_like(zero), "tpa_faded": zero > 0}
    if profile.throttle_boost is not None:
        memory |= {"boost": (zero[..., None],)}
    if any(isinstance(filter, Sweep) for filter in (*profile.gyro_filters, *profile.dterm_filters)):
        memory |= {"sweep_throttle": zero, "sweep_age_s": zero}
    return memory


def pass_throttle(throttle, memory: dict, profile, dt):
    """Return (throttle (...) to mix with, memory) of one pass for a stick at `throttle` (...) 0..1."""
    throttle = jnp.clip(throttle, 0.0, 1.0)
    limit = profile.throttle_limit
    if limit is not None:
        throttle = throttle * limit.share if limit.kind == "SCALE" else jnp.minimum(throttle, limit.share)
    memory = dict(memory)
    if profile.anti_gravity is not None:
        memory |= _watch_throttle(throttle, memory, profile.anti_gravity, dt)
    if profile.tpa is not None:
        memory["tpa"], memory["tpa_faded"] = _attenuation(throttle, memory["tpa_faded"], profile.tpa)
    if "sweep_throttle" in memory:
        memory |= _sweep(throttle, memory, dt)
    boost = profile.throttle_boost
    if boost is not None:
        memory["boost"], slow = _slow(boost.cutoff_hz, memory["boost"], throttle, dt)
        throttle = jnp.clip(throttle + boost.gain * (throttle - slow), 0.0, 1.0)
    if profile.thrust_linear is not None:
        amount = profile.thrust_linear.amount
        throttle = throttle / (1.0 + (amount - 0.5 * amount * amount) * (1.0 - throttle) ** 2)
    return throttle, memory


def _slow(cutoff_hz, memory, value, dt):
    memory, slow = filters.chain(memory, value[..., None], filters.pt1_gain(cutoff_hz, dt))
    return memory, slow[..., 0]


def _watch_throttle(throttle, memory, term, dt):
    """Return the memory of anti-gravity: how fast the throttle moves, most where it is low."""
    before, rest = memory["throttle_before"], 1.0 - throttle
    derivative = jnp.abs(throttle - before) / dt * rest * rest
    derivative = jnp.where(throttle > before, derivative * rest * 0.5, derivative)
    corrected = term.cutoff_hz * filters.CUTOFF_CORRECTIONS[2]
    state, smooth = _slow(corrected, memory["anti_gravity"], derivative, dt)
    return {"throttle_before": throttle, "anti_gravity": state, "anti_gravity_d": smooth * term.gain}


def _attenuation(throttle, faded, tpa):
    """Return (factor (...) on D, whether the low part is over)."""
    high = tpa.rate / (1.0 - tpa.breakpoint) * jnp.maximum(throttle - tpa.breakpoint, 0.0)
    low = tpa.low_rate / tpa.low_breakpoint * (tpa.low_breakpoint - throttle)
    is_high = (throttle >= tpa.low_breakpoint) | (tpa.low_breakpoint <= 0.01) | faded
    if not tpa.low_always:
        faded = faded | is_high
    return 1.0 - jnp.where(is_high, high, low), faded


def _sweep(throttle, memory, dt):
    stepped = jnp.round(throttle * SWEEP_STEPS) / SWEEP_STEPS
    age_s = memory["sweep_age_s"] + dt
    due = (age_s >= SWEEP_PERIOD_S) & (stepped != memory["sweep_throttle"])
    return {
        "sweep_throttle": jnp.where(due, stepped, memory["sweep_throttle"]),
        "sweep_age_s": jnp.where(due, 0.0, jnp.minimum(age_s, 1.0)),
    }


def swept(all_filters, memory: dict):
    """Return the filters with each Sweep replaced by the low-pass that the throttle has made of it."""
    return tuple(_cut(one, memory["sweep_throttle"]) if isinstance(one, Sweep) else one for one in all_filters)


def _cut(sweep, throttle):
    """As `dynLpfCutoffFreq`, or without expo `dynThrottle`."""
    curve = throttle * (1.0 - throttle) * sweep.expo / 10.0 + throttle
    bent = (sweep.high_hz - sweep.low_hz) * curve + sweep.low_hz
    cubic = throttle * (1.0 - throttle * throttle / 3.0) * 1.5
    cutoff_hz = jnp.where(sweep.expo > 0, bent, jnp.maximum(cubic * sweep.high_hz, sweep.low_hz))
    return filters.Lowpass(cutoff_hz, sweep.kind)

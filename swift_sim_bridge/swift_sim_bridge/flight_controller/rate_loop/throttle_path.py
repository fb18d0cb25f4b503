"""The throttle before the mixer, and the effects of the throttle on gains and filters.

Betaflight 4.5, mixer.c (`mixTable`, `applyThrottleLimit`, `updateDynLpfCutoffs`) and pid.c (`pidUpdateTpaFactor`,
`pidUpdateAntiGravityThrottleFilter`, `pidCompensateThrustLinearization`). A term is a record of its coefficients; in
the profile it is None where it is off. Its result acts in the next pass of the loop, as in the firmware.
"""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp

from swift_sim_bridge.flight_controller.rate_loop import filters

ANTI_GRAVITY_KI, ANTI_GRAVITY_KP = 0.34, 0.0034  # pid.h
SWEEP_STEPS, SWEEP_PERIOD_S = 100.0, 0.005  # mixer.c: cutoffs follow the throttle in 100 steps, every 5 ms at most


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ThrottleLimit:
    """Limit of the throttle.

    Attributes:
        share: (...), 0 to 1 of the range.
        kind: "SCALE" or "CLIP".
    """

    share: jax.Array
    kind: str = field(metadata={"static": True})


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ThrottleBoost:
    """Throttle boost: high-passed throttle is added.

    Attributes:
        gain: (...) of the high-passed throttle.
        cutoff_hz: (...) Hz of the high-pass.
    """

    gain: jax.Array
    cutoff_hz: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Tpa:
    """Throttle PID attenuation.

    Attributes:
        rate: (...), 0 to 1, attenuation at full throttle.
        breakpoint: (...), 0 to 1, throttle above which it begins.
        low_rate: (...), 0 to 1, attenuation at zero throttle.
        low_breakpoint: (...), 0 to 1, throttle below which the low part acts.
        on_p: whether P is attenuated as well as D.
        low_always: whether the low part acts again when the throttle returns below `low_breakpoint`.
    """

    rate: jax.Array
    breakpoint: jax.Array
    low_rate: jax.Array
    low_breakpoint: jax.Array
    on_p: bool = field(metadata={"static": True})
    low_always: bool = field(metadata={"static": True})


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class AntiGravity:
    """Anti-gravity: more I and P while the throttle moves.

    Attributes:
        gain: (...) of I.
        p_gain: (...) of P.
        cutoff_hz: (...) Hz of the low-pass on the throttle's derivative.
    """

    gain: jax.Array
    p_gain: jax.Array
    cutoff_hz: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Sweep:
    """A low-pass whose cutoff follows the throttle.

    Attributes:
        low_hz: (...) Hz at zero throttle.
        high_hz: (...) Hz at full throttle.
        expo: (...), 0 to 10, curvature between the two; 0 for the firmware's cubic.
        kind: as `filters.Lowpass`.
    """

    low_hz: jax.Array
    high_hz: jax.Array
    expo: jax.Array
    kind: str = field(default="PT1", metadata={"static": True})


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ThrustLinear:
    """Thrust linearisation.

    Attributes:
        amount: (...), 0 to 1.5.
    """

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
    """Return (throttle (...) for the mixer, memory) after one pass with stick throttle `throttle` (...), 0 to 1."""
    throttle = jnp.clip(throttle, 0.0, 1.0)
    limit = profile.throttle_limit
    if limit is not None:
        throttle = throttle * limit.share if limit.kind == "SCALE" else jnp.minimum(throttle, limit.share)
    memory = dict(memory)
    if profile.anti_gravity is not None:
        memory |= _anti_gravity_memory(throttle, memory, profile.anti_gravity, dt)
    if profile.tpa is not None:
        memory["tpa"], memory["tpa_faded"] = _attenuation(throttle, memory["tpa_faded"], profile.tpa)
    if "sweep_throttle" in memory:
        memory |= _sweep_memory(throttle, memory, dt)
    boost = profile.throttle_boost
    if boost is not None:
        memory["boost"], slow = _low_passed(boost.cutoff_hz, memory["boost"], throttle, dt)
        throttle = jnp.clip(throttle + boost.gain * (throttle - slow), 0.0, 1.0)
    if profile.thrust_linear is not None:
        amount = profile.thrust_linear.amount
        throttle = throttle / (1.0 + (amount - 0.5 * amount * amount) * (1.0 - throttle) ** 2)
    return throttle, memory


def _low_passed(cutoff_hz, memory, value, dt):
    memory, slow = filters.chain(memory, value[..., None], filters.pt1_gain(cutoff_hz, dt))
    return memory, slow[..., 0]


def _anti_gravity_memory(throttle, memory, term, dt):
    """Return the memory of anti-gravity: the filtered rate of the throttle, weighted more at low throttle."""
    before, rest = memory["throttle_before"], 1.0 - throttle
    derivative = jnp.abs(throttle - before) / dt * rest * rest
    derivative = jnp.where(throttle > before, derivative * rest * 0.5, derivative)
    corrected = term.cutoff_hz * filters.CUTOFF_CORRECTIONS[2]
    state, smooth = _low_passed(corrected, memory["anti_gravity"], derivative, dt)
    return {"throttle_before": throttle, "anti_gravity": state, "anti_gravity_d": smooth * term.gain}


def _attenuation(throttle, faded, tpa):
    """Return (factor (...) on D, whether the low part has ended)."""
    high = tpa.rate / (1.0 - tpa.breakpoint) * jnp.maximum(throttle - tpa.breakpoint, 0.0)
    low = tpa.low_rate / tpa.low_breakpoint * (tpa.low_breakpoint - throttle)
    is_high = (throttle >= tpa.low_breakpoint) | (tpa.low_breakpoint <= 0.01) | faded
    if not tpa.low_always:
        faded = faded | is_high
    return 1.0 - jnp.where(is_high, high, low), faded


def _sweep_memory(throttle, memory, dt):
    """Return the throttle in steps that moves the cutoffs, and its age."""
    stepped = jnp.round(throttle * SWEEP_STEPS) / SWEEP_STEPS
    age_s = memory["sweep_age_s"] + dt
    due = (age_s >= SWEEP_PERIOD_S) & (stepped != memory["sweep_throttle"])
    return {
        "sweep_throttle": jnp.where(due, stepped, memory["sweep_throttle"]),
        "sweep_age_s": jnp.where(due, 0.0, jnp.minimum(age_s, 1.0)),
    }


def lowpasses_of_sweeps(all_filters, memory: dict):
    """Return the filters with each Sweep replaced by its low-pass at the present throttle."""
    return tuple(
        _lowpass_at(each, memory["sweep_throttle"]) if isinstance(each, Sweep) else each for each in all_filters
    )


def _lowpass_at(sweep, throttle):
    """Return the low-pass of a sweep at a throttle (`dynLpfCutoffFreq`, or without expo `dynThrottle`)."""
    curve = throttle * (1.0 - throttle) * sweep.expo / 10.0 + throttle
    bent = (sweep.high_hz - sweep.low_hz) * curve + sweep.low_hz
    cubic = throttle * (1.0 - throttle * throttle / 3.0) * 1.5
    cutoff_hz = jnp.where(sweep.expo > 0, bent, jnp.maximum(cubic * sweep.high_hz, sweep.low_hz))
    return filters.Lowpass(cutoff_hz, sweep.kind)

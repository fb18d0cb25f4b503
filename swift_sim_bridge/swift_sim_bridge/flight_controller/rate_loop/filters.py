"""The firmware's digital filters (Betaflight 4.5, common/filter.c), batchable in JAX.

A filter is a record of its coefficients whose kind is fixed when a pass is traced; its memory is a tuple of arrays
(..., n) like the samples. Coefficients (...) have the batch axes alone.
"""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp

ORDERS = {"PT1": 1, "PT2": 2, "PT3": 3}
CUTOFF_CORRECTIONS = {1: 1.0, 2: 1.553773974, 3: 1.961459177}  # so that a chain of PT1s is down 3 dB at its cutoff
BUTTERWORTH_Q = 0.7071067811865476
TYPES = ("PT1", "BIQUAD", "PT2", "PT3")  # as the firmware numbers them


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Lowpass:
    """cutoff_hz (...), 0 = off for PT1; kind: one of TYPES; corrected: a PT2 or PT3 meets its cutoff with 3 dB."""

    cutoff_hz: jax.Array
    kind: str = field(default="PT1", metadata={"static": True})
    corrected: bool = field(default=True, metadata={"static": True})


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Notch:
    """centre_hz, cutoff_hz (...): of the dip and of its lower edge."""

    centre_hz: jax.Array
    cutoff_hz: jax.Array


def initial_memory(filter, sample) -> tuple:
    """Return the memory of a filter that has seen nothing but zeros, for samples like `sample` (..., n)."""
    order = ORDERS.get(filter.kind, 4) if isinstance(filter, Lowpass) else 4
    return (jnp.zeros_like(sample),) * order


def apply(filter, memory, sample, dt):
    """Return (memory, filtered (..., n)) after one more sample, `dt` s after the last."""
    if isinstance(filter, Notch):
        q = notch_q(filter.centre_hz, filter.cutoff_hz)
        return biquad(memory, sample, notch_coefficients(filter.centre_hz, q, dt))
    if filter.kind == "BIQUAD":
        return biquad(memory, sample, lowpass_coefficients(filter.cutoff_hz, dt))
    order = ORDERS[filter.kind]
    correction = CUTOFF_CORRECTIONS[order] if filter.corrected else 1.0
    return chain(memory, sample, pt1_gain(filter.cutoff_hz * correction, dt))


def apply_all(filters, memories, sample, dt):
    """Return (memories, filtered) of filters in a row."""
    kept = []
    for filter, memory in zip(filters, memories, strict=True):
        memory, sample = apply(filter, memory, sample, dt)
        kept.append(memory)
    return tuple(kept), sample


def pt1_gain(cutoff_hz, dt):
    """Return the gain (...) of a PT1; 1, which passes everything, for a cutoff of 0 (`pt1FilterGain`)."""
    time_constant = 1.0 / (2.0 * jnp.pi * jnp.maximum(cutoff_hz, 1e-3))
    return jnp.where(cutoff_hz > 0, dt / (time_constant + dt), 1.0)


def chain(memory, sample, gain):
    """Return (memory, filtered) of PT1s in a row, as many as `memory` has parts (`pt1`-, `pt2`-, `pt3FilterApply`)."""
    kept = []
    for state in memory:
        sample = state + gain[..., None] * (sample - state)
        kept.append(sample)
    return tuple(kept), sample


def notch_q(centre_hz, cutoff_hz):
    """Return the quality of a notch by its centre and lower edge (`filterGetNotchQ`)."""
    return centre_hz * cutoff_hz / (centre_hz * centre_hz - cutoff_hz * cutoff_hz)


def lowpass_coefficients(cutoff_hz, dt):
    """Return (b0, b1, b2, a1, a2) of the second-order Butterworth low-pass (`biquadFilterUpdate`)."""
    omega = 2.0 * jnp.pi * cutoff_hz * dt
    cosine, alpha = jnp.cos(omega), jnp.sin(omega) / (2.0 * BUTTERWORTH_Q)
    b1 = 1.0 - cosine
    return tuple(value / (1.0 + alpha) for value in (0.5 * b1, b1, 0.5 * b1, -2.0 * cosine, 1.0 - alpha))


def notch_coefficients(centre_hz, q, dt):
    """Return (b0, b1, b2, a1, a2) of a notch of quality `q` (`biquadFilterUpdate`)."""
    omega = 2.0 * jnp.pi * centre_hz * dt
    cosine, alpha = jnp.cos(omega), jnp.sin(omega) / (2.0 * q)
    one = jnp.ones_like(cosine)
    return tuple(value / (1.0 + alpha) for value in (one, -2.0 * cosine, one, -2.0 * cosine, 1.0 - alpha))


def biquad(memory, sample, coefficients):
    """Return (memory, filtered) of a biquad in direct form 1, whose coefficients (...) may change from pass to pass."""
    b0, b1, b2, a1, a2 = (value[..., None] for value in coefficients)
    x1, x2, y1, y2 = memory
    filtered = b0 * sample + b1 * x1 + b2 * x2 - a1 * y1 - a2 * y2
    return (sample, x1, filtered, y1), filtered

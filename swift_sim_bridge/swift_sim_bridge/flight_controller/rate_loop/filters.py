"""The firmware's digital filters (Betaflight 4.5, common/filter.c), batchable in JAX.

A filter is a record of its coefficients; its kind is fixed when a pass is traced. Its memory is a tuple of arrays
(..., n), shaped like the samples. Coefficients (...) have the batch axes only.
"""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp

ORDERS = {"PT1": 1, "PT2": 2, "PT3": 3}
CUTOFF_CORRECTIONS = {1: 1.0, 2: 1.553773974, 3: 1.961459177}  # of a chain's cutoff, for 3 dB attenuation at it
BUTTERWORTH_Q = 0.7071067811865476  # 1 / sqrt(2)
TYPES = ("PT1", "BIQUAD", "PT2", "PT3")  # in the order of the firmware's numbers


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Lowpass:
    """A low-pass filter.

    Attributes:
        cutoff_hz: (...) Hz; 0 switches a PT1 off.
        kind: one of TYPES.
        corrected: whether a PT2 or PT3 has 3 dB attenuation at its cutoff.
    """

    cutoff_hz: jax.Array
    kind: str = field(default="PT1", metadata={"static": True})
    corrected: bool = field(default=True, metadata={"static": True})


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Notch:
    """A notch filter.

    Attributes:
        centre_hz: (...) Hz of the notch.
        cutoff_hz: (...) Hz of its lower edge.
    """

    centre_hz: jax.Array
    cutoff_hz: jax.Array


def initial_memory(filter, sample) -> tuple:
    """Return the memory of a filter at rest, for samples like `sample` (..., n)."""
    order = ORDERS.get(filter.kind, 4) if isinstance(filter, Lowpass) else 4
    return (jnp.zeros_like(sample),) * order


def apply(filter, memory, sample, dt):
    """Return (memory, filtered (..., n)) after a sample, `dt` s after the previous one."""
    if isinstance(filter, Notch):
        q = notch_q(filter.centre_hz, filter.cutoff_hz)
        return biquad(memory, sample, notch_coefficients(filter.centre_hz, q, dt))
    if filter.kind == "BIQUAD":
        return biquad(memory, sample, lowpass_coefficients(filter.cutoff_hz, dt))
    order = ORDERS[filter.kind]
    correction = CUTOFF_CORRECTIONS[order] if filter.corrected else 1.0
    return chain(memory, sample, pt1_gain(filter.cutoff_hz * correction, dt))


def apply_all(filters, memories, sample, dt):
    """Return (memories, filtered) of filters in series."""
    new_memories = []
    for filter, memory in zip(filters, memories, strict=True):
        memory, sample = apply(filter, memory, sample, dt)
        new_memories.append(memory)
    return tuple(new_memories), sample


def pt1_gain(cutoff_hz, dt):
    """Return the gain (...) of a PT1 (`pt1FilterGain`); a cutoff of 0 gives 1, which passes everything."""
    time_constant = 1.0 / (2.0 * jnp.pi * jnp.maximum(cutoff_hz, 1e-3))
    return jnp.where(cutoff_hz > 0, dt / (time_constant + dt), 1.0)


def chain(memory, sample, gain):
    """Return (memory, filtered) of PT1s in series, one for each part of `memory` (`pt1`, `pt2`, `pt3FilterApply`)."""
    states = []
    for state in memory:
        sample = state + gain[..., None] * (sample - state)
        states.append(sample)
    return tuple(states), sample


def notch_q(centre_hz, cutoff_hz):
    """Return the quality factor of a notch from its centre and lower edge (`filterGetNotchQ`)."""
    return centre_hz * cutoff_hz / (centre_hz * centre_hz - cutoff_hz * cutoff_hz)


def lowpass_coefficients(cutoff_hz, dt):
    """Return (b0, b1, b2, a1, a2) of the second-order Butterworth low-pass (`biquadFilterUpdate`)."""
    omega = 2.0 * jnp.pi * cutoff_hz * dt
    cosine, alpha = jnp.cos(omega), jnp.sin(omega) / (2.0 * BUTTERWORTH_Q)
    b1 = 1.0 - cosine
    return tuple(value / (1.0 + alpha) for value in (0.5 * b1, b1, 0.5 * b1, -2.0 * cosine, 1.0 - alpha))


def notch_coefficients(centre_hz, q, dt):
    """Return (b0, b1, b2, a1, a2) of a notch of quality factor `q` (`biquadFilterUpdate`)."""
    omega = 2.0 * jnp.pi * centre_hz * dt
    cosine, alpha = jnp.cos(omega), jnp.sin(omega) / (2.0 * q)
    one = jnp.ones_like(cosine)
    return tuple(value / (1.0 + alpha) for value in (one, -2.0 * cosine, one, -2.0 * cosine, 1.0 - alpha))


def biquad(memory, sample, coefficients):
    """Return (memory, filtered) of a biquad in direct form 1; its coefficients (...) may change in each pass."""
    b0, b1, b2, a1, a2 = (value[..., None] for value in coefficients)
    x1, x2, y1, y2 = memory
    filtered = b0 * sample + b1 * x1 + b2 * x2 - a1 * y1 - a2 * y2
    return (sample, x1, filtered, y1), filtered

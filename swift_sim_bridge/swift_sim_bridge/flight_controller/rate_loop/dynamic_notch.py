"""Dynamic notches: filters that follow the strongest gyro vibrations (Betaflight 4.5, flight/dyn_notch_filter.c).

A sliding discrete Fourier transform (common/sdft.c) of the downsampled gyro runs on each axis. For one axis after the
other, in four passes each, its peaks are searched and the notches moved towards them. Loops below 2 kHz have none.
"""

import math
from dataclasses import dataclass, field
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np

from swift_sim_bridge.flight_controller.rate_loop import filters

SAMPLES, BINS = 72, 36  # of the transform
DAMPING = 0.9999  # factor per sample that keeps the sliding transform stable (sdft.c)
SMOOTH_HZ = 4.0  # cutoff of the low-pass on a notch's centre, for a peak at the noise floor
STEPS, AXES = 4, 3  # of the calculation: window, peaks, frequencies, filters, for one axis after the other
SLOWEST_HZ = 2000.0  # rate of the slowest loop with dynamic notches


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class DynamicNotch:
    """Coefficients of the dynamic notches.

    Attributes:
        q: (...), quality factor, `dyn_notch_q` / 100.
        min_hz: Hz, `dyn_notch_min_hz`.
        max_hz: Hz, `dyn_notch_max_hz`.
        count: number of notches on each axis.
        loop_hz: Hz, rate of the rate loop.
    """

    q: jax.Array
    min_hz: float = field(metadata={"static": True})
    max_hz: float = field(metadata={"static": True})
    count: int = field(metadata={"static": True})
    loop_hz: float = field(metadata={"static": True})

    @cached_property
    def top_hz(self) -> float:
        """Highest centre, Hz."""
        return min(max(self.min_hz, self.max_hz), 0.5 * self.loop_hz)

    @cached_property
    def every(self) -> int:
        """Number of passes whose mean is one sample of the transform."""
        return max(1, int(0.5 * self.loop_hz / self.top_hz))

    @cached_property
    def bin_hz(self) -> float:
        """Width of a bin, Hz."""
        return self.loop_hz / self.every / SAMPLES

    @cached_property
    def bins(self) -> tuple[int, int]:
        """First and last bin of the search."""
        return max(1, round(self.min_hz / self.bin_hz)), min(BINS - 1, round(self.top_hz / self.bin_hz))


def at_rest(term: DynamicNotch, zero) -> dict:
    """Return the memory at rest for gyro samples like `zero` (..., 3), with evenly spread notches."""
    spread_hz = (np.arange(term.count) + 0.5) * (term.top_hz - term.min_hz) / term.count + term.min_hz
    spectrum = jnp.zeros((*zero.shape, BINS), zero.dtype)
    count = jnp.zeros(zero.shape[:-1], jnp.int32)
    return {
        "sum": zero,
        "mean": zero,
        "tick": count,
        "due": count,
        "step": count,
        "samples": jnp.zeros((*zero.shape, SAMPLES), zero.dtype),
        "real": spectrum,
        "imaginary": spectrum,
        "power": spectrum[..., 0, :],
        "centre_hz": jnp.broadcast_to(jnp.asarray(spread_hz, zero.dtype), (*zero.shape, term.count)),
        "notches": ((zero,) * 4,) * term.count,
    }


def apply(term: DynamicNotch, memory: dict, gyro, dt):
    """Return (memory, gyro (..., 3)) after one pass."""
    filtered, notches = gyro[..., None], []
    for k in range(term.count):
        coefficients = filters.notch_coefficients(memory["centre_hz"][..., k], term.q[..., None], dt)
        past, filtered = filters.biquad(tuple(part[..., None] for part in memory["notches"][k]), filtered, coefficients)
        notches.append(tuple(part[..., 0] for part in past))
    memory = _update_transform(term, {**memory, "notches": tuple(notches)}, gyro)
    due = memory["due"] > 0
    unchanged = memory["power"], memory["centre_hz"]
    power, centre_hz = jax.lax.cond(jnp.any(due), lambda: _calculate(term, memory), lambda: unchanged)
    memory["power"] = jnp.where(due[..., None], power, unchanged[0])
    memory["centre_hz"] = jnp.where(due[..., None, None], centre_hz, unchanged[1])
    memory["step"] = jnp.where(due, (memory["step"] + 1) % (STEPS * AXES), memory["step"])
    memory["due"] = jnp.maximum(memory["due"] - 1, 0)
    return memory, filtered[..., 0]


def _update_transform(term: DynamicNotch, memory: dict, gyro) -> dict:
    """Take a gyro sample and update a part of the transform's bins with the last mean (`dynNotchUpdate`)."""
    total, full = memory["sum"] + gyro, memory["tick"] == term.every
    mean = jnp.where(full[..., None], total / term.every, memory["mean"])
    part = jnp.where(full, 0, memory["tick"])
    delta = (mean - DAMPING**SAMPLES * memory["samples"][..., 0])[..., None]
    rotation = DAMPING * np.exp(2j * np.pi * np.arange(BINS) / SAMPLES)
    real, imaginary = memory["real"] + delta, memory["imaginary"]
    rotated = rotation.real * real - rotation.imag * imaginary, rotation.imag * real + rotation.real * imaginary
    selected = _bins_by_pass(term)[part][..., None, :]
    last = (part == term.every - 1)[..., None, None]
    pushed = jnp.concatenate([memory["samples"][..., 1:], mean[..., None]], axis=-1)
    return {
        **memory,
        "sum": jnp.where(full[..., None], 0.0, total),
        "mean": mean,
        "tick": part + 1,
        "due": jnp.where(full, STEPS * AXES, memory["due"]),
        "samples": jnp.where(last, pushed, memory["samples"]),
        "real": jnp.where(selected, rotated[0], memory["real"]),
        "imaginary": jnp.where(selected, rotated[1], memory["imaginary"]),
    }


def _bins_by_pass(term: DynamicNotch):
    """Return the bins (every, BINS) that each pass updates, with one beyond either end (`sdftPushBatch`)."""
    first, last = term.bins
    size, selected = (last - first + 1) // term.every, np.zeros((term.every, BINS), dtype=bool)
    for part in range(term.every):
        start = first + size * part
        selected[part, start : (last + 1 if part == term.every - 1 else start + size)] = True
    selected[0, first - 1] = True
    if last < BINS - 1:
        selected[-1, last + 1] = True
    return jnp.asarray(selected)


def _calculate(term: DynamicNotch, memory: dict):
    """Return (power (..., BINS), centres (..., 3, count)) after one step of the calculation (`dynNotchProcess`).

    The window has its own step, because it fixes the spectrum of the three later steps; those run together in the last.
    """
    step, axis = memory["step"] % STEPS, memory["step"] // STEPS
    selected = (jnp.arange(AXES) == axis[..., None])[..., None]
    take = lambda name: jnp.sum(jnp.where(selected, memory[name], 0.0), axis=-2)  # noqa: E731
    real, imaginary = _windowed(take("real")), _windowed(take("imaginary"))
    power = jnp.where((step == 0)[..., None], real * real + imaginary * imaginary, memory["power"])
    centre_hz = _moved(term, power, take("centre_hz"))[..., None, :]
    return power, jnp.where(selected & (step == STEPS - 1)[..., None, None], centre_hz, memory["centre_hz"])


def _windowed(spectrum):
    """Return the spectrum (..., BINS) with a Hann window of twice the usual height (`sdftWinSq`)."""
    below = jnp.concatenate([jnp.zeros_like(spectrum[..., :1]), spectrum[..., :-1]], axis=-1)
    above = jnp.concatenate([spectrum[..., 1:], spectrum[..., -2:-1]], axis=-1)
    edge = jnp.arange(BINS) == BINS - 1
    return spectrum - jnp.where(edge, above, 0.5 * (below + above))


def _moved(term: DynamicNotch, power, centre_hz):
    """Return the centres (..., count) moved towards the strongest peaks of `power` (..., BINS)."""
    first, last = term.bins
    bins, peaks = _peaks(term, power)
    at = lambda offset: jnp.take_along_axis(power, jnp.maximum(bins + offset, 0), axis=-1)  # noqa: E731
    low, top, high, real = at(-1), at(0), at(1), bins > 0
    floor = jnp.sum(power[..., first : last + 1], axis=-1)
    floor = floor - jnp.sum(jnp.where(real, 0.75 * low + top + 0.75 * high, 0.0), axis=-1)
    floor = 2.0 * floor / (last - first - jnp.sum(real, axis=-1) + 1)
    bend = 2.0 * (low - 2.0 * top + high)
    fine = bins + jnp.where(bend != 0, (low - high) / jnp.where(bend != 0, bend, 1.0), 0.0)
    target_hz = jnp.clip(fine * term.bin_hz, term.min_hz, term.top_hz)
    above = jnp.clip(peaks / jnp.maximum(floor, 1e-30)[..., None], 1.0, 10.0)
    omega = 2.0 * math.pi * SMOOTH_HZ * above * STEPS * AXES / term.loop_hz
    moving = real & (peaks > floor[..., None])
    return jnp.where(moving, centre_hz + omega / (omega + 1.0) * (target_hz - centre_hz), centre_hz)


def _peaks(term: DynamicNotch, power):
    """Return (bins, heights), each (..., count), of the highest peaks in the order of their bins.

    Missing peaks have bin 0 and come last. Neighbours cannot both be peaks, so the firmware's skip of the next bin has
    no effect.
    """
    first, last = term.bins
    inside = power[..., first + 1 : last]
    peak = (inside > power[..., first : last - 1]) & (inside > power[..., first + 2 : last + 1])
    heights, places = jax.lax.top_k(jnp.where(peak, inside, 0.0), term.count)
    bins = jnp.where(heights > 0, places + first + 1, BINS)
    order = jnp.argsort(bins, axis=-1)
    bins, heights = (jnp.take_along_axis(values, order, axis=-1) for values in (bins, heights))
    return jnp.where(bins == BINS, 0, bins), heights

"""The RPM filter: notches on the gyro at the harmonics of each rotor (Betaflight 4.5, flight/rpm_filter.c).

The firmware updates its notches in turn, all within 1 ms; here each pass updates all of them.
"""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp

from swift_sim_bridge.flight_controller.rate_loop import filters

TOP_SHARE = 0.48  # of the loop's rate: largest centre, below the Nyquist frequency (`rpmFilterInit`)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RpmFilter:
    """Coefficients of the RPM filter.

    Attributes:
        q: (...), quality factor, `rpm_filter_q` / 100.
        min_hz: (...) Hz, `rpm_filter_min_hz`.
        fade_hz: (...) Hz, `rpm_filter_fade_range_hz`.
        lowpass_hz: (...) Hz of the low-pass on rotor frequencies, `rpm_filter_lpf_hz`.
        weights: 0 to 1 for each harmonic; a harmonic of weight 0 has no notch.
        rotors: number of rotors.
    """

    q: jax.Array
    min_hz: jax.Array
    fade_hz: jax.Array
    lowpass_hz: jax.Array
    weights: tuple[float, ...] = field(metadata={"static": True})
    rotors: int = field(default=4, metadata={"static": True})


def at_rest(term: RpmFilter, zero) -> dict:
    """Return the memory for gyro samples like `zero` (..., 3): rotor frequencies (..., n) and one state per notch."""
    count = term.rotors * sum(weight > 0 for weight in term.weights)
    rotor_hz = jnp.zeros((*zero.shape[:-1], term.rotors), zero.dtype)
    return {"rotor_hz": (rotor_hz,), "notches": ((zero,) * 4,) * count}


def notch_of(term: RpmFilter, harmonic: int, rotor_hz, dt):
    """Return (centre (...) Hz, weight (...)) of the notch at a harmonic (1, 2, ..) of a rotor at `rotor_hz` (...)."""
    centre_hz = jnp.clip(harmonic * rotor_hz, term.min_hz, TOP_SHARE / dt)
    margin_hz = centre_hz - term.min_hz
    fade = jnp.where(margin_hz < term.fade_hz, margin_hz / jnp.maximum(term.fade_hz, 1e-3), 1.0)
    return centre_hz, fade * term.weights[harmonic - 1]


def apply(term: RpmFilter, memory: dict, gyro, rotor_speed, dt):
    """Return (memory, gyro (..., 3)) after one pass; rotor_speed (..., n) rad/s as the ESCs report it."""
    measured_hz = jnp.broadcast_to(rotor_speed / (2.0 * jnp.pi), memory["rotor_hz"][0].shape)
    rotor_hz, smooth_hz = filters.chain(memory["rotor_hz"], measured_hz, filters.pt1_gain(term.lowpass_hz, dt))
    old_notches, new_notches = iter(memory["notches"]), []
    for harmonic in range(1, len(term.weights) + 1):
        for rotor in range(term.rotors if term.weights[harmonic - 1] > 0 else 0):
            centre_hz, weight = notch_of(term, harmonic, smooth_hz[..., rotor], dt)
            state, filtered = filters.biquad(next(old_notches), gyro, filters.notch_coefficients(centre_hz, term.q, dt))
            gyro = weight[..., None] * filtered + (1.0 - weight[..., None]) * gyro
            new_notches.append(state)
    return {"rotor_hz": rotor_hz, "notches": tuple(new_notches)}, gyro

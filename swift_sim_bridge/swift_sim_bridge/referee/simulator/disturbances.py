"""Random disturbances of a flight of the referee: process noise, Dryden gusts, buffeting, late and lost commands."""

import numpy as np
from scipy.signal import cont2discrete, lfilter, lfiltic

FORCE_NOISE, MOMENT_NOISE = 0.1, 0.4  # m/s^2 and rad/s^2: standard deviation in each axis for a roughness of 1
BANDWIDTH_HZ = 12.0  # of the process noise; first order
MAX_AGE = 9  # commands that may be under way at a time; at 100 Hz the catalogue's largest latency is 4
FOOT = 0.3048  # m


def process_noise(size: float, shape, dt: float, rng) -> np.ndarray:
    """Return noise (*shape, 3) of a standard deviation, first-order low-passed at `BANDWIDTH_HZ`."""
    keep = np.exp(-2 * np.pi * BANDWIDTH_HZ * dt)
    return _markov(size, keep, (np.prod(shape), 3), rng).reshape(*shape, 3)


def _markov(size: float, keep: float, shape, rng) -> np.ndarray:
    """Return first-order noise along the first axis, stationary from its first sample."""
    white = size * np.sqrt(1 - keep**2) * rng.standard_normal(shape)
    white[0] /= np.sqrt(1 - keep**2)
    return lfilter([1.0], [1.0, -keep], white, axis=0)


def buffet(entry: dict | None, shape, dt: float, rng) -> np.ndarray:
    """Return noise of variance 1 for each rotor, with the bandwidth of the entry `vortex_ring`; zeros without one."""
    if not entry or not entry.get("buffet"):
        return np.zeros(shape)
    keep = np.exp(-2 * np.pi * entry.get("bandwidth", 10.0) * dt)
    return _markov(1.0, keep, (int(np.prod(shape[:-1])), shape[-1]), rng).reshape(shape)


def gust(entry: dict | None, count: int, dt: float, rng) -> np.ndarray:
    """Return the velocity of the air (count, 3), m/s, world: the Dryden model of MIL-F-8785C at low altitude.

    Each transfer function is discretised by the bilinear transform and driven by white noise of unit density.
    """
    if not entry:
        return np.zeros((count, 3))
    height, airspeed = max(entry.get("height", 3.05), 10 * FOOT), entry.get("airspeed", 10.0)
    profile = 0.177 + 0.000823 * height / FOOT
    sigma_w = 0.1 * entry["wind_20ft"]
    sigma_u, length_u = sigma_w / profile**0.4, height / profile**1.2
    along = _shaped(sigma_u, length_u / airspeed, 1, count, dt, rng)
    across = _shaped(sigma_u, length_u / airspeed, 2, count, dt, rng)
    up = _shaped(sigma_w, height / airspeed, 2, count, dt, rng)
    cosine, sine = np.cos(entry.get("heading", 0.0)), np.sin(entry.get("heading", 0.0))
    return np.stack([cosine * along - sine * across, sine * along + cosine * across, up], axis=1)


def _shaped(sigma: float, time: float, order: int, count: int, dt: float, rng) -> np.ndarray:
    """Return white noise (count,) through a Dryden filter of order 1 or 2 with a time constant, s."""
    if order == 1:
        top, bottom = [sigma * np.sqrt(2 * time)], [time, 1.0]
    else:
        root = sigma * np.sqrt(time)
        top, bottom = [root * np.sqrt(3.0) * time, root], [time**2, 2 * time, 1.0]
    b, a, _ = cont2discrete((top, bottom), dt, "bilinear")
    settling = round(8 * time / dt)
    white = rng.standard_normal(count + settling) / np.sqrt(dt)
    return lfilter(b.ravel(), a, white, zi=lfiltic(b.ravel(), a, []))[0][settling:]


def command_ages(terms: dict, ticks: int, passes: int, dt: float, rng) -> np.ndarray:
    """Return the age (ticks, passes), in commands, of the newest command that has arrived at each rate-loop pass."""
    late = terms.get("command_latency", {})
    jitter = np.sqrt(12.0) * (rng.random(ticks) - 0.5) * late.get("jitter", 0.0)
    given = np.arange(ticks) * passes * dt
    arrival = given + np.maximum(late.get("delay", 0.0) + jitter, 0.0)
    arrival[rng.random(ticks) < terms.get("dropped_commands", {}).get("share", 0.0)] = np.inf
    now = np.arange(ticks * passes).reshape(ticks, passes) * dt
    newest = np.full((ticks, passes), -1)
    for back in range(MAX_AGE, -1, -1):
        there = np.roll(arrival, back)[:, None] <= now + 1e-9
        there &= np.arange(ticks)[:, None] >= back
        newest = np.where(there, back, newest)
    return np.where(newest < 0, MAX_AGE, newest)

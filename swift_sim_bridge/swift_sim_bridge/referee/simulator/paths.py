"""Paths that the referee's vehicles fly: Lissajous figures, splines through gates, dives, low passes, fast eights."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from swift_sim_bridge.referee.simulator.plant import GRAVITY

TICK_S = 0.01  # sample time of a path
EASE_S = 2.0  # duration of the start from rest
KINDS = ("lissajous", "gates", "dives", "low", "hover", "race")
MIN_HEIGHT_M = 1.5  # lowest point of all paths but the low ones: above the ground effect
GATE_ANGLE_SPREAD = 0.25  # random change of a gate's angle, in gate spacings


@dataclass(frozen=True)
class Path:
    """A path with samples every TICK_S.

    Attributes:
        p: positions (n, 3), m, world.
        v: velocities (n, 3), m/s, world.
        a: accelerations (n, 3), m/s^2, world.
        yaw: headings (n,), rad.
        yaw_rate: (n,), rad/s.
        shake: rates (n, 3), rad/s, body, that are added to the commanded rates to excite all axes.
    """

    p: np.ndarray
    v: np.ndarray
    a: np.ndarray
    yaw: np.ndarray
    yaw_rate: np.ndarray
    shake: np.ndarray


def draw_path(
    rng: np.random.Generator, kind: str, seconds: float, top_thrust: float, speed: float, shaking: float
) -> Path:
    """Return a random path that begins at rest.

    Args:
        rng: random generator.
        kind: one of KINDS.
        seconds: duration, s.
        top_thrust: largest collective thrust of the vehicle, m/s^2.
        speed: largest speed, m/s; lower if the vehicle lacks the thrust.
        shaking: amplitude of the excitation, rad/s.
    """
    t = TICK_S * np.arange(round(seconds / TICK_S))
    figure = {"lissajous": _lissajous, "gates": _gates, "dives": _dives, "low": _low, "hover": _hover, "race": _race}[
        kind
    ](rng)
    rate = _rate(figure, top_thrust, speed) if kind != "hover" else 1.0
    share = np.clip(t / EASE_S, 0.0, 1.0)
    warp = rate * (EASE_S * (share**3 - 0.5 * share**4) + np.maximum(t - EASE_S, 0.0))
    first = rate * (3.0 * share**2 - 2.0 * share**3)
    second = np.where(t < EASE_S, rate * 6.0 * (share - share**2) / EASE_S, 0.0)
    p, slope, bend = (figure(warp, order) for order in range(3))
    low = MIN_HEIGHT_M if kind != "low" else rng.uniform(0.1, 0.15)
    p[:, 2] += low - p[:, 2].min()
    v = slope * first[:, None]
    a = bend * first[:, None] ** 2 + slope * second[:, None]
    yaw, yaw_rate = _heading(rng, t) if kind != "race" else _ahead(slope, bend, first)
    return Path(p, v, a, yaw, yaw_rate, _shake(rng, t, shaking))


def paced(path: Path, pace: float, seconds: float) -> Path:
    """Return the first seconds of a path that is flown `pace` times as fast; the excitation keeps its frequency."""
    t, ticks = TICK_S * np.arange(len(path.p)), round(seconds / TICK_S)

    def at(values):
        return CubicSpline(t, values)(pace * t[:ticks])

    return Path(
        at(path.p), pace * at(path.v), pace**2 * at(path.a), at(path.yaw), pace * at(path.yaw_rate), path.shake[:ticks]
    )


def _rate(figure, top_thrust: float, speed: float) -> float:
    """Return the rate of the figure's parameter at which neither `speed` nor 70 % of the thrust is exceeded."""
    s = np.linspace(0.0, 60.0, 6001)
    slope, bend = figure(s, 1), figure(s, 2)
    rate = speed / max(np.linalg.norm(slope, axis=1).max(), 1e-9)
    for _ in range(60):
        pull = np.linalg.norm(rate**2 * bend + [0.0, 0.0, GRAVITY], axis=1).max()
        sinking = (rate**2 * bend[:, 2]).min()
        if pull < 0.7 * top_thrust and sinking > -0.5 * GRAVITY:
            break
        rate *= 0.95
    return rate


def _lissajous(rng):
    """Return figure(s, order): two sines in each axis; derivatives (n, 3) of this order."""
    size = rng.uniform([5.0, 5.0, 1.0], [11.0, 11.0, 2.5])
    frequency = rng.uniform([0.6, 0.5, 0.7], [1.0, 0.9, 1.2])
    small, quick = size * rng.uniform(0.1, 0.25, 3), frequency * rng.uniform(2.2, 3.2, 3)
    phase = rng.uniform(0.0, 2 * np.pi, (2, 3))

    def figure(s, order):
        turned = 0.5 * np.pi * order
        slow = size * frequency**order * np.sin(np.outer(s, frequency) + phase[0] + turned)
        return slow + small * quick**order * np.sin(np.outer(s, quick) + phase[1] + turned)

    return figure


def _gates(rng):
    """Return a closed smooth curve through five to eight gates around a ring."""
    count = rng.integers(5, 9)
    angle = 2 * np.pi * (np.arange(count) + rng.uniform(-GATE_ANGLE_SPREAD, GATE_ANGLE_SPREAD, count)) / count
    reach = rng.uniform(5.0, 11.0, count)
    gates = np.stack([reach * np.cos(angle), reach * np.sin(angle), rng.uniform(0.0, 4.0, count)], axis=1)
    gates = np.concatenate([gates, gates[:1]])
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(gates, axis=0), axis=1))])
    return _periodic(CubicSpline(length, gates, bc_type="periodic"))


def _periodic(spline):
    """Return a spline as figure(s, order)."""
    return lambda s, order: spline(s, order)


def _dives(rng):
    """Return climbs and descents with little lateral speed."""
    size = np.array([*rng.uniform(0.5, 1.5, 2), rng.uniform(4.0, 7.0)])
    frequency, phase = rng.uniform([0.4, 0.4, 0.8], [0.6, 0.6, 1.1]), rng.uniform(0.0, 2 * np.pi, 3)
    return lambda s, order: size * frequency**order * np.sin(np.outer(s, frequency) + phase + 0.5 * np.pi * order)


def _low(rng):
    """Return a flat figure near the ground."""
    size = np.array([*rng.uniform(2.0, 4.0, 2), rng.uniform(0.15, 0.3)])
    frequency, phase = rng.uniform([0.5, 0.5, 0.9], [0.8, 0.8, 1.3]), rng.uniform(0.0, 2 * np.pi, 3)
    return lambda s, order: size * frequency**order * np.sin(np.outer(s, frequency) + phase + 0.5 * np.pi * order)


def _hover(rng):
    """Return one place with a slow motion of 0.1 m."""
    phase = rng.uniform(0.0, 2 * np.pi, 3)
    return lambda s, order: 0.1 * 0.3**order * np.sin(0.3 * s[:, None] + phase + 0.5 * np.pi * order)


def _race(rng):
    """Return a wide figure of eight, which reverses its turn at full speed."""
    size, frequency = rng.uniform([15.0, 4.0, 0.5], [22.0, 6.5, 1.5]), np.array([1.0, 2.0, rng.uniform(0.7, 1.5)])
    phase = rng.uniform([0.0, -0.4, 0.0], [0.0, 0.4, 2 * np.pi])
    return lambda s, order: size * frequency**order * np.sin(np.outer(s, frequency) + phase + 0.5 * np.pi * order)


def _ahead(slope, bend, first):
    """Return yaw (n,) rad along the path, and yaw rate (n,) rad/s.

    Args:
        slope: derivative (n, 3) of the path by its parameter.
        bend: second derivative (n, 3).
        first: rate (n,) of the parameter, 1/s.
    """
    turn = slope[:, 0] * bend[:, 1] - slope[:, 1] * bend[:, 0]
    return np.unwrap(np.arctan2(slope[:, 1], slope[:, 0])), first * turn / np.sum(slope[:, :2] ** 2, axis=1)


def _heading(rng, t):
    """Return yaw (n,) rad and yaw rate (n,) rad/s."""
    size, frequency = rng.uniform(0.5, 1.2, 2), rng.uniform([0.6, 1.5], [1.2, 3.0])
    phase, steady = rng.uniform(0.0, 2 * np.pi, 2), rng.uniform(-0.3, 0.3)
    angle = np.outer(t, frequency) + phase
    size = size * [1.0, 0.3]
    return steady * t + np.sin(angle) @ size, steady + np.cos(angle) @ (size * frequency)


def _shake(rng, t, size: float):
    """Return a sum of sines of 1.5 to 6 Hz in each axis, which fades in and is switched on and off."""
    frequency = 2 * np.pi * rng.uniform(1.5, 6.0, (3, 4))
    phase = rng.uniform(0.0, 2 * np.pi, (3, 4))
    waves = np.sin(t[:, None, None] * frequency + phase).sum(axis=2) / 2.0
    return size * waves * (np.clip(t / EASE_S, 0.0, 1.0) * (np.sin(0.9 * t + phase[0, 0]) > -0.3))[:, None]

"""Air that moves at one place: the place is searched along the path, its size and strength are fitted then.

Where it blows, a draught does what a wind of its own would do there: so the wind's footprints, faded out around a
place, are its own to first order.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from swift_sim_bridge.gap.inference.sensitivity import Linearisation

EVERY_S = 0.4  # of the path, places that are tried
RADII = (0.8, 1.4, 2.2, 3.2)
LEAST_GAIN, REFERENCE_MARGIN = 30.0, 1.5  # of a place that is searched, and times the largest that any twin shows


@dataclass(frozen=True)
class LocalWind:
    """Where it would blow: center (3,) m and radius m; velocity (3,) m/s; gain: by how much it lowers the squares."""

    center: np.ndarray
    radius: float
    velocity: np.ndarray
    gain: float


def search(line: Linearisation, wind, p_world, sigma) -> LocalWind:
    """Return the place whose draught would lower the squares of a residual most.

    wind (3, m, c): what a wind of 1 m/s along each axis of the world does to it; p_world (m, 3); sigma (m, c).
    """
    products = np.einsum("imc,mc->mi", wind / sigma, line.residual / sigma)
    best = LocalWind(np.zeros(3), 1.0, np.zeros(3), 0.0)
    for center, reached, matrices in _places(line, wind, p_world, sigma):
        told = reached @ products
        velocities = np.linalg.solve(matrices + 1e-9 * np.eye(3), -told[..., None])[..., 0]
        gains = -np.sum(told * velocities, axis=1)
        i = int(np.argmax(gains))
        if gains[i] > best.gain:
            best = LocalWind(center, RADII[i], velocities[i], float(gains[i]))
    return best


def detectable(line: Linearisation, wind, p_world, sigma, gain: float) -> float:
    """Return the draught, m/s along an axis, that would lower the squares by `gain` at the usual place of the path."""
    known = [np.trace(matrix) / 3.0 for *_, matrices in _places(line, wind, p_world, sigma) for matrix in matrices]
    return float(np.sqrt(gain / max(np.median(known), 1e-12)))


def _places(line: Linearisation, wind, p_world, sigma) -> Iterator[tuple]:
    """Yield places along the path: center (3,), and by radius each share (r, m), information (r, 3, 3)."""
    x = wind / sigma
    matrix = np.einsum("imc,jmc->mij", x, x).reshape(-1, 9)
    step = max(1, round(EVERY_S / (line.t[1] - line.t[0])))
    for center in p_world[::step]:
        reached = share(p_world, center, np.array(RADII)[:, None])
        yield center, reached, (reached**2 @ matrix).reshape(-1, 3, 3)


def share(p_world, center, radius) -> np.ndarray:
    """Return how much (m,) of what blows around a center reaches places (m, 3); a row each for radii (r, 1)."""
    return np.maximum(1.0 - np.sum((p_world - center) ** 2, axis=1) / radius**2, 0.0) ** 2

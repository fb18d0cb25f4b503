"""Air that moves at one place: the place is searched along the path, its size and strength are fitted then.

Where it blows, a draught does what a wind of its own would do there: so the wind's footprints, faded out around a
place, are its own to first order.
"""

from dataclasses import dataclass

import numpy as np

from swift_sim_bridge.gap.footprints import Linearisation

EVERY_S = 0.4  # of the path, places that are tried
RADII = (0.8, 1.4, 2.2, 3.2)
LEAST_GAIN, MORE_THAN_ANY = 45.0, 1.5  # of a place that is searched, and times the largest that any twin shows
LEAST_SECONDS = 3  # in which it must be met, or the flight tells a place from a moment no better than chance


@dataclass(frozen=True)
class Place:
    """Where it would blow: center (3,) m and radius m; velocity (3,) m/s; gain: by how much it lowers the squares."""

    center: np.ndarray
    radius: float
    velocity: np.ndarray
    gain: float


def search(line: Linearisation, wind, p_world, sigma) -> Place:
    """Return the place whose draught would lower the squares of a residual most.

    wind (3, m, c): what a wind of 1 m/s along each axis of the world does to it; p_world (m, 3); sigma (c,).
    """
    x, r = wind / sigma, line.residual / sigma
    products = np.einsum("imc,mc->mi", x, r)
    matrix = np.einsum("imc,jmc->mij", x, x)
    seconds = np.floor(line.t - line.t[0]).astype(int)
    best = Place(np.zeros(3), 1.0, np.zeros(3), 0.0)
    step = max(1, round(EVERY_S / (line.t[1] - line.t[0])))
    for center in p_world[::step]:
        apart = np.sum((p_world - center) ** 2, axis=1)
        for radius in RADII:
            share = np.maximum(1.0 - apart / radius**2, 0.0) ** 2
            if len(np.unique(seconds[share > 0.1])) < LEAST_SECONDS:
                continue
            told = share @ products
            velocity = np.linalg.solve(np.tensordot(share**2, matrix, axes=1) + 1e-9 * np.eye(3), -told)
            if -told @ velocity > best.gain:
                best = Place(center, radius, velocity, float(-told @ velocity))
    return best

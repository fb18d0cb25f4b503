"""Search of a wind that blows at one place of the path alone.

The search finds the place. The fit that follows determines its position, its size and the wind. Inside the place a
local wind has the effect of a uniform wind: to first order its sensitivity is that of the uniform wind, faded out with
the distance from the centre.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from swift_sim_bridge.gap.inference.sensitivity import Linearisation

# Centres and radii that are tried; a fit then starts at the best ones. Denser ones take more time.
SPACING_S = 0.4  # s along the path between two centres
RADII_M = (0.8, 1.4, 2.2, 3.2)  # m
FINE_RADII_M = (0.6, 0.8, 1.0, 1.2, 1.4, 1.6, 1.8, 2.0, 2.2, 2.4, 2.6, 2.8, 3.0, 3.2)  # m
MIN_GAIN = 30.0  # gain that a place must have to be fitted; one place in 700,000 has it by chance (3 components)
REFERENCE_MARGIN = 1.5  # factor over the largest gain of any reference flight; larger overlooks weaker winds


@dataclass(frozen=True)
class LocalWind:
    """A place and the wind that lowers the sum of squares most there.

    Attributes:
        center: (3,) centre of the place in the world, m.
        radius: distance from the centre at which the wind is zero, m.
        velocity: (3,) wind at the centre, in the world, m/s.
        gain: decrease of the sum of squares, in independent samples.
    """

    center: np.ndarray
    radius: float
    velocity: np.ndarray
    gain: float


def find_local_wind(line: Linearisation, wind, p_world, sigma) -> LocalWind:
    """Return the local wind with the largest gain.

    Args:
        line: residuals of a recording.
        wind: (3, m, c) change of the residuals per 1 m/s of wind along each axis of the world.
        p_world: (m, 3) positions of the vehicle, m.
        sigma: (m, c) or (c,) standard deviation of the residuals.
    """
    return _best(p_world[:: _step(line)], RADII_M, line, wind, p_world, sigma)


def refined(place: LocalWind, line: Linearisation, wind, p_world, sigma) -> LocalWind:
    """Return the local wind with the largest gain at a place near the one that `find_local_wind` returns.

    Its centre is on the path too: how far beside the path a centre is, and how strong the wind is there, a single
    passage does not show.

    Args:
        place: the place.
        line, wind, p_world, sigma: as there.
    """
    near = np.sum((p_world - place.center) ** 2, axis=1) < (place.radius / 2) ** 2
    return _best(p_world[near], FINE_RADII_M, line, wind, p_world, sigma)


def _best(centers, radii, line: Linearisation, wind, p_world, sigma) -> LocalWind:
    """Return the local wind with the largest gain at one of these centres (k, 3), within one of these radii, m."""
    gradient = np.einsum("imc,mc->mi", wind / sigma, line.residual / sigma)
    best = LocalWind(np.zeros(3), 1.0, np.zeros(3), 0.0)
    for center, weights, information in _places(centers, radii, wind, p_world, sigma):
        local_gradient = weights @ gradient
        velocities = np.linalg.solve(information + 1e-9 * np.eye(3), -local_gradient[..., None])[..., 0]
        gains = -np.sum(local_gradient * velocities, axis=1)
        i = int(np.argmax(gains))
        if gains[i] > best.gain:
            best = LocalWind(center, radii[i], velocities[i], float(gains[i]))
    return best


def minimum_detectable_wind(line: Linearisation, wind, p_world, sigma, gain: float) -> float:
    """Return the local wind along one axis, m/s, that has this gain at a place of median information."""
    places = _places(p_world[:: _step(line)], RADII_M, wind, p_world, sigma)
    information = [np.trace(one) / 3.0 for *_, parts in places for one in parts]
    return float(np.sqrt(gain / max(np.median(information), 1e-12)))


def _step(line: Linearisation) -> int:
    """Return the number of rows between two centres that are tried."""
    return max(1, round(SPACING_S / (line.t[1] - line.t[0])))


def _places(centers, radii, wind, p_world, sigma) -> Iterator[tuple]:
    """Yield places: centre (3,), and for each of r radii weights (r, m) and information (r, 3, 3)."""
    x = wind / sigma
    information = np.einsum("imc,jmc->mij", x, x).reshape(-1, 9)
    for center in centers:
        weights = local_weight(p_world, center, np.array(radii)[:, None])
        yield center, weights, (weights**2 @ information).reshape(-1, 3, 3)


def local_weight(p_world, center, radius) -> np.ndarray:
    """Return the share (m,) of a local wind that acts at positions (m, 3): 1 at its centre, 0 beyond its radius.

    For radii (r, 1) the shares are (r, m).
    """
    return np.maximum(1.0 - np.sum((p_world - center) ** 2, axis=1) / radius**2, 0.0) ** 2

"""The length of the shortest way through the gates of a race. No ROS.

Straight ways from the podium through one point of each opening, gate 1 once more after each lap. The sum of their
lengths is convex in the points, so that a search along the slopes finds the shortest way.
"""

import numpy as np

SMOOTH_M = 1e-3  # rounds the slope of a way's length where its ends meet, m
LAPS_AT_ONCE = 10  # further laps count as separate ways


def shortest_m(track) -> float:
    """Return a length in m that no flight of the whole race undercuts, within millimetres a gate for up to ten laps."""
    laps = min(track.laps, LAPS_AT_ONCE)
    gates = np.arange(1 + laps * len(track.gates)) % len(track.gates)
    length = _shortest_m(track, gates, np.array(track.start))
    if track.laps > laps:
        lap = np.append(np.arange(len(track.gates)), 0)
        length += (track.laps - laps) * _shortest_m(track, lap, None)
    return length


def _shortest_m(track, gates, start) -> float:
    """Return the length of the shortest way through openings.

    The way that the search ends with may be longer. Its directions bound all ways from below: a length is at least its
    component along a direction, and the sum of those is linear in the points, so that its minimum is at rims.

    Args:
        track: the track.
        gates: (n,) indices of the gates in the order of passage.
        start: (3,) m, where the way begins; None for anywhere in the first opening.
    """
    from scipy.optimize import minimize  # takes a while to import

    half = 0.5 * track.inner_sides[gates]
    middles, axes = track.positions[gates], track.rotations[gates][:, :, 1:]  # left and up in the opening

    def smoothed(places):
        directions, lengths = ways(places)
        return lengths.sum(), pulls(directions).ravel()

    def ways(places):
        points = middles + np.einsum("nij,nj->ni", axes, places.reshape(-1, 2))
        steps = np.diff(points if start is None else np.vstack([start, points]), axis=0)
        lengths = np.hypot(np.linalg.norm(steps, axis=1), SMOOTH_M)
        return steps / lengths[:, None], lengths

    def pulls(directions):
        """Return the slopes (n, 2) of the sum of lengths by the places in the openings."""
        return np.einsum("nij,ni->nj", axes, _ends(directions, start is None))

    bounds = [(-limit, limit) for limit in np.repeat(half, 2)]
    found = minimize(smoothed, np.zeros(2 * len(gates)), jac=True, method="L-BFGS-B", bounds=bounds, tol=1e-10)
    directions, _ = ways(found.x)
    along = np.sum(_ends(directions, start is None) * middles) - (0.0 if start is None else directions[0] @ start)
    return float(max(along - np.sum(half[:, None] * np.abs(pulls(directions))), 0.0))


def _ends(directions, free_start: bool) -> np.ndarray:
    """Return the slopes (n, 3) of the components along directions, by the points at which the ways end and begin."""
    none = np.zeros((1, 3))
    before = np.vstack([none, directions]) if free_start else directions
    after = np.vstack([directions, none]) if free_start else np.vstack([directions[1:], none])
    return before - after

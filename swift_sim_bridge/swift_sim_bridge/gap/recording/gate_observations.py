"""Gates in images: which one on the map each must be, and how far its corners are from where map and camera put them.

Pure. A gate in an image is compared with the gate whose corners it lies nearest to; what lies near none, near two, or
jumps between images is left out.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter

from swift_ros.camera.model import Camera
from swift_ros.recording.flight_table import DetectedGates
from swift_ros.track import FROM_BEHIND, Track, to_gate_frame
from swift_sim_bridge.sensors.camera import flown_camera, image_errors, project_corners
from swift_sim_bridge.sensors.clock import Moving, moving_at
from swift_sim_bridge.sensors.world import flown_track

GATES_PER_IMAGE = 2  # gates of an image that are compared, the largest ones
CORNERS = ("top left", "top right", "bottom right", "bottom left")
REACH, REACH_PX = 0.5, 5.0  # of its size in the image, and beyond, by which a gate may lie beside its place
APART = 2.0  # times farther, that any other gate must be
NEAREST_M = 1.0  # a nearer gate leaves the image, and what is left of it is blurred
GAP_S, LEAST_RUN, WINDOW = 0.2, 3, 5  # images of one gate belong together up to such a gap; so many at least
JUMP, JUMP_PX = 6.0, 1.5  # times the noise, and at least so far, that no corner jumps


@dataclass(frozen=True)
class GateObservations:
    """n gates in images: t (n,) s; gate (n,), its index on the map; behind (n,), whether it was seen from behind; run
    (n,), a number shared by neighbouring images of one gate from one side; corners (n, 4, 2) px in the order of
    `Track.corners`; camera and track: those that the stack believed in."""

    t: np.ndarray
    gate: np.ndarray
    behind: np.ndarray
    run: np.ndarray
    corners: np.ndarray
    camera: Camera
    track: Track

    def residual(self, t, moving: Moving, terms: dict) -> np.ndarray:
        """Return detected less projected corners (n, 4, 2) px, of a body that moves so (m, ...) at times t (m,) s."""
        seen, _ = projected(self.camera, self.track, self.gate, _filmed(self.t, t, moving, terms), terms)
        return self.corners - seen

    def places(self, t) -> tuple[np.ndarray, np.ndarray]:
        """Return the row (n,) of even times t (m,) s to which each belongs, and its rank (n,) there by size."""
        row = np.clip(np.rint((self.t - t[0]) / (t[1] - t[0])).astype(int), 0, len(t) - 1)
        order = np.lexsort((-_sizes(self.corners), row))
        first = np.searchsorted(row[order], row[order])
        rank = np.empty(len(row), int)
        rank[order] = np.arange(len(row)) - first
        return row, rank


def projected(camera: Camera, track: Track, gate, body: Moving, terms: dict) -> tuple[np.ndarray, np.ndarray]:
    """Return where bodies (n, ...) see the corners (n, 4, 2) px of one gate each, gate (n,), and whether all of them
    lie in the image circle (n,)."""
    corners = flown_track(track, terms).corners[gate]
    pixels, inside = project_corners(flown_camera(camera, terms), image_errors(terms), body, corners)
    return pixels, inside.all(axis=-1)


def _filmed(stamps, t, moving: Moving, terms: dict) -> Moving:
    late = terms.get("processing_latency")
    return moving_at(np.asarray(stamps) - (late.delay if late else 0.0), t, moving)


def _sizes(corners) -> np.ndarray:
    """Return the mean side (...) px of gates with corners (..., 4, 2)."""
    return np.linalg.norm(corners - np.roll(corners, 1, axis=-2), axis=-1).mean(axis=-1)


def associate_gates(seen: DetectedGates, t, moving: Moving, terms: dict) -> GateObservations:
    """Return the gates seen, with those on the map, by a body that moves so (m, ...) at times t (m,) s."""
    rows = np.flatnonzero((seen.t >= t[0]) & (seen.t <= t[-1]))
    stamps, corners = seen.t[rows], seen.corners[rows]
    body = _filmed(stamps, t, moving, terms)
    gate, behind, clear = _nearest(corners, body, seen.camera, flown_track(seen.track, terms), terms)
    rows, stamps, gate, behind = rows[clear], stamps[clear], gate[clear], behind[clear]
    corners = np.where(behind[:, None, None], corners[clear][:, FROM_BEHIND], corners[clear])
    found = GateObservations(stamps, gate, behind, _runs(stamps, gate, behind), corners, seen.camera, seen.track)
    return _steady(found, found.residual(t, moving, terms).reshape(len(stamps), 8))


def _nearest(corners, body: Moving, camera: Camera, track: Track, terms: dict):
    """Return for corners (n, 4, 2) the nearest gate (n,), whether it is seen from behind, and whether it is clear."""
    count, gates = len(corners), len(track.gates)
    flown, errors = flown_camera(camera, terms), image_errors(terms)
    pixels, inside = project_corners(flown, errors, body, track.corners.reshape(-1, 3))
    pixels, inside = pixels.reshape(count, gates, 4, 2), inside.reshape(count, gates, 4).all(axis=-1)
    local = to_gate_frame(track.positions, track.rotations, body.p_world[:, None])
    behind = local[..., 0] > 0
    pixels = np.where(behind[..., None, None], pixels[:, :, FROM_BEHIND], pixels)
    apart = np.sqrt(np.mean(np.sum((pixels - corners[:, None]) ** 2, axis=-1), axis=-1))
    apart = np.where(inside & (np.linalg.norm(local, axis=-1) > NEAREST_M), apart, np.inf)
    gate, each = np.argmin(apart, axis=1), np.arange(count)
    near, others = apart[each, gate], apart.copy()
    others[each, gate] = np.inf
    clear = (near < REACH * _sizes(pixels[each, gate]) + REACH_PX) & (others.min(axis=1) > APART * near)
    return gate, behind[each, gate], clear


def _runs(t, gate, behind) -> np.ndarray:
    """Return a number (n,) that neighbouring images of one gate from one side share."""
    side = 2 * gate + behind
    order = np.lexsort((t, side))
    new = (np.diff(side[order]) != 0) | (np.diff(t[order]) > GAP_S)
    run = np.empty(len(t), int)
    run[order] = np.concatenate([[0], np.cumsum(new)])[: len(t)]
    return run


def _steady(found: GateObservations, residual) -> GateObservations:
    """Return the sightings without those whose residual (n, 8) jumps away from its neighbours'."""
    smooth, steps, long = np.zeros_like(residual), [np.empty((0, residual.shape[1]))], np.zeros(len(residual), bool)
    for number in np.unique(found.run):
        rows = np.flatnonzero(found.run == number)
        if len(rows) >= LEAST_RUN:
            long[rows] = True
            smooth[rows] = median_filter(residual[rows], (WINDOW, 1), mode="mirror")
            steps.append(np.diff(residual[rows], axis=0))
    steps = np.concatenate(steps)
    noise = 1.4826 * float(np.median(np.abs(steps))) / np.sqrt(2.0) if len(steps) else 0.0
    kept = long & (np.abs(residual - smooth).max(axis=1, initial=0.0) < max(JUMP * noise, JUMP_PX))
    return GateObservations(
        found.t[kept],
        found.gate[kept],
        found.behind[kept],
        found.run[kept],
        found.corners[kept],
        found.camera,
        found.track,
    )


def seen_again(found: GateObservations, errors_px, t, moving: Moving, terms: dict) -> DetectedGates:
    """Return the same gates as another flight's detector would have told them at the same times, of a body that moves
    so (m, ...) at times t (m,) s; errors_px (n, 4, 2): by which its corners are off. What that flight cannot see is
    left out."""
    inside = (found.t >= t[0]) & (found.t <= t[-1])
    body = _filmed(found.t[inside], t, moving, terms)
    gate = found.gate[inside]
    track = flown_track(found.track, terms)
    corners, visible = projected(found.camera, found.track, gate, body, terms)
    local = to_gate_frame(track.positions[gate], track.rotations[gate], body.p_world)
    behind = local[:, 0] > 0
    corners = corners + errors_px[inside]
    corners = np.where(behind[:, None, None], corners[:, FROM_BEHIND], corners)
    visible &= behind == found.behind[inside]
    return DetectedGates(found.t[inside][visible], corners[visible], found.camera, found.track)

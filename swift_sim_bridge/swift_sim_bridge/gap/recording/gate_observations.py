"""Gates in images, each associated with a gate of the map, and the reprojection errors of their corners.

A detected gate is compared with the gate of the map whose projected corners are nearest. Detections near no gate, near
two gates, or with jumps between images are left out.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter

from swift_ros.camera.model import Camera
from swift_ros.corner_rays import ORDER_FROM_BEHIND
from swift_ros.recording.flight_table import DetectedGates
from swift_ros.track import Track, to_gate_frame
from swift_sim_bridge.sensors.camera import flown_camera, image_errors, project_corners
from swift_sim_bridge.sensors.clock import Moving, moving_at
from swift_sim_bridge.sensors.world import flown_track

GATES_PER_IMAGE = 2  # gates of an image that are compared: the largest ones
CORNERS = ("top left", "top right", "bottom right", "bottom left")
MAX_OFFSET, MAX_OFFSET_PX = 0.5, 5.0  # largest distance from the projected gate: share of its size, plus pixels
MIN_DISTANCE_RATIO = 2.0  # any other gate of the map must be so many times farther from the detection
MIN_DISTANCE_M = 1.0  # a gate nearer to the camera extends beyond the image and is blurred
MAX_GAP_S = 0.2  # longest time between two images of one run of a gate
MIN_RUN = 3  # images of a run; the noise cannot be estimated from fewer
MEDIAN_WINDOW = 5  # images of the median filter that follows the errors of a run
MAX_JUMP, MAX_JUMP_PX = 6.0, 1.5  # largest jump of a corner: times the noise, and pixels, whichever is more
SIGMA_FROM_MAD = 1.4826  # standard deviation of normal noise over its median absolute deviation


@dataclass(frozen=True)
class GateObservations:
    """n gates in images, associated with the gates of the map.

    Attributes:
        t: (n,) s.
        gate: (n,) index of the gate on the map.
        behind: (n,) bool, whether it was seen from behind.
        run: (n,) number shared by consecutive images of one gate from one side.
        corners: (n, 4, 2) px, in the order of `Track.corners`.
        camera: camera model with which the flight was flown.
        track: map with which the flight was flown.
    """

    t: np.ndarray
    gate: np.ndarray
    behind: np.ndarray
    run: np.ndarray
    corners: np.ndarray
    camera: Camera
    track: Track

    def residual(self, t, moving: Moving, terms: dict) -> np.ndarray:
        """Return detected minus projected corners (n, 4, 2) px.

        Args:
            t: (m,) s.
            moving: motion (m, ...) of the body at these times.
            terms: sensor terms of the vehicle.
        """
        expected, _ = projected(
            self.camera, self.track, self.gate, _motion_at_exposure(self.t, t, moving, terms), terms
        )
        return self.corners - expected

    def places(self, t) -> tuple[np.ndarray, np.ndarray]:
        """Return for each observation the nearest of uniform times and its rank in that image.

        Args:
            t: (m,) s, uniform.

        Returns:
            Row (n,) of t, and rank (n,) by size, 0 for the largest gate.
        """
        row = np.clip(np.rint((self.t - t[0]) / (t[1] - t[0])).astype(int), 0, len(t) - 1)
        order = np.lexsort((-_sizes(self.corners), row))
        first = np.searchsorted(row[order], row[order])
        rank = np.empty(len(row), int)
        rank[order] = np.arange(len(row)) - first
        return row, rank


def projected(camera: Camera, track: Track, gate, body: Moving, terms: dict) -> tuple[np.ndarray, np.ndarray]:
    """Return the projected corners (n, 4, 2) px of one gate for each pose, and whether (n,) all of them are visible.

    Args:
        camera: camera model.
        track: the map.
        gate: (n,) index of each gate.
        body: motion (n, ...) at the exposures.
        terms: sensor terms of the vehicle.
    """
    corners = flown_track(track, terms).corners[gate]
    pixels, inside = project_corners(flown_camera(camera, terms), image_errors(terms), body, corners)
    return pixels, inside.all(axis=-1)


def _motion_at_exposure(stamps, t, moving: Moving, terms: dict) -> Moving:
    """Return the motion (n, ...) at the exposure of images stamped so (n,) s."""
    latency = terms.get("processing_latency")
    return moving_at(np.asarray(stamps) - (latency.delay if latency else 0.0), t, moving)


def _sizes(corners) -> np.ndarray:
    """Return the mean side (...) px of gates with corners (..., 4, 2)."""
    return np.linalg.norm(corners - np.roll(corners, 1, axis=-2), axis=-1).mean(axis=-1)


def associate_gates(detected: DetectedGates, t, moving: Moving, terms: dict) -> GateObservations:
    """Return the detected gates with those of the map.

    Args:
        detected: gates in images.
        t: (m,) s.
        moving: motion (m, ...) of the body at these times.
        terms: sensor terms of the vehicle.
    """
    rows = np.flatnonzero((detected.t >= t[0]) & (detected.t <= t[-1]))
    stamps, corners = detected.t[rows], detected.corners[rows]
    body = _motion_at_exposure(stamps, t, moving, terms)
    gate, behind, clear = _nearest(corners, body, detected.camera, flown_track(detected.track, terms), terms)
    stamps, gate, behind = stamps[clear], gate[clear], behind[clear]
    corners = np.where(behind[:, None, None], corners[clear][:, ORDER_FROM_BEHIND], corners[clear])
    found = GateObservations(
        t=stamps,
        gate=gate,
        behind=behind,
        run=_runs(stamps, gate, behind),
        corners=corners,
        camera=detected.camera,
        track=detected.track,
    )
    return _without_jumps(found, found.residual(t, moving, terms).reshape(len(stamps), 8))


def _nearest(corners, body: Moving, camera: Camera, track: Track, terms: dict):
    """Return for corners (n, 4, 2) px the nearest gate (n,), whether from behind, and whether no other gate is near."""
    count, gates = len(corners), len(track.gates)
    flown, errors = flown_camera(camera, terms), image_errors(terms)
    pixels, inside = project_corners(flown, errors, body, track.corners.reshape(-1, 3))
    pixels, inside = pixels.reshape(count, gates, 4, 2), inside.reshape(count, gates, 4).all(axis=-1)
    in_gate_frame = to_gate_frame(track.positions, track.rotations, body.p_world[:, None])
    behind = in_gate_frame[..., 0] > 0
    pixels = np.where(behind[..., None, None], pixels[:, :, ORDER_FROM_BEHIND], pixels)
    distance_px = np.sqrt(np.mean(np.sum((pixels - corners[:, None]) ** 2, axis=-1), axis=-1))
    visible = inside & (np.linalg.norm(in_gate_frame, axis=-1) > MIN_DISTANCE_M)
    distance_px = np.where(visible, distance_px, np.inf)
    gate, each = np.argmin(distance_px, axis=1), np.arange(count)
    nearest_px, others_px = distance_px[each, gate], distance_px.copy()
    others_px[each, gate] = np.inf
    clear = (nearest_px < MAX_OFFSET * _sizes(pixels[each, gate]) + MAX_OFFSET_PX) & (
        others_px.min(axis=1) > MIN_DISTANCE_RATIO * nearest_px
    )
    return gate, behind[each, gate], clear


def _runs(t, gate, behind) -> np.ndarray:
    """Return a number (n,) that consecutive images of one gate from one side share."""
    side = 2 * gate + behind
    order = np.lexsort((t, side))
    begins = (np.diff(side[order]) != 0) | (np.diff(t[order]) > MAX_GAP_S)
    run = np.empty(len(t), int)
    run[order] = np.concatenate([[0], np.cumsum(begins)])[: len(t)]
    return run


def _without_jumps(found: GateObservations, residual) -> GateObservations:
    """Return the observations without short runs and without those whose residual (n, 8) px jumps."""
    smooth, steps = np.zeros_like(residual), [np.empty((0, residual.shape[1]))]
    in_run = np.zeros(len(residual), bool)
    for number in np.unique(found.run):
        rows = np.flatnonzero(found.run == number)
        if len(rows) >= MIN_RUN:
            in_run[rows] = True
            smooth[rows] = median_filter(residual[rows], (MEDIAN_WINDOW, 1), mode="mirror")
            steps.append(np.diff(residual[rows], axis=0))
    steps = np.concatenate(steps)
    noise = SIGMA_FROM_MAD * float(np.median(np.abs(steps))) / np.sqrt(2.0) if len(steps) else 0.0
    jump = np.abs(residual - smooth).max(axis=1, initial=0.0)
    kept = in_run & (jump < max(MAX_JUMP * noise, MAX_JUMP_PX))
    return GateObservations(
        t=found.t[kept],
        gate=found.gate[kept],
        behind=found.behind[kept],
        run=found.run[kept],
        corners=found.corners[kept],
        camera=found.camera,
        track=found.track,
    )


def redetected(found: GateObservations, errors_px, t, moving: Moving, terms: dict) -> DetectedGates:
    """Return the same gates as a detector would find them at the same times in another flight.

    Args:
        found: observations of the recording.
        errors_px: (n, 4, 2) errors of the detected corners.
        t: (m,) s.
        moving: motion (m, ...) of the other flight at these times.
        terms: sensor terms of the vehicle.

    Returns:
        The gates that are visible in the other flight from the same side.
    """
    inside = (found.t >= t[0]) & (found.t <= t[-1])
    body = _motion_at_exposure(found.t[inside], t, moving, terms)
    gate = found.gate[inside]
    track = flown_track(found.track, terms)
    corners, visible = projected(found.camera, found.track, gate, body, terms)
    in_gate_frame = to_gate_frame(track.positions[gate], track.rotations[gate], body.p_world)
    behind = in_gate_frame[:, 0] > 0
    corners = corners + errors_px[inside]
    corners = np.where(behind[:, None, None], corners[:, ORDER_FROM_BEHIND], corners)
    visible &= behind == found.behind[inside]
    return DetectedGates(found.t[inside][visible], corners[visible], found.camera, found.track)

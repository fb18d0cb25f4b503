"""The gates of a map as a camera images them from an estimated pose."""

import numpy as np

from swift_ros import geometry
from swift_ros.camera import model as lens
from swift_ros.camera.model import Camera
from swift_ros.track import Track, to_gate_frame

EDGE_POINTS = 9  # of each edge of a gate, which a fisheye lens bends


def gate_edges(camera: Camera, corners, p_world, q_world_body) -> list[tuple[int, np.ndarray]]:
    """Return the edges of the gates' openings, as far as the lens images them.

    Args:
        camera: model of lens and mount.
        corners: (n, 4, 3) of the gates in the map, m, such as `Track.corners`.
        p_world: (3,) m, position of base_link.
        q_world_body: (4,) its attitude.

    Returns:
        Index of the gate and pixels (k, 2) of each edge.
    """
    share = np.linspace(0, 1, EDGE_POINTS)[:, None]
    corners = np.asarray(corners)
    edges = corners[:, :, None] + share * (np.roll(corners, -1, axis=1) - corners)[:, :, None]
    q = np.broadcast_to(q_world_body, (*edges.shape[:-1], 4))
    pixels, angles = lens.project(camera, lens.world_to_camera(camera, p_world, q, edges))
    seen = np.argwhere((angles < camera.half_angle).all(axis=-1))
    return [(int(gate), pixels[gate, edge]) for gate, edge in seen]


def whole_gates(camera: Camera, track: Track, p_world, q_world_body) -> dict[int, float]:
    """Return the gates whose openings are whole in the image, by index, with the angle of the shortest side, rad.

    Args:
        camera: model of lens and mount.
        track: with the gates of the map; a corner behind the frame of another gate is not seen.
        p_world: (3,) m, position of base_link.
        q_world_body: (4,) its attitude.
    """
    q = np.broadcast_to(q_world_body, (*track.corners.shape[:-1], 4))
    rays = geometry.normalize(lens.world_to_camera(camera, p_world, q, track.corners))
    pixels, angles = lens.project(camera, rays)
    seen = (angles < camera.half_angle) & (lens.inside_px(camera, pixels) > 0.0)
    seen &= ~_behind_frames(track, p_world + geometry.rotate(q_world_body, camera.p_body_camera))
    sides = 2.0 * np.arcsin(0.5 * np.linalg.norm(rays - np.roll(rays, 1, axis=1), axis=-1))
    return {int(gate): float(sides[gate].min()) for gate in np.flatnonzero(seen.all(axis=1))}


def _behind_frames(track: Track, eye) -> np.ndarray:
    """Return the mask (n, 4) of the corners that the frame of another gate hides from a point (3,) of the map."""
    places, turns = track.positions[:, None, None], track.rotations[:, None, None]
    start, end = (
        to_gate_frame(places, turns, eye),
        to_gate_frame(places, turns, track.corners),
    )  # (n, n, 4, 3), of frames
    slope = start[..., 0] - end[..., 0]
    share = start[..., 0] / np.where(slope == 0.0, np.inf, slope)
    crossing = start + share[..., None] * (end - start)
    off_centre = 2.0 * np.abs(crossing[..., 1:]).max(axis=-1)
    inner, outer = track.inner_sides[:, None, None], track.outer_sides[:, None, None]
    hides = (share > 0.0) & (share < 1.0) & (off_centre > inner) & (off_centre < outer)
    hides[np.arange(len(hides)), np.arange(len(hides))] = False
    return hides.any(axis=0)

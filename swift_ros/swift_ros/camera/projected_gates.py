"""The gates of a map as a camera images them from an estimated pose."""

import numpy as np

from swift_ros.camera import model as lens
from swift_ros.camera.model import Camera

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

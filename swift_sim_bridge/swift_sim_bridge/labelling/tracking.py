"""Corners from frame to frame: optical flow from the corners that a person has accepted (Lucas and Kanade)."""

import cv2
import numpy as np

from swift_ros.camera import model as lens
from swift_sim_bridge.labels.labelled_images import (
    NOT_LABELLED,
    LabelledGate,
    LabelledImage,
    problem_of,
    r_world_camera,
)

WINDOW_PX = (21, 21)
LEVELS = 4  # of the image pyramid: with the window, movements up to about 100 px
MAX_RETURN_PX = 1.0  # a corner that is tracked there and back must return to this distance


def predicted(corners, before: LabelledImage, after: LabelledImage, camera) -> np.ndarray:
    """Return corners (n, 2) px after the rotation of the camera between two images of known attitude."""
    if before.q_world_camera is None or after.q_world_camera is None:
        return corners
    rays = lens.unproject(camera, corners)
    return lens.project(camera, rays @ r_world_camera(before).T @ r_world_camera(after))[0]


def track(gates, images, pixels, camera) -> list[LabelledGate]:
    """Return the gates of one image in the next one; those with a lost corner are left out.

    Args:
        gates: labelled in the first image.
        images: the two LabelledImage; only their attitudes and sizes are used.
        pixels: the two images (H, W) uint8.
        camera: of both.
    """
    found = []
    for gate in gates:
        known = gate.visibility != NOT_LABELLED
        start = gate.corners_px[known]
        moved = _flow(start, predicted(start, *images, camera), pixels)
        if moved is None:
            continue
        corners = np.full((4, 2), np.nan)
        corners[known] = moved
        next_gate = LabelledGate(corners, gate.visibility)
        if not problem_of(next_gate, images[1].width, images[1].height):
            found.append(next_gate)
    return found


def _flow(start, guess, pixels) -> np.ndarray | None:
    """Return points (n, 2) px in the second image; None when one of them is lost."""
    options = {"winSize": WINDOW_PX, "maxLevel": LEVELS, "flags": cv2.OPTFLOW_USE_INITIAL_FLOW}
    first, second = np.float32(start)[:, None], np.float32(guess)[:, None]
    there, seen, _ = cv2.calcOpticalFlowPyrLK(*pixels, first, second.copy(), **options)
    back, seen_back, _ = cv2.calcOpticalFlowPyrLK(*pixels[::-1], there, first.copy(), **options)
    off = np.linalg.norm(back - first, axis=-1).ravel()
    good = seen.ravel().astype(bool) & seen_back.ravel().astype(bool) & (off < MAX_RETURN_PX)
    return there[:, 0].astype(float) if good.all() else None

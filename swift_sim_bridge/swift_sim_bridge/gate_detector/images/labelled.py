"""Examples of labelled images: photographs and frames of flights, each time turned, scaled, mirrored and lit anew.

Labels stay exact under all of this, for they are rays. A turn is a change of the attitude by which the image is turned
upright, a scale one of its panorama.
"""

from dataclasses import replace

import cv2
import numpy as np

from swift_ros import geometry
from swift_ros.camera.model import Camera, unproject
from swift_ros.errors import UsageError
from swift_ros.perception.upright import UprightView
from swift_sim_bridge.gate_detector.corner_states import HIDDEN, IGNORED, VISIBLE
from swift_sim_bridge.gate_detector.images.targets import (
    Example,
    GateLabels,
    estimated_attitude,
    example_of,
    large_in_panorama,
)
from swift_sim_bridge.labels import gravity
from swift_sim_bridge.labels.folder import LabelledFolder
from swift_sim_bridge.labels.labelled_images import NOT_LABELLED, LabelledGate, LabelledImage

STATES = np.array([IGNORED, HIDDEN, VISIBLE])  # of a corner, by its visibility in the label
LABEL_ERROR_SHARE = 0.03  # of a gate's side: 2 px of a gate of 70 px; frames have wide and round inner edges
LEAST_SHAPE = 2  # labelled corners of a gate, from which the others are estimated
MOST_LEAN_DEG = 4.0  # turn about the optical axis; grouping allows posts to lean by 8.5 degrees
BY_GATES_ERROR_DEG = 1.5  # added where the attitude is that of the gates, standard deviation an axis
ZOOM = (0.7, 1.5)
GAIN, GAMMA = (0.5, 1.6), (0.6, 1.6)
MOST_NOISE = 6.0  # standard deviation in grey levels
MOST_BLUR_PX = 1.3  # standard deviation in px of the panorama; of every second image
MIRRORED = [1, 0, 3, 2]  # TL, TR, BR, BL in the order of a mirrored image


class LabelledExamples:
    """A source of examples from folders of labelled images, all images equally often.

    Args:
        settings: `DetectorTraining`.
        folders: of images.

    Raises:
        UsageError: no image has a label from which the network could learn.
    """

    def __init__(self, settings, folders: tuple[LabelledFolder, ...]):
        self._settings = settings
        images = [(folder, image) for folder in folders for image in folder.images]
        self._images = [(folder, image) for folder, image in images if _teaches(image)]
        self._attitudes: dict[LabelledImage, np.ndarray] = {}
        if not self._images:
            names = ", ".join(str(folder.path) for folder in folders)
            raise UsageError(f"no gate in {names} has two labelled corners; label more with `swiftros label`")

    def draw(self, rng) -> Example:
        """Return the next example. Raises UsageError when an image is damaged."""
        folder, image = self._images[rng.integers(0, len(self._images))]
        camera, pixels, (corners_px, visibility) = folder.camera(image), folder.pixels(image), _corners(image)
        r_world_camera = self._r_world_camera(folder, image)
        if rng.random() < 0.5:
            camera, pixels, r_world_camera = mirrored(camera, pixels, r_world_camera)
            corners_px = (corners_px * [-1.0, 1.0] + [image.width - 1.0, 0.0])[:, MIRRORED]
            visibility = visibility[:, MIRRORED]
        r_world_camera = self._attitude(r_world_camera, image.q_world_camera is not None, rng)
        view = UprightView(camera, self._settings.panorama, float(np.exp(rng.uniform(*np.log(ZOOM)))))
        is_complete = image.all_gates and all(np.sum(gate.visibility != NOT_LABELLED) > 2 for gate in image.gates)
        labels = self._labels(view, corners_px, visibility, r_world_camera)
        example = example_of(view, pixels, replace(labels, complete=is_complete), r_world_camera)
        return replace(example, panorama=relit(example.panorama, rng))

    def _r_world_camera(self, folder: LabelledFolder, image: LabelledImage) -> np.ndarray:
        """Return the attitude (3, 3) of an image, computed once."""
        if image not in self._attitudes:
            self._attitudes[image] = gravity.r_world_camera_by_gates(image, folder.camera(image))
        return self._attitudes[image]

    def _attitude(self, r_world_camera, is_known: bool, rng) -> np.ndarray:
        """Return an attitude (3, 3) with a random error, and a turn about the optical axis."""
        lean = np.array([0.0, 0.0, np.radians(rng.uniform(-MOST_LEAN_DEG, MOST_LEAN_DEG))])
        q_lean = geometry.quaternion_from_rotation_vector(lean)
        q_leaning = geometry.quaternion_multiply(geometry.quaternion_from_matrix(r_world_camera), q_lean)
        error_deg = self._settings.attitude_error_deg + (0.0 if is_known else BY_GATES_ERROR_DEG)
        return estimated_attitude(q_leaning, error_deg, rng)

    def _labels(self, view: UprightView, corners_px, visibility, r_world_camera) -> GateLabels:
        """Return the labels of gates with corners (n, 4, 2) px and their visibility (n, 4)."""
        rays = unproject(view.camera, corners_px)
        side_px = np.linalg.norm(corners_px - np.roll(corners_px, -1, axis=1), axis=-1).min(axis=1)
        least_px = self._settings.judged.least_side_px
        return GateLabels(
            rays_camera=rays,
            state=STATES[visibility],
            counts=(side_px >= least_px) & large_in_panorama(view, rays, r_world_camera, least_px),
            side_px=side_px,
            oblique_deg=np.zeros(len(rays)),
            distance=-side_px,
            error_share=LABEL_ERROR_SHARE,
        )


def _teaches(image: LabelledImage) -> bool:
    """Return whether any part of an image counts in training."""
    return any(_has_shape(gate) for gate in image.gates) or (image.all_gates and not image.gates)


def _has_shape(gate: LabelledGate) -> bool:
    return int(np.sum(gate.visibility != NOT_LABELLED)) >= LEAST_SHAPE


def _corners(image: LabelledImage) -> tuple[np.ndarray, np.ndarray]:
    """Return corners (n, 4, 2) px of the gates with a shape, those not labelled estimated, and visibility (n, 4)."""
    gates = [gate for gate in image.gates if _has_shape(gate)]
    corners = [completed(gate.corners_px) for gate in gates]
    return np.reshape(corners, (-1, 4, 2)), np.reshape([gate.visibility for gate in gates], (-1, 4)).astype(int)


def completed(corners_px) -> np.ndarray:
    """Return the corners (4, 2) px of a gate, NaN replaced: of a parallelogram by three, of a square by two corners."""
    corners = np.array(corners_px, dtype=float)
    known = np.isfinite(corners).all(axis=1)
    if known.sum() == 2:
        first, second = np.nonzero(known)[0]
        if second - first == 2:  # a diagonal; a quarter turn clockwise in the image leads from one corner to the next
            half = 0.5 * (corners[second] - corners[first])
            corners[first + 1] = corners[first] + half - _quarter_turn(half)
        else:
            start, end = (first, second) if second - first == 1 else (second, first)
            corners[(end + 1) % 4] = corners[end] + _quarter_turn(corners[end] - corners[start])
        known = np.isfinite(corners).all(axis=1)
    for k in np.nonzero(~known)[0]:
        corners[k] = corners[k - 1] + corners[(k + 1) % 4] - corners[(k + 2) % 4]
    return corners


def _quarter_turn(vector) -> np.ndarray:
    """Return a vector (2,) of the image turned clockwise as one sees it, by 90 degrees."""
    return np.array([-vector[1], vector[0]])


def mirrored(camera: Camera, pixels, r_world_camera):
    """Return camera, image and attitude (3, 3) as a mirror beside the camera, left to right, would show the world."""
    distortion = list(camera.distortion)
    if camera.lens.tangential and len(distortion) > 3:
        distortion[3] = -distortion[3]  # p2, the shift to the side
    turned = replace(camera, cx=camera.width - 1.0 - camera.cx, distortion=tuple(distortion))
    flip_world, flip_camera = np.diag([1.0, -1.0, 1.0]), np.diag([-1.0, 1.0, 1.0])
    return turned, np.ascontiguousarray(pixels[:, ::-1]), flip_world @ r_world_camera @ flip_camera


def relit(panorama, rng) -> np.ndarray:
    """Return a panorama (side, side) uint8 with random gain, gamma, blur and noise; what is outside stays black."""
    outside, levels = panorama == 0, panorama.astype(np.float32) / 255.0
    if rng.random() < 0.5:
        levels = cv2.GaussianBlur(levels, (0, 0), rng.uniform(0.2, MOST_BLUR_PX))
    gain, gamma = (np.exp(rng.uniform(*np.log(limits))) for limits in (GAIN, GAMMA))
    noise = rng.uniform(0.0, MOST_NOISE) * rng.standard_normal(panorama.shape, dtype=np.float32)
    grey = np.clip(255.0 * gain * levels**gamma + noise, 1.0, 255.0)
    return np.where(outside, 0, np.rint(grey)).astype(np.uint8)

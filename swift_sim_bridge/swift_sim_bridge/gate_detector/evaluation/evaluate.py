"""Recall and precision of the gate detector in held-out images, by distance, roll and number of visible corners.

Images are rendered from flown poses with motion blur. Textures have seeds that the training does not use, and every
second image has texture families that the training does not use. A true corner counts if its gate counts (size,
obliqueness, distance) and it is visible. A detected corner is correct within 3 px of the published image; one near an
ignored corner is left out. Detected corners are the network's peaks that an edge joins to another peak, whether or not
they form a whole gate.
"""

import time
from dataclasses import dataclass, field

import numpy as np

from swift_ros import geometry
from swift_ros.camera import model as lens
from swift_ros.perception.corner_grouping import FULL_OUTSET_SIDE_PX
from swift_sim_bridge.gate_detector import scores
from swift_sim_bridge.gate_detector.corner_states import HIDDEN, IGNORED, VISIBLE
from swift_sim_bridge.gate_detector.evaluation.flown_poses import FlownPoses
from swift_sim_bridge.gate_detector.evaluation.setup import DetectorSetup
from swift_sim_bridge.gate_detector.images.rendered import label_gates
from swift_sim_bridge.gate_detector.images.targets import GateLabels
from swift_sim_bridge.gate_detector.scores import NEAR_PX
from swift_sim_bridge.rendering import scene as scenes
from swift_sim_bridge.rendering import textures
from swift_sim_bridge.rendering.motion import BodyMotion
from swift_sim_bridge.rendering.renderer import CircleRenderer

ATTITUDE_ERROR_DEG = 1.0  # of the odometry that turns the view, about a random axis
GATE_NEAR_PX = 5.0  # all corners of a correct gate are within this of a whole gate's
GATE_IGNORED_PX = 12.0  # a wrong gate within this of an ignored gate is left out
MAX_PICTURES = 12  # images in the picture of the report
# Edges of the bins.
DISTANCES = (0.0, 3.0, 6.0, 9.0, 12.0, 16.0)  # m
ANGLES_DEG = (0, 30, 60, 90, 181)  # the last bin includes 180
IMAGE = ("roll", "tilt", "unseen_family")  # columns that describe the image


@dataclass(frozen=True)
class ImageSample:
    """The images of an evaluation.

    Attributes:
        images: number of images with gates.
        empty: number of images without gates.
        seed: of looks, poses and noise.
    """

    images: int
    empty: int
    seed: int


@dataclass(frozen=True)
class ImageTruth:
    """The truth of one image.

    Attributes:
        labels: of the gates.
        pixels: (n, 4, 2), corners in the published image.
        roll_deg: 0..180, angle in the image between its up and the world's up.
        tilt_deg: of the body.
        unseen_family: the textures are of a family that training does not use.
    """

    labels: GateLabels
    pixels: np.ndarray
    roll_deg: float
    tilt_deg: float
    unseen_family: bool


@dataclass
class Tally:
    """What was counted over the images.

    Attributes:
        truth: columns with an entry for each true corner: hit, distance (m) and visible corners of its gate, roll and
            tilt (deg) and unseen family of the image.
        found: columns with an entry for each detected corner: right, error (px), roll, tilt, unseen family.
        gates: number of whole gates, correct gates and reported gates.
        outset_px: of each correct large gate, mean distance in the panorama by which its corners are too far from its
            centre, px.
        shares: columns with an entry for each image: tilted over 45 degrees, several gates, a partly visible gate.
        cpu_ms: CPU time of each pass.
        empty_images, empty_with_gates: images without gates, and those with a detected gate.
        pictures: (image, gates, pixels, labels) of some images.
    """

    truth: dict[str, list] = field(default_factory=lambda: {k: [] for k in ("hit", "distance", "in_view", *IMAGE)})
    found: dict[str, list] = field(default_factory=lambda: {k: [] for k in ("right", "error_px", *IMAGE)})
    gates: dict[str, int] = field(default_factory=lambda: {"whole": 0, "right": 0, "reported": 0})
    outset_px: list[float] = field(default_factory=list)
    shares: dict[str, list] = field(default_factory=lambda: {k: [] for k in ("tilted", "several", "cut")})
    cpu_ms: list[float] = field(default_factory=list)
    empty_images: int = 0
    empty_with_gates: int = 0
    pictures: list = field(default_factory=list)


class HeldOut:
    """Scenes of the track with textures that training does not use, by seed or by family."""

    def __init__(self, camera, track, looks, rng):
        self._looks, self._track, self._rng = looks, track, rng
        families = (tuple(textures.FAMILIES), tuple(textures.HELD_OUT))
        self._circles = [CircleRenderer(camera, textures.stack(f, looks.textures, rng)) for f in families]

    def image(self, motion: BodyMotion, unseen_family: bool, empty: bool = False):
        """Return a new scene and its image (H, W) uint8."""
        scene = scenes.race_scene(self._track, self._looks, self._rng)
        scene = scenes.without_gates(scene) if empty else scene
        return scene, self._circles[unseen_family].render(scene, motion, self._looks.blur_poses, self._rng)


def evaluate(setup: DetectorSetup, poses: FlownPoses, sample: ImageSample, progress=None) -> Tally:
    """Render images, run the detector and return the Tally.

    Args:
        setup: the detector and its scenes.
        poses: from which poses are drawn, without replacement if there are enough.
        sample: how many images, and their seed.
        progress: called with (images done, images in all) after each image.
    """
    rng = np.random.default_rng([sample.seed, sample.images])
    held_out, tally = HeldOut(setup.camera, setup.track, setup.looks, rng), Tally()
    total = sample.images + sample.empty
    for n, k in enumerate(rng.choice(len(poses), total, replace=len(poses) < total)):
        empty, unseen_family, motion = n >= sample.images, bool(n % 2), poses.motion(k)
        scene, image = held_out.image(motion, unseen_family, empty)
        turn = ATTITUDE_ERROR_DEG * geometry.normalize(rng.standard_normal(3))
        error = geometry.quaternion_from_rotation_vector(np.radians(turn))
        q_estimate = geometry.quaternion_multiply(error, motion.q_world_body)
        began_s = time.process_time()
        gates = setup.detector.detect(image, q_estimate)
        tally.cpu_ms.append(1e3 * (time.process_time() - began_s))
        if empty:
            tally.empty_images += 1
            tally.empty_with_gates += bool(gates)
        else:
            truth = _image_truth(setup, scene, motion, unseen_family)
            _count(tally, setup.detector.corners(image, q_estimate), gates, truth)
            tally.outset_px += _outsets_px(setup.detector.view, gates, truth)
            if len(tally.pictures) < MAX_PICTURES and n % max(sample.images // MAX_PICTURES, 1) == 0:
                tally.pictures.append((image, gates, truth.pixels, truth.labels))
        if progress:
            progress(n + 1, total)
    return tally


def _image_truth(setup: DetectorSetup, scene, motion: BodyMotion, unseen_family: bool) -> ImageTruth:
    """Return the truth of the image of a scene."""
    camera, q_world_body = setup.camera, motion.q_world_body
    labels = label_gates(camera, scene.plates, len(setup.track.gates), motion.p_world, q_world_body, setup.limits)
    pixels = lens.project(camera, labels.rays_camera)[0]
    tilt_deg = float(np.degrees(geometry.tilt_of(q_world_body)))
    return ImageTruth(labels, pixels, _roll_deg(camera, q_world_body), tilt_deg, unseen_family)


def _count(tally: Tally, corners, gates, truth: ImageTruth):
    """Add the detected corners (by class) and gates of one image to the tally."""
    labels, pixels = truth.labels, truth.pixels
    counts = labels.counts[:, None] & (labels.state == VISIBLE)
    image = (truth.roll_deg, truth.tilt_deg, truth.unseen_family)
    whole = counts.all(axis=1)
    tally.shares["tilted"].append(image[1] > 45)
    tally.shares["several"].append(counts.any(axis=1).sum() >= 2)
    tally.shares["cut"].append(bool((counts.any(axis=1) & ~whole).any()))
    for k, (points, confidence) in enumerate(corners):
        true = np.nonzero(counts[:, k])[0]
        ignored = (labels.state[:, k] != HIDDEN) & ~counts[:, k]
        matches = scores.match(points, confidence, pixels[true, k], pixels[ignored, k])
        for gate, hit in zip(true, matches.truth >= 0, strict=True):
            _append(tally.truth, (bool(hit), float(labels.distance[gate]), int(counts[gate].sum()), *image))
        for right, error in zip(matches.right, matches.error_px, strict=True):
            _append(tally.found, (bool(right), float(error), *image))
    _count_gates(tally.gates, gates, pixels, whole, (labels.state == IGNORED).any(axis=1) | ~labels.counts)


def _append(columns, values):
    """Append a row of values to columns."""
    for column, value in zip(columns.values(), values, strict=True):
        column.append(value)


def _count_gates(count, gates, pixels, whole, ignored):
    """Add the detected gates of one image to `count`; `whole` and `ignored` (n,) bool are true gates."""
    free = set(np.nonzero(whole)[0])
    count["whole"] += len(free)
    for gate in gates:
        off = np.linalg.norm(pixels - gate.corners_px, axis=-1).max(axis=1)
        near = [i for i in free if off[i] < GATE_NEAR_PX]
        if near:
            free.discard(min(near, key=lambda i: off[i]))
            count["right"] += 1
        elif len(off) and off[ignored].size and off[ignored].min() < GATE_IGNORED_PX:
            continue
        count["reported"] += 1


def _outsets_px(view, gates, truth: ImageTruth) -> list[float]:
    """Return the outset of each correct gate that is large in the panorama; see `Tally.outset_px`."""
    outsets, density = [], view.panorama.pixels_per_radian
    for gate in gates:
        for true_px in truth.pixels[truth.labels.counts & (truth.labels.state == VISIBLE).all(axis=1)]:
            if np.linalg.norm(gate.corners_px - true_px, axis=-1).max() > GATE_NEAR_PX:
                continue
            detected, true = (lens.unproject(view.camera, px) for px in (gate.corners_px, true_px))
            arms = geometry.normalize(true - true.mean(axis=0))
            side_px = density * np.linalg.norm(true - np.roll(true, -1, axis=0), axis=-1).mean()
            if side_px >= FULL_OUTSET_SIDE_PX:
                outsets.append(density * float(np.sum((detected - true) * arms, axis=-1).mean()))
    return outsets


def _roll_deg(camera, q_world_body):
    """Return the angle (0..180 deg) in the image between its up and the world's up."""
    q = geometry.quaternion_multiply(q_world_body, camera.q_body_camera)
    up = geometry.rotate_inverse(q, np.array([0.0, 0.0, 1.0]))
    return float(abs(np.degrees(np.arctan2(up[0], -up[1]))))


def figures(tally: Tally) -> dict:
    """Return the figures of a tally, the content of `result.json`."""
    truth = {name: np.array(column) for name, column in tally.truth.items()}
    found = {name: np.array(column) for name, column in tally.found.items()}
    hit, right = truth["hit"].astype(bool), found["right"].astype(bool)
    error = found["error_px"][right]
    return {
        "images": len(tally.shares["tilted"]),
        "image_shares": {name: float(np.mean(column)) for name, column in tally.shares.items()},
        "corners": int(hit.size),
        "corner_recall": _share(hit),
        "corner_precision": _share(right),
        "within_px": NEAR_PX,
        "corner_error_px": {"median": float(np.median(error)), "rms_axis": float(np.sqrt(np.mean(error**2) / 2))}
        if error.size
        else None,
        "large_gates_outset_px": float(np.median(tally.outset_px)) if tally.outset_px else None,
        "recall_by_distance_m": _bins(hit, truth["distance"], DISTANCES),
        "recall_by_corners_in_view": {str(n): _entry(hit[truth["in_view"] == n]) for n in (1, 2, 3, 4)},
        "recall_by_roll_deg": _bins(hit, truth["roll"], ANGLES_DEG),
        "precision_by_roll_deg": _bins(right, found["roll"], ANGLES_DEG),
        "recall_by_tilt_deg": _bins(hit, truth["tilt"], ANGLES_DEG),
        "recall_unseen_families": _share(hit[truth["unseen_family"].astype(bool)]),
        "precision_unseen_families": _share(right[found["unseen_family"].astype(bool)]),
        "gates": tally.gates
        | {
            "recall": tally.gates["right"] / max(tally.gates["whole"], 1),
            "precision": tally.gates["right"] / max(tally.gates["reported"], 1),
        },
        "empty_images": tally.empty_images,
        "empty_images_with_gates": tally.empty_with_gates,
        "pass_cpu_ms": {"median": float(np.median(tally.cpu_ms)), "p99": float(np.percentile(tally.cpu_ms, 99))},
    }


def _share(values):
    return float(np.mean(values)) if len(values) else None


def _entry(values):
    return {"share": _share(values), "of": int(len(values))}


def _bins(values, by, edges):
    return {
        f"{low:g}-{high:g}": _entry(values[(by >= low) & (by < high)])
        for low, high in zip(edges[:-1], edges[1:], strict=True)
    }

"""How well the gate detector sees: corners and gates in held-out images, by distance, roll and visible fraction.

Images are rendered from flown poses with motion blur as flown; textures come from seeds and, for every second image,
from whole families that training never draws. A corner counts when its gate counts (size, obliqueness, distance) and it
is in view; a finding counts as right within 3 px of the published image. What is found near a corner that is not judged
is left out. Corners are the network's peaks that an edge joins to another, whole gate or not.
"""

import time
from dataclasses import dataclass, field

import numpy as np

from swift_ros import geometry
from swift_ros.camera import model as lens
from swift_sim_bridge.gate_detector import scores
from swift_sim_bridge.gate_detector.data import HIDDEN, NOT_JUDGED, SEEN, Judged, look
from swift_sim_bridge.gate_detector.scores import NEAR_PX
from swift_sim_bridge.rendering import scene as scenes
from swift_sim_bridge.rendering import textures
from swift_sim_bridge.rendering.renderer import CircleRenderer

ATTITUDE_ERROR_DEG = 1.0  # of the odometry that turns the view
DISTANCES = (0.0, 3.0, 6.0, 9.0, 12.0, 16.0)
ANGLES_DEG = (0, 30, 60, 90, 181)
IMAGE = ("roll", "tilt", "unseen_family")


@dataclass
class Tally:
    """What was counted over the images. One entry a true corner: hit, its gate's distance (m), the gate's corners in
    view, the image's roll and tilt (deg), unseen family; one entry a finding: right, confidence, error_px, roll, tilt.
    """

    truth: dict[str, list] = field(default_factory=lambda: {k: [] for k in ("hit", "distance", "in_view", *IMAGE)})
    found: dict[str, list] = field(default_factory=lambda: {k: [] for k in ("right", "error_px", *IMAGE)})
    gates: dict[str, int] = field(default_factory=lambda: {"whole": 0, "right": 0, "reported": 0})
    shares: dict[str, list] = field(default_factory=lambda: {k: [] for k in ("tilted", "several", "cut")})
    cpu_ms: list[float] = field(default_factory=list)
    empty_images: int = 0
    empty_with_gates: int = 0
    pictures: list = field(default_factory=list)


class HeldOut:
    """Scenes of the track with looks that training never drew; every second one of unseen texture families only."""

    def __init__(self, camera, track, looks, rng):
        self._looks, self._track, self._rng = looks, track, rng
        families = (tuple(textures.FAMILIES), tuple(textures.HELD_OUT))
        self._circles = [CircleRenderer(camera, textures.stack(f, looks.textures, rng)) for f in families]

    def image(self, poses, k: int, unseen: bool, empty: bool = False):
        """Return the scene and its image (H, W) uint8 from pose k."""
        scene = scenes.race_scene(self._track, self._looks, self._rng)
        scene = scenes.without_gates(scene) if empty else scene
        motion = (poses.p_world[k], poses.q_world_body[k], poses.v_world[k], poses.omega_body[k])
        return scene, self._circles[unseen].render(scene, *motion, self._looks.blur_poses, self._rng)


def evaluate(detector, camera, track, looks, judged: Judged, poses, *, images: int, empty: int, seed: int, tell=None):
    """Return the Tally of `images` images with gates and `empty` without, from poses drawn without replacement where
    there are enough. `tell(done, of)` hears of the progress."""
    rng = np.random.default_rng([seed, images])
    held_out, tally = HeldOut(camera, track, looks, rng), Tally()
    chosen = rng.choice(len(poses), images + empty, replace=len(poses) < images + empty)
    for n, k in enumerate(chosen):
        without, unseen = n >= images, bool(n % 2)
        scene, image = held_out.image(poses, k, unseen, without)
        turn = ATTITUDE_ERROR_DEG * geometry.normalize(rng.standard_normal(3))
        error = geometry.quaternion_from_rotation_vector(np.radians(turn))
        q_believed = geometry.quaternion_multiply(error, poses.q_world_body[k])
        began = time.process_time()
        gates = detector.detect(image, q_believed)
        tally.cpu_ms.append(1e3 * (time.process_time() - began))
        if without:
            tally.empty_images += 1
            tally.empty_with_gates += bool(gates)
        else:
            sight = look(camera, scene.plates, len(track.gates), poses.p_world[k], poses.q_world_body[k], judged)
            _count(tally, detector.corners(image, q_believed), gates, camera, sight, poses.q_world_body[k], unseen)
            if len(tally.pictures) < 12 and n % max(images // 12, 1) == 0:
                tally.pictures.append((image, gates, _pixels(camera, sight), sight))
        if tell:
            tell(n + 1, images + empty)
    return tally


def _pixels(camera, sight):
    return lens.project(camera, sight.rays_camera)[0]


def _count(tally, corners, gates, camera, sight, q_world_body, unseen):
    """Add one image to the tally."""
    pixels, counts = _pixels(camera, sight), sight.judged[:, None] & (sight.state == SEEN)
    image = (_roll_deg(camera, q_world_body), float(np.degrees(geometry.tilt_of(q_world_body))), unseen)
    whole = counts.all(axis=1)
    tally.shares["tilted"].append(image[1] > 45)
    tally.shares["several"].append(counts.any(axis=1).sum() >= 2)
    tally.shares["cut"].append(bool((counts.any(axis=1) & ~whole).any()))
    for k, (points, confidence) in enumerate(corners):
        mine = np.nonzero(counts[:, k])[0]
        forgiven = (sight.state[:, k] != HIDDEN) & ~counts[:, k]
        matches = scores.match(points, confidence, pixels[mine, k], pixels[forgiven, k])
        for gate, hit in zip(mine, matches.truth >= 0, strict=True):
            _append(tally.truth, (bool(hit), float(sight.distance[gate]), int(counts[gate].sum()), *image))
        for right, error in zip(matches.right, matches.error_px, strict=True):
            _append(tally.found, (bool(right), float(error), *image))
    _count_gates(tally.gates, gates, pixels, whole, (sight.state == NOT_JUDGED).any(axis=1) | ~sight.judged)


def _append(columns, values):
    for column, value in zip(columns.values(), values, strict=True):
        column.append(value)


def _count_gates(count, gates, pixels, whole, forgiven):
    """A reported gate is right when all its corners are within 5 px of a whole gate's; one on a gate that is not judged
    is left out."""
    free = set(np.nonzero(whole)[0])
    count["whole"] += len(free)
    for gate in gates:
        off = np.linalg.norm(pixels - gate.corners_px, axis=-1).max(axis=1)
        near = [i for i in free if off[i] < 5.0]
        if near:
            free.discard(min(near, key=lambda i: off[i]))
            count["right"] += 1
        elif len(off) and off[forgiven].size and off[forgiven].min() < 12.0:
            continue
        count["reported"] += 1


def _roll_deg(camera, q_world_body):
    """Return how far (0..180) the image's up is turned from where gravity's up appears in it."""
    q = geometry.quaternion_multiply(q_world_body, camera.q_body_camera)
    up = geometry.rotate_inverse(q, np.array([0.0, 0.0, 1.0]))
    return float(abs(np.degrees(np.arctan2(up[0], -up[1]))))


def figures(tally: Tally) -> dict:
    """Return the tally's figures as plain numbers: what `result.json` holds."""
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

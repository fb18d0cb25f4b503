"""Recall, precision and pose error of the gate detector on labelled images.

A true corner is one that is labelled visible, of a gate of at least the side that counts. A detected corner is correct
near a true one of its class: within 5 px, or a tenth of the gate's side if that is more. Detected corners near occluded
ones, and near gates that do not count, are left out. In an image in which not all gates are labelled, detected corners
far from all labels are counted separately: they may be right.
"""

from dataclasses import dataclass, field
from zlib import crc32

import numpy as np

from swift_ros import geometry
from swift_ros.camera.model import unproject
from swift_ros.corner_rays import ray_axes
from swift_ros.perception import gate_pose
from swift_ros.perception.gate_detector import GateDetector
from swift_ros.track import CORNER_SIGNS
from swift_sim_bridge.gate_detector.images.targets import estimated_attitude
from swift_sim_bridge.labels.folder import LabelledFolder
from swift_sim_bridge.labels.gravity import r_world_camera_by_gates
from swift_sim_bridge.labels.labelled_images import (
    OCCLUDED,
    VISIBLE,
    LabelledGate,
    LabelledImage,
    q_world_body,
    r_world_camera,
)

NEAR_PX, NEAR_SHARE = 5.0, 0.1  # px, and share of the gate's side: largest error of a correct corner
ATTITUDE_ERROR_DEG = 1.0  # of an estimate in flight, standard deviation an axis
FAR_SHARE = 1.0  # of the side: a detection further from all corners of a gate does not belong to it


@dataclass
class ImageTally:
    """Counts over labelled images.

    Attributes:
        images, empty: number of images, and of those without a gate.
        gates, whole: labelled gates that count, and those with four visible corners.
        small: labelled gates that do not count, for they are too small or no side of theirs is labelled.
        corners, hits: true corners, and detected ones of them.
        found, right: detected corners that count, and correct ones.
        elsewhere: detected corners far from the labels of images in which not all gates are labelled.
        reported, gates_right, gates_elsewhere: the same of whole gates.
        error_px: of correct corners.
        position_error, angle_error_deg: of gates that are found, m and degrees.
        without_pose: gates that are found and whose labels give no pose.
        rows: (share of corners missed or wrong, image, detected gates), for pictures.
    """

    images: int = 0
    empty: int = 0
    gates: int = 0
    whole: int = 0
    small: int = 0
    corners: int = 0
    hits: int = 0
    found: int = 0
    right: int = 0
    elsewhere: int = 0
    reported: int = 0
    gates_right: int = 0
    gates_elsewhere: int = 0
    error_px: list[float] = field(default_factory=list)
    position_error: list[float] = field(default_factory=list)
    angle_error_deg: list[float] = field(default_factory=list)
    without_pose: int = 0
    rows: list = field(default_factory=list)


def near_px(gate: LabelledGate) -> float:
    """Return the largest error (px) of a correct corner of a gate."""
    return max(NEAR_PX, NEAR_SHARE * gate.side_px)


class ImageEvaluation:
    """Runs a detector on labelled images and counts.

    Args:
        folder: of the images.
        detector: whose network and grouping are used, with the camera of each image.
        least_side_px: gates with a shorter mean side do not count.
        inner_side: of the gates, m, for errors of the pose; None without.
        level: take cameras of unknown attitude to be level. Otherwise the attitude is that of the labelled gates, with
            an error as of an estimate in flight: a vehicle knows it from its IMU.
    """

    def __init__(
        self,
        folder: LabelledFolder,
        detector: GateDetector,
        least_side_px: float,
        inner_side: float | None = None,
        level: bool = False,
    ):
        self._folder, self._network, self._grouping = folder, detector.network, detector.grouping
        self._least_side_px, self._inner_side, self._level = least_side_px, inner_side, level
        self._detectors: dict = {}
        self.tally = ImageTally()

    def add(self, image: LabelledImage) -> None:
        """Count one image."""
        camera = self._folder.camera(image)
        if camera not in self._detectors:
            self._detectors[camera] = GateDetector(camera, self._network, self._grouping)
        detector = self._detectors[camera]
        pixels, attitude = self._folder.pixels(image), q_world_body(self._attitude(image, camera), camera)
        corners, gates = detector.corners(pixels, attitude), detector.detect(pixels, attitude)
        tally, before = self.tally, (self.tally.corners - self.tally.hits, self.tally.found - self.tally.right)
        counted = [gate for gate in image.gates if gate.side_px >= self._least_side_px]
        tally.images += 1
        tally.empty += not image.gates
        tally.gates += len(counted)
        tally.small += len(image.gates) - len(counted)
        for k, (points, confidence) in enumerate(corners):
            self._count_corners(k, points[np.argsort(-confidence, kind="stable")], image, counted)
        self._count_gates(gates, image, counted, camera)
        wrong = tally.corners - tally.hits - before[0] + tally.found - tally.right - before[1]
        tally.rows.append((wrong, image, [np.asarray(gate.corners_px) for gate in gates]))

    def _attitude(self, image: LabelledImage, camera) -> np.ndarray:
        """Return the attitude (3, 3) by which an image is turned upright; the same in each evaluation."""
        if self._level or image.q_world_camera is not None:
            return r_world_camera(image)
        q_world_camera = geometry.quaternion_from_matrix(r_world_camera_by_gates(image, camera))
        rng = np.random.default_rng(crc32(image.file_name.encode()))
        return estimated_attitude(q_world_camera, ATTITUDE_ERROR_DEG, rng)

    def _count_corners(self, k: int, points, image: LabelledImage, counted: list[LabelledGate]) -> None:
        tally = self.tally
        free = [gate for gate in counted if gate.visibility[k] == VISIBLE]
        tally.corners += len(free)
        for point in points:
            off = [float(np.linalg.norm(gate.corners_px[k] - point)) for gate in free]
            best = int(np.argmin(off)) if off else -1
            if off and off[best] <= near_px(free[best]):
                tally.hits += 1
                tally.right += 1
                tally.error_px.append(off[best])
                free.pop(best)
            elif self._is_ignored(point, k, image, counted):
                continue
            elif not image.all_gates and _is_far(point, image.gates):
                tally.elsewhere += 1
                continue
            tally.found += 1

    def _is_ignored(self, point, k: int, image: LabelledImage, counted: list[LabelledGate]) -> bool:
        """Return whether a point is near a corner that counts neither as found nor as missed."""
        for gate in image.gates:
            near = np.linalg.norm(gate.corners_px - point, axis=-1) <= (near_px(gate) if gate.side_px > 0 else NEAR_PX)
            if gate not in counted and near.any():
                return True
            if gate.visibility[k] == OCCLUDED and near[k]:
                return True
        return False

    def _count_gates(self, gates, image: LabelledImage, counted: list[LabelledGate], camera) -> None:
        tally = self.tally
        free = [gate for gate in counted if gate.is_whole]
        others = [gate for gate in image.gates if gate not in free]
        tally.whole += len(free)
        for found in gates:
            points = np.asarray(found.corners_px)
            off = [np.linalg.norm(gate.corners_px - points, axis=-1).max() for gate in free]
            best = int(np.argmin(off)) if off else -1
            if off and off[best] <= near_px(free[best]):
                tally.gates_right += 1
                self._count_pose(free.pop(best), points, camera)
            elif any(_is_near_all(points, gate) for gate in others):
                continue
            elif not image.all_gates and all(_is_far(point, image.gates) for point in points):
                tally.gates_elsewhere += 1
                continue
            tally.reported += 1

    def _count_pose(self, gate: LabelledGate, points, camera) -> None:
        """Add the difference of the poses from the labelled and from the detected corners."""
        if self._inner_side is None:
            return
        poses = [_pose(corners, camera, self._inner_side) for corners in (gate.corners_px, points)]
        if poses[0] is None or poses[1] is None:
            self.tally.without_pose += 1
            return
        (p_true, r_true), (p_found, r_found) = poses
        self.tally.position_error.append(float(np.linalg.norm(p_found - p_true)))
        turn = geometry.quaternion_from_matrix(r_found.T @ r_true)
        self.tally.angle_error_deg.append(
            float(np.degrees(np.linalg.norm(geometry.rotation_vector_from_quaternion(turn))))
        )


def _is_far(point, gates) -> bool:
    """Return whether a point is further from all corners of each gate than the gate's side."""
    for gate in gates:
        off = np.linalg.norm(gate.corners_px - point, axis=-1)
        if np.nanmin(off) <= max(FAR_SHARE * gate.side_px if gate.side_px > 0 else 0.0, NEAR_PX):
            return False
    return True


def _is_near_all(points, gate: LabelledGate) -> bool:
    """Return whether the labelled corners of a gate are near four detected points (4, 2)."""
    off = np.linalg.norm(gate.corners_px - points, axis=-1)
    known = np.isfinite(off)
    return bool((off[known] <= (near_px(gate) if gate.side_px > 0 else NEAR_PX)).all())


def _pose(corners_px, camera, inner_side: float) -> tuple[np.ndarray, np.ndarray] | None:
    """Return position (3,) of a gate in the optical frame and its attitude (3, 3); None where there is none."""
    rays = unproject(camera, np.asarray(corners_px, dtype=float))
    solvable, *start = gate_pose.solve_square(inner_side, rays)
    if not solvable:
        return None
    views = gate_pose.fit(0.5 * inner_side * CORNER_SIGNS, ray_axes(rays), *start)
    best = int(np.argmin(views.error))
    return views.p_camera_gate[best], views.rotation[best].T


def figures(tally: ImageTally) -> dict:
    """Return the figures of a tally, the content of `result.json`."""
    return {
        "images": tally.images,
        "images_without_gate": tally.empty,
        "gates": tally.gates,
        "gates_too_small": tally.small,
        "corners": {
            "labelled": tally.corners,
            "detected": tally.found,
            "recall": _share(tally.hits, tally.corners),
            "precision": _share(tally.right, tally.found),
            "elsewhere": tally.elsewhere,
            "error_px": _spread(tally.error_px),
        },
        "whole_gates": {
            "labelled": tally.whole,
            "detected": tally.reported,
            "recall": _share(tally.gates_right, tally.whole),
            "precision": _share(tally.gates_right, tally.reported),
            "elsewhere": tally.gates_elsewhere,
        },
        "pose": {
            "position_error_m": _spread(tally.position_error),
            "angle_error_deg": _spread(tally.angle_error_deg),
            "gates_without_pose": tally.without_pose,
        },
        "within": {"px": NEAR_PX, "share_of_side": NEAR_SHARE},
    }


def _share(part: int, whole: int) -> float | None:
    return part / whole if whole else None


def _spread(values: list[float]) -> dict | None:
    if not values:
        return None
    return {"median": float(np.median(values)), "p90": float(np.percentile(values, 90)), "of": len(values)}

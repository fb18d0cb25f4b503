"""Proposed gates of an image: of the map, of the detector, or tracked from the image before."""

from dataclasses import dataclass

import numpy as np

from swift_ros.perception.gate_detector import GateDetector
from swift_sim_bridge.gate_detector.evaluation.setup import DetectorSetup
from swift_sim_bridge.labelling import map_labels, tracking
from swift_sim_bridge.labelling.frames import Frames
from swift_sim_bridge.labels.labelled_images import (
    VISIBLE,
    LabelledGate,
    LabelledImage,
    problem_of,
    q_world_body,
    r_world_camera,
)

MAP, DETECTOR, TRACKED = "map", "detector", "tracked"
SAME_SHARE = 0.3  # of the side: two proposals whose corners are nearer to each other on average are one gate


@dataclass(frozen=True, eq=False)
class Proposal:
    """One proposed gate, and where it comes from: MAP, DETECTOR or TRACKED."""

    gate: LabelledGate
    origin: str


class Proposer:
    """Proposes the gates of frames.

    Args:
        frames: to label.
        setup: with the detector's network.
    """

    def __init__(self, frames: Frames, setup: DetectorSetup):
        self.frames, self.setup, self.folder = frames, setup, frames.with_labels()
        self._detectors: dict = {}
        self._detected: dict[str, list[LabelledGate]] = {}

    def detector(self, image: LabelledImage) -> GateDetector:
        """Return the detector for the camera of an image."""
        camera = self.folder.camera(image)
        if camera not in self._detectors:
            self._detectors[camera] = GateDetector(camera, self.setup.detector.network, self.setup.detector.grouping)
        return self._detectors[camera]

    def detected(self, image: LabelledImage) -> list[LabelledGate]:
        """Return the gates that the detector finds in an image; they are kept."""
        if image.file_name in self._detected:
            return self._detected[image.file_name]
        detector = self.detector(image)
        found = detector.detect(self.folder.pixels(image), q_world_body(r_world_camera(image), detector.camera))
        gates = [LabelledGate(np.asarray(gate.corners_px), np.full(4, VISIBLE)) for gate in found]
        self._detected[image.file_name] = [g for g in gates if not problem_of(g, image.width, image.height)]
        return self._detected[image.file_name]

    def from_map(self, image: LabelledImage) -> tuple[list[LabelledGate], bool]:
        """Return the gates of the map in an image, and whether these are all; none without a pose."""
        flight = self.frames.flight
        if flight is None or image.file_name not in flight.poses:
            return [], False
        state = flight.poses[image.file_name]
        return map_labels.project(self.folder.camera(image), self.setup, flight.track, state)

    def propose(self, image: LabelledImage, before: LabelledImage | None) -> list[Proposal]:
        """Return the proposals for an image.

        True poses in the map are better than all else. Otherwise the detector comes first, then what is tracked, then
        the map from an estimated pose.

        Args:
            image: to label.
            before: the labelled image before it in its sequence, None without one.
        """
        flight = self.frames.flight
        if flight is not None and flight.is_true and image.file_name in flight.poses:
            return [Proposal(gate, MAP) for gate in self.from_map(image)[0]]
        found = [Proposal(gate, DETECTOR) for gate in self.detected(image)]
        if before is not None and (before.width, before.height) == (image.width, image.height):
            pixels = self.folder.pixels(before), self.folder.pixels(image)
            tracked = tracking.track(before.gates, (before, image), pixels, self.folder.camera(image))
            found += [Proposal(gate, TRACKED) for gate in tracked]
        found += [Proposal(gate, MAP) for gate in self.from_map(image)[0]]
        return _distinct(found)


def _distinct(proposals: list[Proposal]) -> list[Proposal]:
    """Return the proposals without those that repeat an earlier one."""
    kept: list[Proposal] = []
    for one in proposals:
        if not any(is_same(one.gate, other.gate) for other in kept):
            kept.append(one)
    return kept


def is_same(one: LabelledGate, other: LabelledGate) -> bool:
    """Return whether two gates are nearly at the same place in an image."""
    off = np.linalg.norm(one.corners_px - other.corners_px, axis=-1)
    both = np.isfinite(off)
    side = np.nanmax([one.side_px, other.side_px]) if np.isfinite([one.side_px, other.side_px]).any() else 0.0
    return bool(both.any() and off[both].mean() <= max(SAME_SHARE * side, 2.0))

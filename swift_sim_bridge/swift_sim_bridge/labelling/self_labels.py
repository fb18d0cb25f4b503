"""Labels of a flight without a person: gates of the map from known poses, where the image agrees with them."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

from swift_ros.errors import UsageError
from swift_sim_bridge.labelling.agreement import agrees_with_edges, compared_with_corners
from swift_sim_bridge.labelling.proposals import Proposer
from swift_sim_bridge.labels.labelled_images import FLIGHT, LabelledImage, q_world_body, r_world_camera

NO_POSE, NO_GATE, DRIFT = "without a pose at their stamp", "without a whole gate to check", "the image disagrees"


@dataclass
class SelfLabels:
    """Result of labelling a flight.

    Attributes:
        images: labelled.
        left_out: number of frames by reason.
        by_corners, by_edges: checked gates that the detector, or only the edges of the image, confirm.
    """

    images: list[LabelledImage] = field(default_factory=list)
    left_out: dict[str, int] = field(default_factory=lambda: dict.fromkeys((NO_POSE, NO_GATE, DRIFT), 0))
    by_corners: int = 0
    by_edges: int = 0

    def sentences(self) -> list[str]:
        """Return what to print."""
        gates = sum(len(image.gates) for image in self.images)
        counts = ", ".join(f"{number} {why}" for why, number in self.left_out.items())
        return [
            f"{len(self.images)} frames labelled with {gates} gates; {self.by_corners} confirmed by the detector, "
            f"{self.by_edges} by the edges of the image",
            f"{sum(self.left_out.values())} frames left out: {counts}",
        ]


def label_flight(proposer: Proposer, progress: Callable[[int, int], None] | None = None) -> SelfLabels:
    """Label the frames of a bag where its poses agree with the images.

    In each frame all whole gates of the map must be where the detector finds their corners or, where it finds none in
    sight, where the image has edges. A frame in which one is elsewhere is left out: its pose has drifted, or something
    hides the gate.

    Args:
        proposer: of the frames of a bag.
        progress: called with (frames done, frames in all).

    Raises:
        UsageError: there are no poses in the map.
    """
    frames, result = proposer.frames, SelfLabels()
    if frames.flight is None:
        raise UsageError("--self-label needs poses in the map: ground truth, motion capture or state/odometry of a bag")
    for number, image in enumerate(frames.images, start=1):
        reason = _label(proposer, image, result)
        if reason:
            result.left_out[reason] += 1
        if progress:
            progress(number, len(frames.images))
    return result


def _label(proposer: Proposer, image: LabelledImage, result: SelfLabels) -> str:
    """Add an image to the result, or return why not."""
    flight = proposer.frames.flight
    if flight is None or image.file_name not in flight.poses:
        return NO_POSE
    gates, complete = proposer.from_map(image)
    least = proposer.setup.limits.least_side_px
    checked = [gate for gate in gates if gate.is_whole and gate.side_px >= least]
    if not checked:
        return NO_GATE
    pixels, detector = proposer.folder.pixels(image), proposer.detector(image)
    corners = detector.corners(pixels, q_world_body(r_world_camera(image), detector.camera))
    compared = [compared_with_corners(gate, corners) for gate in checked]
    unseen = [gate for gate, agrees in zip(checked, compared, strict=True) if agrees is None]
    if False in compared or not all(agrees_with_edges(gate, pixels, detector.camera) for gate in unseen):
        return DRIFT
    result.by_corners += len(checked) - len(unseen)
    result.by_edges += len(unseen)
    result.images.append(replace(image, gates=tuple(gates), all_gates=complete, source=FLIGHT))
    return ""

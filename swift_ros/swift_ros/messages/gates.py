"""Gates in an image: their corners, their poses, and how they corrected the state."""

from collections.abc import Sequence

import numpy as np
from builtin_interfaces.msg import Time

from swift_msgs.msg import GateDetection, GateDetections, GatePose, GatePoses, StateUpdate, StateUpdates
from swift_msgs.msg import IncompleteGate as IncompleteGateMessage
from swift_ros.messages.stamps import to_time
from swift_ros.messages.vectors import from_quaternion, from_xyz, to_pose
from swift_ros.types import GateCorners, GateUpdate, IncompleteGate, RelativeGatePose


def to_detections(header, gates: list[GateCorners], incomplete: Sequence[GateCorners] = ()) -> GateDetections:
    """Return swift_msgs/GateDetections for the image with a header."""
    return GateDetections(header=header, gates=_to_corners(gates), incomplete=_to_corners(incomplete))


def _to_corners(gates: Sequence[GateCorners]) -> list[GateDetection]:
    return [
        GateDetection(corners=np.asarray(g.corners_px, dtype=float).ravel(), confidence=np.asarray(g.confidence, float))
        for g in gates
    ]


def from_detections(message: GateDetections) -> list[GateCorners]:
    """Return the detected gates of a message, without incomplete ones."""
    return _from_corners(message.gates)


def incomplete_from_detections(message: GateDetections) -> list[GateCorners]:
    """Return the incomplete gates of a message."""
    return _from_corners(message.incomplete)


def _from_corners(gates) -> list[GateCorners]:
    return [GateCorners(np.array(g.corners).reshape(4, 2), np.array(g.confidence)) for g in gates]


def to_gate_poses(
    image_stamp: Time, gates: list[RelativeGatePose], incomplete: Sequence[IncompleteGate] = ()
) -> GatePoses:
    """Return swift_msgs/GatePoses for the image with a stamp."""
    message = GatePoses()
    message.header.stamp = image_stamp
    message.header.frame_id = "base_link"
    message.gates = [
        GatePose(
            pose=to_pose(gate.p_body, gate.q_body_gate),
            reprojection_error=float(gate.reprojection_error),
            alternative_pose=to_pose(gate.alternative_p_body, gate.alternative_q_body_gate),
            alternative_reprojection_error=float(gate.alternative_reprojection_error),
            position_covariance=np.asarray(gate.covariance, dtype=float).ravel(),
            rays=np.asarray(gate.rays_body, dtype=float).ravel(),
            confidence=float(gate.confidence),
        )
        for gate in gates
    ]
    message.incomplete = [
        IncompleteGateMessage(rays=np.asarray(gate.rays_body, dtype=float).ravel(), confidence=float(gate.confidence))
        for gate in incomplete
    ]
    return message


def from_gate_poses(message: GatePoses) -> list[RelativeGatePose]:
    """Return the gate poses of a message."""
    return [
        RelativeGatePose(
            p_body=from_xyz(g.pose.position),
            q_body_gate=from_quaternion(g.pose.orientation),
            covariance=np.array(g.position_covariance).reshape(3, 3),
            rays_body=np.array(g.rays).reshape(4, 3),
            confidence=g.confidence,
            reprojection_error=g.reprojection_error,
            alternative_p_body=from_xyz(g.alternative_pose.position),
            alternative_q_body_gate=from_quaternion(g.alternative_pose.orientation),
            alternative_reprojection_error=g.alternative_reprojection_error,
        )
        for g in message.gates
    ]


def incomplete_from_gate_poses(message: GatePoses) -> list[IncompleteGate]:
    """Return the incomplete gates of a message."""
    return [IncompleteGate(np.array(g.rays).reshape(4, 3), g.confidence) for g in message.incomplete]


def to_state_updates(image_stamp_ns: int, updates: list[GateUpdate]) -> StateUpdates:
    """Return swift_msgs/StateUpdates for the image with a stamp (ns)."""
    message = StateUpdates()
    message.header.stamp = to_time(image_stamp_ns)
    message.header.frame_id = "map"
    rows = []
    for update in updates:
        row = StateUpdate(gate=int(update.gate), mahalanobis=float(update.mahalanobis), accepted=bool(update.accepted))
        row.innovation = np.asarray(update.innovation, dtype=float)
        row.reason = update.reason
        rows.append(row)
    message.updates = rows
    return message


def from_state_updates(message: StateUpdates) -> list[GateUpdate]:
    """Return the results for the gates of one image."""
    return [
        GateUpdate(row.gate, np.array(row.innovation), row.mahalanobis, row.accepted, row.reason)
        for row in message.updates
    ]

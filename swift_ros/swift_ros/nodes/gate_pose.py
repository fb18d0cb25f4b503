"""Node gate_pose: publishes the poses of the gates detected in an image, an empty message when there are none."""

from swift_ros import configuration
from swift_ros.camera.model import Camera
from swift_ros.messages.gates import from_detections, incomplete_from_detections, to_gate_poses
from swift_ros.messages.stamps import from_time
from swift_ros.nodes.shell import Shell, run
from swift_ros.perception.gate_pose import GatePoses, GatePoseSettings
from swift_ros.track import Track


class GatePoseNode(Shell):
    """Subscribes gates/detections, publishes gates/poses."""

    def __init__(self):
        super().__init__("gate_pose", GatePoseSettings)
        camera = configuration.load(Camera, self.folder / "camera.yaml")
        track = configuration.load(Track, self.folder / "track.yaml")
        self._gate_poses = GatePoses(self.settings, camera, track.inner_side)
        self._poses = self.publisher("gates/poses")
        self.subscribe("gates/detections", self._on_detections)

    def _on_detections(self, message):
        stamp = message.header.stamp
        gates = from_detections(message)
        poses, warnings = self._gate_poses.locate(from_time(stamp), gates)
        incomplete, more_warnings = self._gate_poses.rays(incomplete_from_detections(message))
        self._poses.publish(to_gate_poses(stamp, poses, incomplete))
        for warning in warnings + more_warnings:
            self.diagnose("ok", warning)


def main():
    """Run the node."""
    run(GatePoseNode)

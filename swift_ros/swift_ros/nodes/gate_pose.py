"""Node gate_pose: answers the corners of every image with the poses of their gates, empty when there are none."""

from swift_ros import configuration, messages
from swift_ros.camera.model import Camera
from swift_ros.nodes.shell import Shell, run
from swift_ros.perception.gate_pose import GatePoses, GatePoseSettings
from swift_ros.track import Track


class GatePoseNode(Shell):
    """gates/detections in, gates/poses out."""

    def __init__(self):
        super().__init__("gate_pose", GatePoseSettings)
        camera = configuration.load(Camera, self.folder / "camera.yaml")
        track = configuration.load(Track, self.folder / "track.yaml")
        self._gate_poses = GatePoses(self.settings, camera, track.inner_side)
        self._poses = self.speak("gates/poses")
        self.hear("gates/detections", self._on_detections)

    def _on_detections(self, message):
        stamp = message.header.stamp
        gates = messages.from_detections(message)
        poses, complaints = self._gate_poses.locate(messages.stamp_ns(stamp), gates)
        self._poses.publish(messages.to_gate_poses(stamp, poses))
        for complaint in complaints:
            self.diagnose("ok", complaint)


def main():
    run(GatePoseNode)

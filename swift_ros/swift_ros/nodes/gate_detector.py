"""Node gate_detector: publishes one message for every image with the gates in it, empty when there are none."""

import numpy as np

from swift_ros import configuration
from swift_ros.camera import model as lens
from swift_ros.messages.camera import from_image
from swift_ros.messages.gates import to_detections
from swift_ros.messages.motion import odometry_from_bytes
from swift_ros.messages.stamps import from_time
from swift_ros.nodes.shell import Shell, run
from swift_ros.perception.corner_grouping import GroupingSettings
from swift_ros.perception.corner_network import CornerNetwork
from swift_ros.perception.gate_detector import AttitudeAtStamp, GateDetector
from swift_ros.perception.mount_search import MountSearch
from swift_ros.perception.settings import DetectorSettings


class GateDetectorNode(Shell):
    """Subscribes camera/image_raw and vio/odometry (for the attitude), publishes gates/detections."""

    def __init__(self):
        super().__init__("gate_detector", DetectorSettings)
        settings = self.settings
        network = CornerNetwork(self.folder / settings.model, settings.providers)
        grouping = GroupingSettings(
            settings.peak_threshold,
            settings.edge_threshold,
            settings.most_peaks,
            network.shape.stride,
            settings.corner_outset_px,
        )
        camera = configuration.load(lens.Camera, self.folder / "camera.yaml")
        detector = GateDetector(camera, network, grouping)
        detector.detect(np.zeros((camera.height, camera.width), np.uint8), np.array([0.0, 0.0, 0.0, 1.0]))
        self._detector = MountSearch(detector)
        missing = (
            f" ({', '.join(network.unavailable_providers)}: not in this ONNX Runtime)"
            if network.unavailable_providers
            else ""
        )
        self.get_logger().info(f"{settings.model} runs on {network.provider}{missing}")
        self._attitude = AttitudeAtStamp(self.lockstep, settings.attitude_patience_s)
        self._detections = self.publisher("gates/detections")
        self.subscribe("vio/odometry", self._on_odometry, raw=True)
        self.subscribe("camera/image_raw", self._on_image)

    def _on_odometry(self, data: bytes):
        odometry = odometry_from_bytes(data)
        self._detector.odometry(odometry)
        try:
            self._attitude.add_odometry(odometry)
        except ValueError as error:
            self.get_logger().error(f"vio/odometry: {error}", throttle_duration_sec=1.0)
        self._process_ready_images()

    def _on_image(self, message):
        self._attitude.add_image(from_time(message.header.stamp), message)
        self._process_ready_images()

    def _process_ready_images(self):
        for image, q_world_body in self._attitude.ready_images():
            found = [], []
            try:
                if q_world_body is not None:
                    found = self._detector.detect_all(from_image(image), q_world_body)
            except ValueError as error:
                self.get_logger().error(f"camera/image_raw: {error}", throttle_duration_sec=1.0)
            self._detections.publish(to_detections(image.header, *found))


def main():
    """Run the node."""
    run(GateDetectorNode)

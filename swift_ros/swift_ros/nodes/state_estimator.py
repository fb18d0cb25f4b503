"""Node state_estimator: odometry corrected by gate observations, as the pose map -> base_link."""

from swift_ros import configuration
from swift_ros.camera.model import Camera
from swift_ros.estimation.estimator import EstimatorOutput, StateEstimator
from swift_ros.estimation.settings import EstimatorSettings
from swift_ros.messages.gates import from_gate_poses, incomplete_from_gate_poses, to_state_updates
from swift_ros.messages.motion import imu_from_bytes, odometry_bytes, odometry_from_bytes
from swift_ros.messages.stamps import from_time
from swift_ros.nodes.shell import Shell, run
from swift_ros.track import Track


class StateEstimatorNode(Shell):
    """Subscribes vio/odometry, imu/data_raw, gates/poses and camera/camera_info.

    Publishes state/odometry and state/updates.
    """

    def __init__(self):
        super().__init__("state_estimator", EstimatorSettings)
        track = configuration.load(Track, self.folder / "track.yaml")
        camera = configuration.load(Camera, self.folder / "camera.yaml")
        self._estimator = StateEstimator(self.settings, track, camera, self.lockstep)
        self._state = self.publisher("state/odometry")
        self._updates = self.publisher("state/updates")
        # In lockstep a state waits for the gates of each image; camera_info announces the image in a small message.
        self.subscribe("camera/camera_info", self._on_image)
        self.subscribe("gates/poses", self._on_gates)
        self._new_imu = self.poll("imu/data_raw")
        self.subscribe("vio/odometry", self._on_odometry, raw=True)

    def _on_image(self, message):
        self._estimator.image(from_time(message.header.stamp))

    def _take_imu(self):
        for data in self._new_imu():
            self._estimator.imu(imu_from_bytes(data))

    def _on_odometry(self, data: bytes):
        self._take_imu()
        self._send(self._estimator.odometry(odometry_from_bytes(data)))

    def _on_gates(self, message):
        stamp_ns = from_time(message.header.stamp)
        incomplete = incomplete_from_gate_poses(message)
        self._take_imu()
        self._send(self._estimator.gates(stamp_ns, from_gate_poses(message), incomplete))

    def _send(self, output: EstimatorOutput):
        for state in output.states:
            self._state.publish(odometry_bytes(state, "map"))
        for stamp_ns, updates in output.updates:
            self._updates.publish(to_state_updates(stamp_ns, updates))
        for warning in output.warnings:
            self.diagnose("warn", warning)


def main():
    """Run the node."""
    run(StateEstimatorNode)

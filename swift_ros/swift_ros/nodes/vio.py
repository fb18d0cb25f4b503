"""Node vio: checks odometry, by the IMU too, and converts it from the source's own frames to odom -> base_link."""

from collections import deque

from swift_ros.estimation.odometry_check.vio_guard import VioGuard, VioSettings
from swift_ros.graph.qos import DEEP
from swift_ros.messages.motion import imu_from_bytes, odometry_bytes, odometry_from_bytes
from swift_ros.nodes.shell import Shell, run


class VioNode(Shell):
    """Subscribes vio/raw and imu/data_raw, publishes vio/odometry."""

    def __init__(self):
        super().__init__("vio", VioSettings)
        self._guard = VioGuard(self.settings)
        self._odometry = self.publisher("vio/odometry")
        self._new_imu, self._imu = self.poll("imu/data_raw"), deque(maxlen=DEEP)
        self.subscribe("vio/raw", self._on_raw, raw=True)

    def _on_raw(self, data: bytes):
        raw = odometry_from_bytes(data)
        self._imu.extend(map(imu_from_bytes, self._new_imu()))
        while self._imu and self._imu[0].stamp_ns <= raw.stamp_ns:  # dead reckoning must not run ahead of the odometry
            self._guard.imu(self._imu.popleft())
        checked = self._guard.check(raw)
        odometry = checked.odometry or checked.bridge
        if odometry is not None:
            self._odometry.publish(odometry_bytes(odometry, "odom"))
        if checked.warning:
            self.diagnose("warn", checked.warning)


def main():
    """Run the node."""
    run(VioNode)

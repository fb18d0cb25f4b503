"""Node vio: checks odometry, by the IMU too, and converts it from the source's own frames to odom -> base_link."""

from swift_ros.estimation.odometry_check.vio_guard import VioGuard, VioSettings
from swift_ros.messages.motion import imu_from_bytes, odometry_bytes, odometry_from_bytes
from swift_ros.nodes.shell import Shell, run


class VioNode(Shell):
    """Subscribes vio/raw and imu/data_raw, publishes vio/odometry."""

    def __init__(self):
        super().__init__("vio", VioSettings)
        self._guard = VioGuard(self.settings)
        self._odometry = self.publisher("vio/odometry")
        self._new_imu = self.poll("imu/data_raw")
        self.subscribe("vio/raw", self._on_raw, raw=True)

    def _on_raw(self, data: bytes):
        for sample in self._new_imu():
            self._guard.imu(imu_from_bytes(sample))
        checked = self._guard.check(odometry_from_bytes(data))
        odometry = checked.odometry or checked.bridge
        if odometry is not None:
            self._odometry.publish(odometry_bytes(odometry, "odom"))
        if checked.warning:
            self.diagnose("warn", checked.warning)


def main():
    """Run the node."""
    run(VioNode)

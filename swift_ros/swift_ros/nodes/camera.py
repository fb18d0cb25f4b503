"""Node camera: publishes the images of a device or of files as camera/image_raw and camera/camera_info."""

import threading
from dataclasses import replace

from swift_ros import configuration
from swift_ros.camera.model import Camera
from swift_ros.camera.sources import CameraSettings, open_source
from swift_ros.errors import UsageError
from swift_ros.messages.camera import to_camera_info, to_image
from swift_ros.messages.motion import odometry_bytes
from swift_ros.nodes.shell import Shell, run


class CameraNode(Shell):
    """Publishes camera/image_raw and camera/camera_info, and vio/raw when the device has odometry."""

    def __init__(self):
        super().__init__("camera", CameraSettings)
        self._camera = configuration.load(Camera, self.folder / "camera.yaml")
        self._info = self.publisher("camera/camera_info")
        self._image = self.publisher("camera/image_raw")
        self._raw = self.publisher("vio/raw") if self.settings.kind == "t265" else None
        self._source = open_source(self.settings, self._camera, self._on_odometry)
        self._closing = threading.Event()
        # A read blocks until the next exposure, therefore it has its own thread.
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _stamp_ns(self, age_s: float) -> int:
        return self.now_ns() - round(age_s * 1e9)

    def _read(self):
        count = 0
        try:
            while not self._closing.is_set():
                picture = self._source.read()
                if picture is None:
                    self.diagnose("warn", f"{self.settings.kind} {self.settings.path} ended after {count} images")
                    return
                stamp_ns = self._stamp_ns(picture.age_s)
                self._info.publish(to_camera_info(self._camera, stamp_ns))
                self._image.publish(to_image(picture.image, stamp_ns))
                count += 1
        except UsageError as error:
            self.diagnose("error", f"{error}; no more images are published")

    def _on_odometry(self, age_s: float, odometry):
        assert self._raw is not None  # only the T265 has odometry
        stamped = replace(odometry, stamp_ns=self._stamp_ns(age_s))
        self._raw.publish(odometry_bytes(stamped, "odom", "t265"))

    def close(self):
        """Stop reading and close the source."""
        self._closing.set()
        self._reader.join(timeout=2.0)
        self._source.close()


def main():
    """Run the node."""
    run(CameraNode)

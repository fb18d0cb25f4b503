"""RealSense T265: its left fisheye and its visual-inertial odometry, through pyrealsense2.

Only one process can open the device, so that the node camera publishes the odometry too, as `vio/raw`. The library uses
axes x right, y up, z backward for the world and the device, and velocities along the world's axes.
"""

import queue
import time

import numpy as np

from swift_ros import geometry
from swift_ros.camera.model import Camera
from swift_ros.camera.picture import MAX_AGE_S, Picture, fit_to
from swift_ros.errors import UsageError
from swift_ros.types import Odometry

MAX_SILENCE_S = 2.0  # s; without an image for this time, 60 periods, the device counts as disconnected


class T265:
    """The device.

    Args:
        camera: format of the pictures.
        on_odometry: called as `on_odometry(age_s, Odometry)` from the library's thread; the stamp is not set.

    Raises:
        UsageError: the library is not installed, or the device does not start.
    """

    def __init__(self, camera: Camera, on_odometry):
        try:
            import pyrealsense2  # pyright: ignore[reportMissingImports]  # no wheel for every platform
        except ImportError:
            raise UsageError(
                "the T265 needs pyrealsense2, which is not installed; versions after 2.53.1 do not support the device, "
                "and not every platform has a wheel: build librealsense 2.53.1, or use its own ROS driver"
            ) from None
        self._camera = camera
        self._on_odometry = on_odometry
        self._images: queue.Queue = queue.Queue(maxsize=1)
        self._pipeline = pyrealsense2.pipeline()
        config = pyrealsense2.config()
        config.enable_stream(pyrealsense2.stream.pose)
        for eye in (1, 2):  # the device starts only with both
            config.enable_stream(pyrealsense2.stream.fisheye, eye)
        try:
            self._pipeline.start(config, self._on_frame)
        except RuntimeError as error:
            raise UsageError(
                f"the T265 does not start ({error}); connect it, and close other programs that use it"
            ) from None

    def _on_frame(self, frame):
        if frame.is_pose_frame():
            self._on_odometry(_age_s(frame), to_odometry(frame.as_pose_frame().get_pose_data()))
        elif frame.is_frameset():
            left = frame.as_frameset().get_fisheye_frame(1)
            picture = Picture(fit_to(self._camera, np.asanyarray(left.get_data())), _age_s(left))
            if self._images.full():  # the last picture was not read: replace it by the newer one
                self._images.get_nowait()
            self._images.put_nowait(picture)

    def read(self) -> Picture | None:
        """Return the next picture; None when there was none for MAX_SILENCE_S."""
        try:
            return self._images.get(timeout=MAX_SILENCE_S)
        except queue.Empty:
            return None

    def close(self):
        """Stop the device."""
        self._pipeline.stop()


def _age_s(frame) -> float:
    age_s = time.time() - frame.get_timestamp() * 1e-3
    return age_s if 0.0 <= age_s < MAX_AGE_S else 0.0


def to_odometry(pose) -> Odometry:
    """Return the odometry of a T265 pose: world with z up, device frame forward-left-up, twist in the device frame."""
    q = np.array([-pose.rotation.z, -pose.rotation.x, pose.rotation.y, pose.rotation.w])
    return Odometry(
        stamp_ns=0,
        p_world=_flu(pose.translation),
        q_world_body=q,
        v_body=geometry.rotate_inverse(q, _flu(pose.velocity)),
        omega_body=geometry.rotate_inverse(q, _flu(pose.angular_velocity)),
    )


def _flu(vector) -> np.ndarray:
    return np.array([-vector.z, -vector.x, vector.y])

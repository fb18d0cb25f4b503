"""A RealSense T265: its left fisheye and its visual-inertial odometry, through pyrealsense2 where that is installed.

The device opens for one process, so that the odometry comes out of the node camera too, as `vio/raw`. Intel's library
gives poses in axes x right, y up, z backward, for the world and the device, velocities along the world's.
"""

import queue
import time

import numpy as np

from swift_ros import geometry
from swift_ros.camera.model import Camera
from swift_ros.camera.sources import OLDEST_S, Picture, fit_to
from swift_ros.errors import UsageError
from swift_ros.types import Odometry

SILENCE_S = 2.0


class T265:
    """`hear_odometry(age_s, Odometry)` is called from the library's thread; its record's stamp is not set."""

    def __init__(self, camera: Camera, hear_odometry):
        try:
            import pyrealsense2
        except ImportError:
            raise UsageError(
                "the T265 needs pyrealsense2, which is not installed; versions after 2.53.1 do not know the device, "
                "and not every platform has a wheel: build librealsense 2.53.1, or let its own ROS driver publish"
            ) from None
        self._camera = camera
        self._hear_odometry = hear_odometry
        self._images: queue.Queue = queue.Queue(maxsize=1)
        self._pipeline = pyrealsense2.pipeline()
        config = pyrealsense2.config()
        config.enable_stream(pyrealsense2.stream.pose)
        for eye in (1, 2):  # it starts only with both
            config.enable_stream(pyrealsense2.stream.fisheye, eye)
        try:
            self._pipeline.start(config, self._on_frame)
        except RuntimeError as error:
            raise UsageError(f"the T265 does not start ({error}); is it plugged in, and free?") from None

    def _on_frame(self, frame):
        if frame.is_pose_frame():
            self._hear_odometry(_age_s(frame), to_odometry(frame.as_pose_frame().get_pose_data()))
        elif frame.is_frameset():
            left = frame.as_frameset().get_fisheye_frame(1)
            picture = Picture(fit_to(self._camera, np.asanyarray(left.get_data())), _age_s(left))
            if self._images.full():  # nobody took the last one: the newer one counts
                self._images.get_nowait()
            self._images.put_nowait(picture)

    def read(self) -> Picture | None:
        """Return the next picture; None when the device has been silent for 2 s."""
        try:
            return self._images.get(timeout=SILENCE_S)
        except queue.Empty:
            return None

    def close(self):
        self._pipeline.stop()


def _age_s(frame) -> float:
    age_s = time.time() - frame.get_timestamp() * 1e-3
    return age_s if 0.0 <= age_s < OLDEST_S else 0.0


def to_odometry(pose) -> Odometry:
    """Return the odometry of a T265 pose in z-up axes, its device's frame FLU, the twist along the device's axes."""
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

"""Images, and the camera that takes them."""

from array import array

import numpy as np
from sensor_msgs.msg import CameraInfo, Image

from swift_ros.camera.grey import grey_levels
from swift_ros.camera.lens import KANNALA_BRANDT, PINHOLE
from swift_ros.camera.model import Camera
from swift_ros.messages.stamps import to_time

CHANNELS = {"mono8": 1, "bgr8": 3, "rgb8": 3}  # of the encodings of images that are understood


def to_image(image, image_stamp_ns: int) -> Image:
    """Return sensor_msgs/Image, mono8, from grey levels (H, W) uint8."""
    height, width = image.shape
    message = Image(height=height, width=width, encoding="mono8", step=width)
    message.header.stamp = to_time(image_stamp_ns)
    message.header.frame_id = "camera_optical"
    message.data = array(
        "B", np.ascontiguousarray(image).tobytes()
    )  # an array is stored without a copy, bytes are copied
    return message


def from_image(message: Image) -> np.ndarray:
    """Return grey levels (H, W) uint8, of a coloured image as `grey_levels` has them.

    Raises:
        ValueError: the image has another encoding than `CHANNELS`, or is incomplete.
    """
    channels = CHANNELS.get(message.encoding)
    if channels is None:
        raise ValueError(f"the image has the encoding '{message.encoding}'; publish {' or '.join(CHANNELS)}")
    rows, width = np.frombuffer(message.data, np.uint8), channels * message.width
    if message.step < width or rows.size < message.height * message.step:
        raise ValueError(f"the image of {message.width} x {message.height} px has only {rows.size} bytes")
    rows = rows[: message.height * message.step].reshape(message.height, message.step)[:, :width]
    if channels == 1:
        return rows
    picture = rows.reshape(message.height, message.width, channels)
    return grey_levels(picture if message.encoding == "bgr8" else picture[..., ::-1])


def to_camera_info(camera: Camera, image_stamp_ns: int) -> CameraInfo:
    """Return sensor_msgs/CameraInfo for the image with a stamp (ns).

    Its model is "equidistant" (Kannala-Brandt), "plumb_bob" or "rational_polynomial" (pinhole), or "double_sphere",
    which is not a standard of ROS.
    """
    message = CameraInfo(height=camera.height, width=camera.width, distortion_model=_distortion_model(camera))
    message.header.stamp = to_time(image_stamp_ns)
    message.header.frame_id = "camera_optical"
    message.d = [float(k) for k in camera.distortion]
    message.k = [camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0]
    message.r = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    message.p = [camera.fx, 0.0, camera.cx, 0.0, 0.0, camera.fy, camera.cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    return message


def _distortion_model(camera: Camera) -> str:
    if camera.model == PINHOLE:
        return "rational_polynomial" if len(camera.distortion) == 8 else "plumb_bob"
    return "equidistant" if camera.model == KANNALA_BRANDT else camera.model

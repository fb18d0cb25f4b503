"""All conversions between ROS messages and the data types of the cores."""

import contextlib
import importlib
import math
import re
import struct
from array import array
from collections.abc import Sequence

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3, Vector3Stamped
from nav_msgs.msg import Odometry as OdometryMessage
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import BatteryState, CameraInfo, Image, Imu
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from swift_msgs.msg import (
    BetaflightLink,
    GateDetection,
    GateDetections,
    GatePose,
    GatePoses,
    PolicyStep,
    RaceStatus,
    Rotors,
    StateUpdate,
    StateUpdates,
)
from swift_msgs.msg import BodyRateThrust as BodyRateThrustMessage
from swift_msgs.msg import IncompleteGate as IncompleteGateMessage
from swift_ros.camera.grey import grey_levels
from swift_ros.camera.lens import KANNALA_BRANDT, PINHOLE
from swift_ros.camera.model import Camera
from swift_ros.race.judge import RaceEvent
from swift_ros.text import excerpt
from swift_ros.track import Track
from swift_ros.types import (
    BodyRateThrust,
    GateCorners,
    GateUpdate,
    ImuSample,
    IncompleteGate,
    Odometry,
    RelativeGatePose,
)

CHANNELS = {"mono8": 1, "bgr8": 3, "rgb8": 3}  # of the encodings of images that are understood
NANOSECONDS = 1_000_000_000  # in a second
# Types that have one more sequence at their end since version 0.1.0; in older recordings it is empty.
EXTENDED = ("swift_msgs/msg/GateDetections", "swift_msgs/msg/GatePoses")
EMPTY_SEQUENCE = bytes(7)  # its length of zero in CDR: up to 3 bytes that align 4 bytes


def message_type(name: str):
    """Return the class of a type of messages or services, given as in `nav_msgs/msg/Odometry`.

    Raises LookupError when no installed package has it: the name may come from a file.
    """
    if found := re.fullmatch(r"([a-z]\w*)/(msg|srv)/([A-Z]\w*)", name, re.ASCII):
        package, kind, message = found.groups()
        with contextlib.suppress(ImportError, AttributeError):
            return getattr(importlib.import_module(f"{package}.{kind}"), message)
    raise LookupError(f"no installed package has the type {excerpt(name)}")


def deserialize(data: bytes, type_name: str):
    """Return the message in CDR bytes. Raises RuntimeError when they hold none, and LookupError like `message_type`."""
    kind = message_type(type_name)
    try:
        return deserialize_message(data, kind)
    except RuntimeError:
        if type_name not in EXTENDED:
            raise
        return deserialize_message(data + EMPTY_SEQUENCE, kind)


def serialize(message) -> bytes:
    """Return the CDR bytes of a message."""
    return serialize_message(message)


def begins_with_stamp(type_name: str) -> bool:
    """Return whether messages of a type begin with a header or a time, which `header_stamp_ns` can read."""
    first = next(iter(message_type(type_name).get_fields_and_field_types().values()), "")
    return first in ("std_msgs/Header", "builtin_interfaces/Time")


def header_stamp_ns(data: bytes) -> int:
    """Return the stamp (ns) of a serialized message that `begins_with_stamp`, in CDR of either byte order."""
    seconds, nanoseconds = struct.unpack_from("<iI" if data[1] & 1 else ">iI", data, 4)
    return seconds * NANOSECONDS + nanoseconds


def stamp_ns(time: Time) -> int:
    """Return a ROS time stamp in integer nanoseconds."""
    return time.sec * NANOSECONDS + time.nanosec


def message_stamp_ns(message) -> int:
    """Return the stamp (ns) of a message, or of its CDR bytes, that begins with a header or a time; 0 without one."""
    if isinstance(message, bytes):
        return header_stamp_ns(message)
    stamp = getattr(getattr(message, "header", message), "stamp", None)
    return stamp_ns(stamp) if stamp else 0


def to_time(nanoseconds: int) -> Time:
    """Return the ROS time stamp of integer nanoseconds."""
    seconds, remainder = divmod(int(nanoseconds), NANOSECONDS)
    return Time(sec=seconds, nanosec=remainder)


def to_vector(values) -> Vector3:
    """Return the Vector3 of (3,)."""
    x, y, z = (float(v) for v in values)
    return Vector3(x=x, y=y, z=z)


def from_xyz(message) -> np.ndarray:
    """Return the components (3,) of a Vector3 or Point."""
    return np.array([message.x, message.y, message.z])


def to_quaternion(q) -> Quaternion:
    """Return the Quaternion of (4,) x y z w."""
    x, y, z, w = (float(v) for v in q)
    return Quaternion(x=x, y=y, z=z, w=w)


def from_quaternion(message: Quaternion) -> np.ndarray:
    """Return the components (4,) x y z w, not normalised."""
    return np.array([message.x, message.y, message.z, message.w])


def to_pose(position, q) -> Pose:
    """Return the Pose of a position (3,) and a quaternion (4,)."""
    x, y, z = (float(v) for v in position)
    return Pose(position=Point(x=x, y=y, z=z), orientation=to_quaternion(q))


def to_odometry(state: Odometry, frame: str, child_frame: str = "base_link") -> OdometryMessage:
    """Return nav_msgs/Odometry: pose in `frame`, twist in `child_frame`."""
    message = OdometryMessage(child_frame_id=child_frame)
    message.header.stamp = to_time(state.stamp_ns)
    message.header.frame_id = frame
    message.pose.pose = to_pose(state.p_world, state.q_world_body)
    message.twist.twist.linear = to_vector(state.v_body)
    message.twist.twist.angular = to_vector(state.omega_body)
    if state.covariance_pose is not None:
        message.pose.covariance = np.asarray(state.covariance_pose, dtype=float).ravel()
    return message


def from_odometry(message: OdometryMessage) -> Odometry:
    """Return the odometry of a message with its twist in the body frame; a covariance of zeros is None."""
    covariance = np.array(message.pose.covariance).reshape(6, 6)
    return Odometry(
        stamp_ns=stamp_ns(message.header.stamp),
        p_world=from_xyz(message.pose.pose.position),
        q_world_body=from_quaternion(message.pose.pose.orientation),
        v_body=from_xyz(message.twist.twist.linear),
        omega_body=from_xyz(message.twist.twist.angular),
        covariance_pose=covariance if covariance.any() else None,
    )


def to_command(command: BodyRateThrust) -> BodyRateThrustMessage:
    """Return swift_msgs/BodyRateThrust."""
    message = BodyRateThrustMessage(thrust=float(command.thrust), body_rate=to_vector(command.omega_body))
    message.header.stamp = to_time(command.stamp_ns)
    message.header.frame_id = "base_link"
    return message


def from_command(message: BodyRateThrustMessage) -> BodyRateThrust:
    """Return the command of a message."""
    return BodyRateThrust(stamp_ns(message.header.stamp), message.thrust, from_xyz(message.body_rate))


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


def to_imu(sample_stamp_ns: int, gyro, specific_force_body) -> Imu:
    """Return sensor_msgs/Imu from rates (3,) rad/s and specific force (3,) m/s^2, without orientation."""
    message = Imu()
    message.header.stamp = to_time(sample_stamp_ns)
    message.header.frame_id = "base_link"
    message.angular_velocity = to_vector(gyro)
    message.linear_acceleration = to_vector(specific_force_body)
    message.orientation_covariance[0] = -1.0
    return message


def from_imu(message: Imu) -> ImuSample:
    """Return rates and specific force of a message."""
    omega, force = from_xyz(message.angular_velocity), from_xyz(message.linear_acceleration)
    return ImuSample(stamp_ns(message.header.stamp), omega, force)


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


def to_detections(header, gates: list[GateCorners], incomplete: Sequence[GateCorners] = ()) -> GateDetections:
    """Return swift_msgs/GateDetections for the image with a header."""
    return GateDetections(header=header, gates=_to_corners(gates), incomplete=_to_corners(incomplete))


def _to_corners(gates: Sequence[GateCorners]) -> list[GateDetection]:
    return [
        GateDetection(corners=np.asarray(g.corners_px, dtype=float).ravel(), confidence=np.asarray(g.confidence, float))
        for g in gates
    ]


def from_detections(message: GateDetections) -> list[GateCorners]:
    """Return the detected gates of a message, without incomplete ones."""
    return _from_corners(message.gates)


def incomplete_from_detections(message: GateDetections) -> list[GateCorners]:
    """Return the incomplete gates of a message."""
    return _from_corners(message.incomplete)


def _from_corners(gates) -> list[GateCorners]:
    return [GateCorners(np.array(g.corners).reshape(4, 2), np.array(g.confidence)) for g in gates]


def to_gate_poses(
    image_stamp: Time, gates: list[RelativeGatePose], incomplete: Sequence[IncompleteGate] = ()
) -> GatePoses:
    """Return swift_msgs/GatePoses for the image with a stamp."""
    message = GatePoses()
    message.header.stamp = image_stamp
    message.header.frame_id = "base_link"
    message.gates = [
        GatePose(
            pose=to_pose(gate.p_body, gate.q_body_gate),
            reprojection_error=float(gate.reprojection_error),
            alternative_pose=to_pose(gate.alternative_p_body, gate.alternative_q_body_gate),
            alternative_reprojection_error=float(gate.alternative_reprojection_error),
            position_covariance=np.asarray(gate.covariance, dtype=float).ravel(),
            rays=np.asarray(gate.rays_body, dtype=float).ravel(),
            confidence=float(gate.confidence),
        )
        for gate in gates
    ]
    message.incomplete = [
        IncompleteGateMessage(rays=np.asarray(gate.rays_body, dtype=float).ravel(), confidence=float(gate.confidence))
        for gate in incomplete
    ]
    return message


def from_gate_poses(message: GatePoses) -> list[RelativeGatePose]:
    """Return the gate poses of a message."""
    return [
        RelativeGatePose(
            p_body=from_xyz(g.pose.position),
            q_body_gate=from_quaternion(g.pose.orientation),
            covariance=np.array(g.position_covariance).reshape(3, 3),
            rays_body=np.array(g.rays).reshape(4, 3),
            confidence=g.confidence,
            reprojection_error=g.reprojection_error,
            alternative_p_body=from_xyz(g.alternative_pose.position),
            alternative_q_body_gate=from_quaternion(g.alternative_pose.orientation),
            alternative_reprojection_error=g.alternative_reprojection_error,
        )
        for g in message.gates
    ]


def incomplete_from_gate_poses(message: GatePoses) -> list[IncompleteGate]:
    """Return the incomplete gates of a message."""
    return [IncompleteGate(np.array(g.rays).reshape(4, 3), g.confidence) for g in message.incomplete]


def to_state_updates(image_stamp_ns: int, updates: list[GateUpdate]) -> StateUpdates:
    """Return swift_msgs/StateUpdates for the image with a stamp (ns)."""
    message = StateUpdates()
    message.header.stamp = to_time(image_stamp_ns)
    message.header.frame_id = "map"
    rows = []
    for update in updates:
        row = StateUpdate(gate=int(update.gate), mahalanobis=float(update.mahalanobis), accepted=bool(update.accepted))
        row.innovation = np.asarray(update.innovation, dtype=float)
        row.reason = update.reason
        rows.append(row)
    message.updates = rows
    return message


def from_state_updates(message: StateUpdates) -> list[GateUpdate]:
    """Return the results for the gates of one image."""
    return [
        GateUpdate(row.gate, np.array(row.innovation), row.mahalanobis, row.accepted, row.reason)
        for row in message.updates
    ]


def to_policy_step(state_stamp_ns: int, observation, action, next_gate: int, lap: int) -> PolicyStep:
    """Return swift_msgs/PolicyStep for the state with a stamp (ns): observation (31,), action (4,)."""
    message = PolicyStep(next_gate=int(next_gate), lap=int(lap))
    message.header.stamp = to_time(state_stamp_ns)
    message.header.frame_id = "map"
    message.observation = np.asarray(observation, dtype=np.float32)
    message.action = np.asarray(action, dtype=np.float32)
    return message


def to_race_status(event: RaceEvent) -> RaceStatus:
    """Return swift_msgs/RaceStatus."""
    message = RaceStatus(state=event.state, next_gate=int(event.next_gate), lap=int(event.lap), text=event.text)
    message.header.stamp = to_time(event.stamp_ns)
    message.header.frame_id = "map"
    message.split_s, message.margin_m = float(event.split_s), float(event.margin_m)
    return message


def from_race_status(message: RaceStatus) -> RaceEvent:
    """Return the race event of a message."""
    stamp = stamp_ns(message.header.stamp)
    numbers = message.next_gate, message.lap, message.split_s, message.margin_m
    return RaceEvent(stamp, message.state, *numbers, message.text)


def to_link(now_ns: int, command_stamp_ns: int, **fields) -> BetaflightLink:
    """Return swift_msgs/BetaflightLink.

    Args:
        now_ns: header stamp, ns.
        command_stamp_ns: stamp of the answered command, ns.
        fields: all other fields of the message.
    """
    message = BetaflightLink(command_stamp=to_time(command_stamp_ns), **fields)
    message.header.stamp = to_time(now_ns)
    message.header.frame_id = "base_link"
    return message


def to_stamped_vector(now_ns: int, values) -> Vector3Stamped:
    """Return geometry_msgs/Vector3Stamped from values (3,) in base_link."""
    message = Vector3Stamped(vector=to_vector(values))
    message.header.stamp = to_time(now_ns)
    message.header.frame_id = "base_link"
    return message


def to_rotors(now_ns: int, speed, motor) -> Rotors:
    """Return swift_msgs/Rotors from speeds (n,) rad/s, NaN when unknown, and motor commands (n,) 0..1."""
    message = Rotors(speed=[float(v) for v in speed], motor=[float(v) for v in motor])
    message.header.stamp = to_time(now_ns)
    message.header.frame_id = "base_link"
    return message


def to_battery(now_ns: int, voltage: float, current: float, drawn_ah: float, capacity_ah: float) -> BatteryState:
    """Return sensor_msgs/BatteryState.

    Args:
        now_ns: header stamp, ns.
        voltage: V.
        current: A, positive while discharging.
        drawn_ah: drawn charge, Ah.
        capacity_ah: capacity, Ah; 0 when unknown.
    """
    message = BatteryState(voltage=voltage, current=-current, present=voltage > 0, capacity=capacity_ah or math.nan)
    message.header.stamp = to_time(now_ns)
    message.header.frame_id = "base_link"
    message.design_capacity = message.capacity
    message.charge = message.capacity - drawn_ah
    message.percentage = max(0.0, 1.0 - drawn_ah / capacity_ah) if capacity_ah else math.nan
    message.temperature = math.nan
    message.power_supply_technology = BatteryState.POWER_SUPPLY_TECHNOLOGY_LIPO
    message.power_supply_status = BatteryState.POWER_SUPPLY_STATUS_DISCHARGING
    return message


def to_track_markers(track: Track) -> MarkerArray:
    """Return markers of the gates in the map: frames, numbers and directions of passage."""
    markers = []
    for i in range(len(track.gates)):
        base = {"ns": f"gate {i + 1}", "action": Marker.ADD}
        pose = to_pose(track.positions[i], track.attitudes[i])
        frame = Marker(**base, id=0, type=Marker.LINE_STRIP, pose=to_pose((0, 0, 0), (0, 0, 0, 1)))
        frame.points = [Point(x=x, y=y, z=z) for x, y, z in track.corners[i][[0, 1, 2, 3, 0]]]
        frame.scale.x, frame.color = 0.1, ColorRGBA(r=0.9, g=0.3, b=0.1, a=1.0)
        arrow = Marker(**base, id=1, type=Marker.ARROW, pose=pose, color=ColorRGBA(r=0.2, g=0.6, b=0.2, a=1.0))
        arrow.scale = Vector3(x=0.6, y=0.06, z=0.06)
        number = Marker(**base, id=2, type=Marker.TEXT_VIEW_FACING, pose=pose, text=str(i + 1))
        number.pose.position.z += 0.5 * float(track.outer_sides[i])
        number.scale.z, number.color = 0.5, ColorRGBA(r=1.0, g=1.0, b=1.0, a=1.0)
        markers += [frame, arrow, number]
    for marker in markers:
        marker.header.frame_id = "map"
    return MarkerArray(markers=markers)

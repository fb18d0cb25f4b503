"""The mapping of the topics of a bag: by their types, and by words in their names.

A message of sensor_msgs, nav_msgs and geometry_msgs has the frames of REP 103 and 105: those of this project. PX4's own
messages have PX4's frames.
"""

import re

from swift_ros.errors import UsageError
from swift_ros.recording.log_formats.log import Log
from swift_ros.recording.log_mapping import guess_px4
from swift_ros.recording.log_mapping.mapping import MAX_ROTORS, ChannelSource, Mapping
from swift_ros.text import excerpt

ORDER = (
    "the order of the motors is that of the message; compare it with the rotors of the vehicle file: no type of ROS "
    "defines it"
)
NEGATIVE_CURRENT = "sensor_msgs/BatteryState has a negative current while discharging; it is turned"
TRUTH = re.compile(r"mocap|vicon|optitrack|qualisys|vrpn|ground_?truth|(^|[/_])gt([/_]|$)|motion_?capture")
VISUAL = re.compile(r"(^|[/_])(vio|svo|vins|openvins|ov_msckf|visual|camera)")
SPEED = re.compile(r"rpm|rotor|motor_?speed|esc")
COMMAND = re.compile(r"motor|actuator|rotor|pwm|thrust|esc")


def axes(prefix: str, letters: str = "xyz") -> tuple[str, ...]:
    return tuple(f"{prefix}.{letter}" for letter in letters)


POSE_PREFIXES = {  # of position and attitude, by type
    "nav_msgs/msg/Odometry": ("pose.pose.position", "pose.pose.orientation"),
    "geometry_msgs/msg/PoseStamped": ("pose.position", "pose.orientation"),
    "geometry_msgs/msg/PoseWithCovarianceStamped": ("pose.pose.position", "pose.pose.orientation"),
    "geometry_msgs/msg/TransformStamped": ("transform.translation", "transform.rotation"),
    "geometry_msgs/msg/Pose": ("position", "orientation"),
}
TWIST_PREFIXES = {"geometry_msgs/msg/TwistStamped": "twist.linear"}
IMU, BATTERY = "sensor_msgs/msg/Imu", "sensor_msgs/msg/BatteryState"
ARRAYS = {  # array of one value for each motor, by type, and what a value is where the name of the topic says nothing
    "std_msgs/msg/Float32MultiArray": "data[{}]",
    "std_msgs/msg/Float64MultiArray": "data[{}]",
    "std_msgs/msg/UInt16MultiArray": "data[{}]",
    "std_msgs/msg/Int32MultiArray": "data[{}]",
    "mavros_msgs/msg/RCOut": "channels[{}]",
    "mavros_msgs/msg/ActuatorControl": "controls[{}]",
    "mavros_msgs/msg/ESCTelemetry": "esc_telemetry[{}].rpm",
    "mavros_msgs/msg/ESCStatus": "esc_status[{}].rpm",
    "mav_msgs/msg/Actuators": "angular_velocities[{}]",
    "actuator_msgs/msg/Actuators": "velocity[{}]",
}
MEASURED = ("mavros_msgs/msg/ESCTelemetry", "mavros_msgs/msg/ESCStatus")
PULSES = ("mavros_msgs/msg/RCOut", "std_msgs/msg/UInt16MultiArray")


def guess(log: Log) -> Mapping:
    """Return the mapping of a bag. Raises UsageError when a channel has two topics that are equally likely."""
    px4 = {name: topic for name, topic in log.topics.items() if topic.type.startswith("px4_msgs/")}
    found = guess_px4.guess(log, guess_px4.uorb_names(px4))
    channels, notes = dict(found.channels), list(found.notes)

    def add(channel: str, sources: dict[str, ChannelSource]) -> None:
        if sources and channel not in channels:
            channels[channel] = sources[_only(log, channel, list(sources))]

    poses = {name: POSE_PREFIXES[topic.type] for name, topic in log.topics.items() if topic.type in POSE_PREFIXES}
    visual = {name for name in poses if VISUAL.search(name.lower()) and not TRUTH.search(name.lower())}
    if len(visual) < len(poses):
        poses, seen = {n: p for n, p in poses.items() if n not in visual}, {n: poses[n] for n in visual}
    else:
        seen = {}
    for columns, names in ((poses, ("p_world", "q_world_body")), (seen, ("p_vio", "q_vio_body"))):
        add(names[0], {name: ChannelSource(axes(p), name) for name, (p, _) in columns.items()})
        if names[0] in channels and channels[names[0]].topic in columns:
            topic = channels[names[0]].topic
            add(names[1], {topic: ChannelSource(axes(columns[topic][1], "xyzw"), topic)})
    _add_velocity(log, channels, add)
    imus = [name for name, topic in log.topics.items() if topic.type == IMU]
    add("gyro_body", {name: ChannelSource(axes("angular_velocity"), name) for name in imus})
    add("specific_force_body", {name: ChannelSource(axes("linear_acceleration"), name) for name in imus})
    for channel, sources in _motors(log).items():
        add(channel, sources)
    batteries = [name for name, topic in log.topics.items() if topic.type == BATTERY]
    add("voltage", {name: ChannelSource(("voltage",), name) for name in batteries})
    add("current", {name: ChannelSource(("-current",), name) for name in batteries})
    notes += [NEGATIVE_CURRENT] if "current" in channels and batteries else []
    if {"motor_command", "rotor_speed"} & set(channels) and guess_px4.ORDER not in notes:
        notes.append(ORDER)
    return Mapping(channels, notes=tuple(notes))


def _add_velocity(log: Log, channels: dict[str, ChannelSource], add) -> None:
    """Add the velocity: of the pose's own odometry, which is in the body frame, else of a twist."""
    topic = channels["p_world"].topic if "p_world" in channels else ""
    if topic in log.topics and log.topics[topic].type == "nav_msgs/msg/Odometry":
        add("v_world", {topic: ChannelSource(axes("twist.twist.linear"), topic, body="FLU")})
    twists = {
        name: ChannelSource(axes(TWIST_PREFIXES[logged.type]), name)
        for name, logged in log.topics.items()
        if logged.type in TWIST_PREFIXES and not re.search(r"cmd|setpoint|command|body", name.lower())
    }
    add("v_world", twists)


def _motors(log: Log) -> dict[str, dict[str, ChannelSource]]:
    """Return the possible sources of motor commands and rotor speeds, by channel and topic."""
    found: dict[str, dict[str, ChannelSource]] = {"rotor_speed": {}, "motor_command": {}}
    for name, topic in log.topics.items():
        if topic.type not in ARRAYS:
            continue
        pattern, lower = ARRAYS[topic.type], name.lower()
        columns = tuple(pattern.format(i) for i in range(MAX_ROTORS) if pattern.format(i) in topic.columns)
        columns = tuple(column for column in columns if topic.columns[column].min() != topic.columns[column].max())
        if not 3 <= len(columns) <= MAX_ROTORS:
            continue
        if topic.type in MEASURED:
            found["rotor_speed"][name] = ChannelSource(columns, name, "rpm")
        elif "ctuators" in topic.type:
            found["rotor_speed"][name] = ChannelSource(columns, name)
        elif topic.type in PULSES:
            found["motor_command"][name] = ChannelSource(columns, name, "us")
        elif SPEED.search(lower) and max(topic.columns[column].max() for column in columns) > 1.5:
            found["rotor_speed"][name] = ChannelSource(columns, name, "rpm" if "rpm" in lower else "")
        elif COMMAND.search(lower):
            found["motor_command"][name] = ChannelSource(columns, name)
    return found


def _only(log: Log, channel: str, topics: list[str]) -> str:
    """Return the topic of a channel: the only one, or the only one of motion capture or simulation."""
    true = [name for name in topics if TRUTH.search(name.lower())]
    chosen = true if true else topics
    if len(chosen) > 1:
        names = ", ".join(excerpt(name) for name in chosen[:6])
        raise UsageError(
            f"{log.path}: {channel} may be any of the topics {names}; choose in a mapping (--mapping FILE)"
        )
    return chosen[0]

"""The one table of the node graph: which nodes there are, which topics they speak and hear, how often and how surely.

Launch files, the runner, the recorder, the rate watchdog and the README's table all read it. Plain data, no rclpy.
"""

from dataclasses import dataclass

VEHICLE_NAMESPACE = "swift"


@dataclass(frozen=True)
class Topic:
    """One topic, relative to the vehicle's namespace unless it starts with a slash.

    rate_hz: what it runs at while racing, None for events; silence_s: the watchdog complains after this long without a
    message while racing (None: never); image: best effort and depth 1 in real time; latched: the last message is kept
    for late joiners; meaning: for a reader.
    """

    name: str
    type: str
    rate_hz: float | None
    meaning: str
    silence_s: float | None = None
    image: bool = False
    latched: bool = False


TOPICS = {
    topic.name: topic
    for topic in (
        Topic("camera/image_raw", "sensor_msgs/msg/Image", 30, "fisheye image, mono8", 0.2, image=True),
        Topic("camera/camera_info", "sensor_msgs/msg/CameraInfo", 30, "equidistant intrinsics: an image was taken"),
        Topic("vio/raw", "nav_msgs/msg/Odometry", 100, "visual-inertial odometry as its source speaks"),
        Topic("vio/odometry", "nav_msgs/msg/Odometry", 100, "odom to base_link, twist in the body frame", 0.05),
        Topic("imu/data_raw", "sensor_msgs/msg/Imu", 100, "angular rate and specific force, body frame"),
        Topic("gates/detections", "swift_msgs/msg/GateDetections", 30, "corners of the gates in an image", 0.2),
        Topic("gates/poses", "swift_msgs/msg/GatePoses", 30, "gates relative to base_link", 0.2),
        Topic("state/odometry", "nav_msgs/msg/Odometry", 100, "map to base_link, twist in the body frame", 0.05),
        Topic("state/updates", "swift_msgs/msg/StateUpdates", 30, "which gate corrected the state, and by how much"),
        Topic("policy/step", "swift_msgs/msg/PolicyStep", 100, "observation, action and next gate", 0.05),
        Topic("command/body_rate_thrust", "swift_msgs/msg/BodyRateThrust", 100, "body rates and thrust", 0.05),
        Topic("betaflight/link", "swift_msgs/msg/BetaflightLink", 100, "armed, modes, frames, failsafe", 0.3),
        Topic("betaflight/rotors", "swift_msgs/msg/Rotors", 100, "rotor speeds and motor commands"),
        Topic(
            "betaflight/feedforward",
            "geometry_msgs/msg/Vector3Stamped",
            None,
            "of the rate loop, share of the motors' range an axis: in its own log alone",
        ),
        Topic("battery", "sensor_msgs/msg/BatteryState", 10, "voltage and current"),
        Topic("race/status", "swift_msgs/msg/RaceStatus", None, "state, passages, splits, margins", latched=True),
        Topic("race/judged", "std_msgs/msg/Header", 100, "how far the judge has judged: its sign of life", 0.2),
        Topic("track/markers", "visualization_msgs/msg/MarkerArray", None, "the gates, to look at", latched=True),
        Topic("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", 1, "rates, latencies, health of each node"),
        Topic("ground_truth/odometry", "nav_msgs/msg/Odometry", 100, "simulator or motion capture, never the pilot's"),
        Topic("/clock", "rosgraph_msgs/msg/Clock", 100, "simulated time, in lockstep"),
    )
}

SERVICES = dict.fromkeys(("race/arm", "race/start", "race/stop"), "std_srvs/srv/Trigger")


@dataclass(frozen=True)
class NodeRow:
    """One node: package and executable, what it publishes and hears, and which services it answers.

    onboard: part of `flight.launch.py`; the rest is started by the workstation; answers: the topic whose every message
    the first of `publishes` answers with the same stamp (in real time it may skip some): who owes an answer is stuck;
    priority: SCHED_FIFO priority in real time, so that a command does not queue behind an image; None: ordinary;
    patient_priority: that of its threads which may be late (see `Shell.patient_threads`), 0: ordinary.
    """

    name: str
    package: str
    publishes: tuple[str, ...]
    hears: tuple[str, ...]
    meaning: str
    onboard: bool = True
    answers: str | None = None
    priority: int | None = None
    patient_priority: int = 1

    @property
    def executable(self) -> str:
        return self.name


NODES = {
    node.name: node
    for node in (
        NodeRow(
            "camera",
            "swift_ros",
            ("camera/image_raw", "camera/camera_info", "vio/raw"),
            (),
            "images from a device or files; of a T265 its odometry too",
            priority=20,
        ),
        NodeRow(
            "vio",
            "swift_ros",
            ("vio/odometry",),
            ("vio/raw",),
            "checks and converts visual-inertial odometry",
            answers="vio/raw",
            priority=20,
        ),
        NodeRow(
            "gate_detector",
            "swift_ros",
            ("gates/detections",),
            ("camera/image_raw", "vio/odometry"),
            "U-Net corners, grouped into gates",
            answers="camera/image_raw",
            priority=5,
        ),
        NodeRow(
            "gate_pose",
            "swift_ros",
            ("gates/poses",),
            ("gates/detections",),
            "IPPE pose of each gate",
            answers="gates/detections",
            priority=10,
        ),
        NodeRow(
            "state_estimator",
            "swift_ros",
            ("state/odometry", "state/updates"),
            ("vio/odometry", "gates/poses", "camera/camera_info"),
            "Kalman fusion of odometry and gates",
            answers="vio/odometry",
            priority=20,
        ),
        NodeRow(
            "policy",
            "swift_ros",
            ("policy/step", "command/body_rate_thrust"),
            ("state/odometry", "race/status"),
            "the pilot's network",
            answers="state/odometry",
            priority=20,
        ),
        NodeRow(
            "betaflight",
            "swift_ros",
            ("betaflight/link", "betaflight/rotors", "battery"),
            ("command/body_rate_thrust", "state/odometry", "race/status", "race/judged"),
            "MSP bridge to the flight controller",
            answers="command/body_rate_thrust",
            priority=20,
        ),
        NodeRow(
            "race_monitor",
            "swift_ros",
            ("race/status", "race/judged", "track/markers", "/diagnostics"),
            ("ground_truth/odometry", "state/odometry", "betaflight/link", "/diagnostics"),
            "judge, race services, watchdog",
            priority=10,
        ),
        NodeRow("recorder", "swift_ros", (), (), "rosbag2 MCAP folder of every topic", priority=10, patient_priority=0),
        NodeRow(
            "mavlink_telemetry",
            "swift_ros",
            (),
            ("state/odometry", "battery", "race/status", "betaflight/link", "/diagnostics"),
            "telemetry to a ground station",
        ),
        NodeRow(
            "bridge",
            "swift_sim_bridge",
            ("vio/raw", "camera/image_raw", "camera/camera_info", "imu/data_raw", "ground_truth/odometry", "/clock"),
            ("betaflight/link", "race/status", "race/judged"),
            "the simulator in the hardware's place",
            onboard=False,
            priority=30,
            patient_priority=15,
        ),
    )
}

IMPORTED = ("betaflight/feedforward",)  # which no node speaks: `swiftros import` finds them in other recordings

# Only these may hear ground truth; a test reads the live graph and fails otherwise.
MAY_HEAR_GROUND_TRUTH = ("bridge", "recorder", "race_monitor")


def full_name(topic: str, namespace: str = VEHICLE_NAMESPACE) -> str:
    """Return the absolute name of a topic or service of the table under a vehicle's namespace."""
    return topic if topic.startswith("/") else f"/{namespace}/{topic}"

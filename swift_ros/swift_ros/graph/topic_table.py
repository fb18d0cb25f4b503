"""Table of the node graph: all nodes and topics, with types, rates, quality of service and priorities.

Launch files, the runner, the recorder, the topic monitor, `setup.py` and the documentation read it. Plain data without
imports of this package or of ROS: `setup.py` runs this file before anything is installed.
"""

from dataclasses import dataclass

VEHICLE_NAMESPACE = "swift"


@dataclass(frozen=True)
class Topic:
    """One topic.

    Attributes:
        name: relative to the vehicle's namespace unless it starts with a slash.
        type: ROS type, as in `nav_msgs/msg/Odometry`.
        rate_hz: nominal rate while racing, Hz; None for events.
        meaning: description for a reader.
        silence_s: time without a message (s) after which the race monitor ends a race; None: not monitored.
        image: best effort with depth 1 in real time.
        latched: a late subscriber receives the last message (transient local).
        shared: every node publishes it; each other topic has one publisher.
    """

    name: str
    type: str
    rate_hz: float | None
    meaning: str
    silence_s: float | None = None
    image: bool = False
    latched: bool = False
    shared: bool = False


TOPICS = {
    topic.name: topic
    for topic in (
        Topic("camera/image_raw", "sensor_msgs/msg/Image", 30, "camera image: mono8, bgr8 or rgb8", 0.2, image=True),
        Topic("camera/camera_info", "sensor_msgs/msg/CameraInfo", 30, "intrinsics of the lens, one message per image"),
        Topic("vio/raw", "nav_msgs/msg/Odometry", 100, "visual-inertial odometry in the source's own frames"),
        Topic("vio/odometry", "nav_msgs/msg/Odometry", 100, "odom to base_link, twist in the body frame", 0.05),
        Topic("imu/data_raw", "sensor_msgs/msg/Imu", 100, "angular rate and specific force, body frame"),
        Topic("gates/detections", "swift_msgs/msg/GateDetections", 30, "corners of the gates in an image", 0.2),
        Topic("gates/poses", "swift_msgs/msg/GatePoses", 30, "gates relative to base_link", 0.2),
        Topic("state/odometry", "nav_msgs/msg/Odometry", 100, "map to base_link, twist in the body frame", 0.05),
        Topic("state/updates", "swift_msgs/msg/StateUpdates", 30, "corrections of the state by gates"),
        Topic("policy/step", "swift_msgs/msg/PolicyStep", 100, "observation, action and next gate", 0.05),
        Topic("command/body_rate_thrust", "swift_msgs/msg/BodyRateThrust", 100, "body rates and thrust", 0.05),
        Topic("betaflight/link", "swift_msgs/msg/BetaflightLink", 100, "armed, modes, frames, failsafe", 0.3),
        Topic("betaflight/rotors", "swift_msgs/msg/Rotors", 100, "rotor speeds and motor commands"),
        Topic(
            "betaflight/feedforward",
            "geometry_msgs/msg/Vector3Stamped",
            None,
            "feedforward of the rate loop, share of the motors' range; from imported logs only",
        ),
        Topic("battery", "sensor_msgs/msg/BatteryState", 10, "voltage and current"),
        Topic("race/status", "swift_msgs/msg/RaceStatus", None, "state, passages, splits, margins", latched=True),
        Topic("race/judged", "std_msgs/msg/Header", 50, "time up to which the race is judged", 0.2),
        Topic("track/markers", "visualization_msgs/msg/MarkerArray", None, "gates for visualisation", latched=True),
        Topic(
            "/diagnostics",
            "diagnostic_msgs/msg/DiagnosticArray",
            1,
            "rates, latencies, health of each node",
            shared=True,
        ),
        Topic("ground_truth/odometry", "nav_msgs/msg/Odometry", 100, "simulator or motion capture; not for the pilot"),
        Topic("/clock", "rosgraph_msgs/msg/Clock", 100, "simulated time, in lockstep"),
    )
}

SERVICES = dict.fromkeys(("race/arm", "race/start", "race/stop"), "std_srvs/srv/Trigger")


@dataclass(frozen=True)
class NodeRow:
    """One node.

    Attributes:
        name: of the node and of its executable.
        package: Python package that installs it.
        publishes: topics of the table.
        subscribes: topics of the table.
        meaning: description for a reader.
        onboard: part of `flight.launch.py`; all other nodes run on the workstation.
        needed: the flight ends when the node is lost. One that it does not need is started again.
        restart_parameters: further ROS parameters, by name, of a node that is started again.
        answers: topic whose every message is answered by the first topic of `publishes` with the same stamp (in real
            time some may be skipped); the race monitor uses it to find a blocked node. None: no such topic.
        priority: SCHED_FIFO priority in real time, so that a command does not wait for an image; None: normal
            scheduling.
        background_priority: priority of the threads in `Shell.background_threads`; 0: normal scheduling.
        module: Python module with the function `main`; "" for `PACKAGE.nodes.NAME`.
    """

    name: str
    package: str
    publishes: tuple[str, ...]
    subscribes: tuple[str, ...]
    meaning: str
    onboard: bool = True
    needed: bool = True
    restart_parameters: tuple[tuple[str, bool], ...] = ()
    answers: str | None = None
    priority: int | None = None
    background_priority: int = 1
    module: str = ""

    @property
    def executable(self) -> str:
        """Name of the installed executable."""
        return self.name

    @property
    def entry_point(self) -> str:
        """Line for the entry-point group `console_scripts` of the package's `setup.py`."""
        return f"{self.executable} = {self.module or f'{self.package}.nodes.{self.name}'}:main"


NODES = {
    node.name: node
    for node in (
        NodeRow(
            "camera",
            "swift_ros",
            ("camera/image_raw", "camera/camera_info", "vio/raw"),
            (),
            "images from a device or files; with a T265 also its odometry",
            priority=20,
        ),
        NodeRow(
            "vio",
            "swift_ros",
            ("vio/odometry",),
            ("vio/raw", "imu/data_raw"),
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
            ("vio/odometry", "imu/data_raw", "gates/poses", "camera/camera_info"),
            "Kalman fusion of odometry, IMU and gates",
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
            "judge of the race, race services, health of the graph",
            priority=10,
        ),
        NodeRow(
            "recorder",
            "swift_ros",
            (),
            (),
            "rosbag2 MCAP folder of every topic",
            needed=False,
            restart_parameters=(("resume", True),),
            priority=10,
            background_priority=0,
        ),
        NodeRow(
            "mavlink_telemetry",
            "swift_ros",
            (),
            ("state/odometry", "battery", "race/status", "betaflight/link", "/diagnostics"),
            "telemetry to a ground station",
            needed=False,
        ),
        NodeRow(
            "bridge",
            "swift_sim_bridge",
            ("vio/raw", "camera/image_raw", "camera/camera_info", "imu/data_raw", "ground_truth/odometry", "/clock"),
            ("betaflight/link", "race/status", "race/judged"),
            "the simulator, in place of the hardware",
            onboard=False,
            priority=30,
            background_priority=15,
            module="swift_sim_bridge.bridge.node",
        ),
    )
}

# Topics that no node publishes; `swiftros import` reads them from foreign recordings.
IMPORTED = ("betaflight/feedforward",)

# Nodes that may subscribe to ground truth; a test checks it in the running graph.
GROUND_TRUTH_SUBSCRIBERS = ("bridge", "recorder", "race_monitor")


def full_name(topic: str, namespace: str = VEHICLE_NAMESPACE) -> str:
    """Return the absolute name of a topic or service of the table under a vehicle's namespace."""
    return topic if topic.startswith("/") else f"/{namespace}/{topic}"

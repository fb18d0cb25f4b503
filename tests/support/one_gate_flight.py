"""A flight straight through one gate, with known places, image, detected corners and end, written into a bag."""

import numpy as np
from rclpy.serialization import serialize_message
from sensor_msgs.msg import BatteryState

from swift_ros import configuration
from swift_ros.camera.model import Camera
from swift_ros.graph.topic_table import TOPICS, full_name
from swift_ros.messages.camera import to_image
from swift_ros.messages.control import to_command
from swift_ros.messages.gates import to_detections, to_state_updates
from swift_ros.messages.motion import to_imu, to_odometry
from swift_ros.messages.race import to_race_status
from swift_ros.messages.stamps import to_time
from swift_ros.race.judge import RaceEvent
from swift_ros.recording.bag_writer import BagWriter
from swift_ros.types import BodyRateThrust, GateCorners, GateUpdate, Odometry

SPEED, SECONDS = 5.0, 3.0  # m/s along x, s, at 2.4 s it leaves the volume
GREY_LEVEL, DRIFT_M = 210, 0.12
DEVIATION_M, RATE = 0.05, np.array([0.5, -0.25, 0.125])  # of the estimate, on each axis; rad/s, of the gyro
FORCE, THRUST = 11.5, 12.0  # m/s^2, specific force along z; commanded
LATENCY_NS = 20_000_000  # from an image to its corrections
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])
TRACK = """
name: one gate
gates: [{position: [4.0, 0.0, 2.0], yaw_deg: 0.0, roll_deg: 20.0, inner_side: 1.8, outer_side: 2.6}]
inner_side: 1.5
outer_side: 2.1
depth: 0.1
start: [-3.0, 0.0, 2.0]
start_yaw_deg: 0.0
laps: 1
bounds_min: [-12.0, -8.0, 0.0]
bounds_max: [9.0, 8.0, 6.0]
"""
CORNERS = np.array([[150.0, 150.0], [230.0, 150.0], [230.0, 230.0], [150.0, 230.0]])  # px, a detected gate
UNSEEN = [np.nan, np.nan]
INCOMPLETE = np.array(  # px, a gate without its lower left corner, and the left edge of another one
    [[[60.0, 170.0], [120.0, 170.0], [120.0, 230.0], UNSEEN], [[290.0, 170.0], UNSEEN, UNSEEN, [290.0, 230.0]]]
)
INCOMPLETE_EDGES = [  # px, between the seen neighbours, in the order of the corners
    INCOMPLETE[0, [0, 1]],
    INCOMPLETE[0, [1, 2]],
    INCOMPLETE[1, [3, 0]],
]


def incomplete_gates() -> list[GateCorners]:
    """Return the incomplete gates of each image."""
    return [GateCorners(corners, np.isfinite(corners[:, 0]).astype(float)) for corners in INCOMPLETE]


def write(folder, config, without=()):
    """Write a flight straight through the gate and out of the volume; `without` names topics that are left out."""
    stored = {
        f"config/{name}": (config / name).read_text() for name in ("drone.yaml", "camera.yaml", "simulation.yaml")
    }
    writer = BagWriter(folder / "bag", stored | {"config/track.yaml": TRACK})
    camera, rows = configuration.load(Camera, config / "camera.yaml"), []
    status = [RaceEvent(0, "idle"), RaceEvent(0, "racing")]
    rows += [(event.stamp_ns, "race/status", to_race_status(event)) for event in status]
    for tick in range(round(100 * SECONDS)):
        stamp_ns, p = tick * 10_000_000, np.array([-3.0 + SPEED * tick / 100, 0.0, 2.0])
        for topic, drift in (("ground_truth/odometry", 0.0), ("state/odometry", DRIFT_M)):
            covariance = DEVIATION_M**2 * np.eye(6) if drift else None
            position, velocity = p + [0.0, drift, 0.0], np.array([SPEED, 0.0, 0.0])
            state = Odometry(stamp_ns, position, LEVEL, velocity, np.zeros(3), covariance)
            rows.append((stamp_ns, topic, to_odometry(state, "map")))
        command = to_command(BodyRateThrust(stamp_ns, THRUST))
        rows.append((stamp_ns, "command/body_rate_thrust", command))
        rows.append((stamp_ns, "imu/data_raw", to_imu(stamp_ns, RATE, [0.0, 0.0, FORCE])))
        if tick % 10 == 0:
            image = to_image(np.full((camera.height, camera.width), GREY_LEVEL, np.uint8), stamp_ns)
            gates = to_detections(image.header, [GateCorners(CORNERS, np.ones(4))], incomplete_gates())
            battery = BatteryState(voltage=15.5)
            battery.header.stamp = to_time(stamp_ns)
            rows += [(stamp_ns, "camera/image_raw", image), (stamp_ns, "gates/detections", gates)]
            rows.append((stamp_ns, "battery", battery))
            updates = [GateUpdate(0, np.zeros(3), 1.5, True, ""), GateUpdate(-1, np.zeros(3), np.nan, False, "too far")]
            rows.append((stamp_ns + LATENCY_NS, "state/updates", to_state_updates(stamp_ns, updates)))
    rows = [row for row in rows if row[1] not in without]
    for topic in dict.fromkeys(topic for _, topic, _ in rows):
        writer.add_topic(full_name(topic), TOPICS[topic].type)
    for stamp_ns, topic, message in sorted(rows, key=lambda row: row[0]):
        writer.write(full_name(topic), serialize_message(message), stamp_ns)
    writer.close()
    return folder

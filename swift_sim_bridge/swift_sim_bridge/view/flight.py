"""The messages of a flight, topic by topic, as rows: the same for a bag and for the running graph."""

import numpy as np
import rerun as rr

from swift_ros.camera.model import Camera
from swift_ros.camera.projected_gates import gate_edges
from swift_ros.graph import latency
from swift_ros.graph.topic_table import full_name
from swift_ros.messages.camera import from_image
from swift_ros.messages.control import from_command
from swift_ros.messages.gates import from_detections, from_gate_poses, from_state_updates, incomplete_from_detections
from swift_ros.messages.motion import from_imu, from_odometry
from swift_ros.messages.race import from_race_status
from swift_ros.messages.stamps import from_time, message_stamp_ns
from swift_ros.track import Track
from swift_ros.types import Odometry
from swift_sim_bridge.view import scene, series
from swift_sim_bridge.view.poses import PathPieces, Poses
from swift_sim_bridge.view.rows import Row, Shape, Values

TRUTH, ESTIMATE, VIO = "ground_truth/odometry", "state/odometry", "vio/odometry"
LEVELS = {0: "INFO", 1: "WARN", 2: "ERROR", 3: "WARN"}  # of diagnostic_msgs/DiagnosticStatus; 3 is stale
RACE_LOG, LINK_LOG, ESTIMATE_LOG, NODE_LOG = "log/race", "log/betaflight", "log/estimate", "log/diagnostics"


class FlightRows:
    """Turns the messages of one flight into rows. It keeps the poses of the last second."""

    def __init__(self, camera: Camera | None, track: Track | None, has_truth: bool):
        """Make it.

        Args:
            camera: that takes the images; None: no gate of the map is projected.
            track: of the flight; None: its gates are those of the topic track/markers.
            has_truth: the vehicle is drawn at its ground truth, not at its estimate.
        """
        self._camera, self._has_truth = camera, has_truth
        self._corners = None if track is None else track.corners
        self._draws_markers = track is None
        self._estimates, self._truths = Poses(), Poses()
        self._paths = {topic: PathPieces() for topic in (TRUTH, ESTIMATE, VIO)}
        self._vio: Odometry | None = None
        self._next_gate: int | None = None
        self._is_aligned = False
        self._logged: dict[str, object] = {}  # the last text of each source, which is logged when it changes
        self._readers = {
            "camera/image_raw": self._image,
            "imu/data_raw": lambda message: series.imu(from_imu(message)),
            "command/body_rate_thrust": lambda message: series.command(from_command(message)),
            TRUTH: self._truth,
            ESTIMATE: self._estimate,
            VIO: self._odometry,
            "gates/detections": self._detections,
            "gates/poses": self._gate_poses,
            "state/updates": self._updates,
            "betaflight/link": self._link,
            "betaflight/rotors": self._rotors,
            "battery": self._battery,
            "race/status": self._status,
            "track/markers": self._markers,
            "/diagnostics": self._diagnostics,
        }

    @property
    def topics(self) -> dict[str, str]:
        """The topics that are shown: names in the table by full names."""
        return {full_name(topic): topic for topic in self._readers}

    def rows(self, topic: str, message) -> list[Row]:
        """Return what a message shows from its stamp on.

        Args:
            topic: its name in the table.
            message: of ROS.
        """
        return self._readers[topic](message)

    def _image(self, message) -> list[Row]:
        try:
            return [Shape(scene.IMAGE, scene.jpeg(from_image(message)))]
        except ValueError:  # of another encoding, or incomplete: the last one stays
            return []

    def _truth(self, message) -> list[Row]:
        state = from_odometry(message)
        self._truths.add(state)
        return [*self._vehicle(state), series.speed("truth", state), *self._piece(TRUTH, state)]

    def _estimate(self, message) -> list[Row]:
        state = from_odometry(message)
        self._estimates.add(state)
        rows: list[Row] = [Shape(scene.ESTIMATE, scene.pose(state)), series.speed("estimate", state)]
        rows += [series.attitude(state), *series.estimate_errors(state, self._truths.at(state.stamp_ns))]
        if (ellipsoid := scene.uncertainty(state)) is not None:
            rows.append(Shape(scene.UNCERTAINTY, ellipsoid))
        if not self._has_truth:
            rows += self._vehicle(state)
        if not self._is_aligned and self._vio is not None and self._vio.stamp_ns == state.stamp_ns:
            # the odometry starts in a frame of its own: it is drawn where the first estimate places it
            rows.append(Shape(scene.ODOM, scene.aligned(state, self._vio)))
            self._is_aligned = True
        return rows + self._piece(ESTIMATE, state)

    def _odometry(self, message) -> list[Row]:
        self._vio = from_odometry(message)
        return [series.speed("vio", self._vio), *self._piece(VIO, self._vio)]

    def _vehicle(self, state: Odometry) -> list[Row]:
        return [Shape(scene.VEHICLE, scene.pose(state))]

    def _piece(self, topic: str, state: Odometry) -> list[Row]:
        entity, color = {
            TRUTH: (scene.TRUTH_PATH, scene.TRUTH),
            ESTIMATE: (scene.ESTIMATE_PATH, scene.ESTIMATED),
            VIO: (scene.VIO_PATH, scene.VIO),
        }[topic]
        piece = self._paths[topic].add(state)
        return [] if piece is None else [Shape(entity, scene.path_piece(piece, color))]

    def _detections(self, message) -> list[Row]:
        rows: list[Row] = []
        rows += scene.detected_gates(scene.CORNERS, from_detections(message), scene.GREEN)
        rows += scene.detected_gates(scene.INCOMPLETE, incomplete_from_detections(message), scene.BLUE)
        lines = [line for _, line in self._edges(message)]
        return [*rows, Shape(scene.MAP_GATES, scene.image_lines(lines, scene.GREY, 0.5))]

    def _edges(self, message) -> list[tuple[int, np.ndarray]]:
        """Return the gates of the map at the stamp of an image, as the estimate projects them."""
        state = self._estimates.at(from_time(message.header.stamp))
        if state is None or self._camera is None or self._corners is None:
            return []
        return gate_edges(self._camera, self._corners, state.p_world, state.q_world_body)

    def _gate_poses(self, message) -> list[Row]:
        return [Shape(scene.OBSERVED, scene.observed_gates(from_gate_poses(message)))]

    def _updates(self, message) -> list[Row]:
        found = from_state_updates(message)
        matched = {update.gate for update in found if update.accepted}
        lines = [line for gate, line in self._edges(message) if gate in matched]
        rows: list[Row] = [*series.updates(found), Shape(scene.MATCHED, scene.image_lines(lines, scene.AMBER, 1.0))]
        for update in found:
            if not update.accepted:
                gate = f"gate {update.gate + 1}" if update.gate >= 0 else "a gate"
                rows.append(Shape(ESTIMATE_LOG, rr.TextLog(f"{gate} refused: {update.reason}", level="DEBUG")))
        return rows

    def _link(self, message) -> list[Row]:
        rows: list[Row] = [Values("latency/round_trip", (message.round_trip_ms,))]
        state = "armed" if message.armed else "disarmed"
        texts = {
            "armed": state,
            "modes": f"modes {', '.join(message.modes) or 'none'}",
            "blocks": f"arming blocked by {', '.join(message.arming_blocks) or 'nothing'}",
            "failsafe": "failsafe" if message.failsafe else "no failsafe",
        }
        changed = [self._changed(f"link {name}", text) for name, text in texts.items()]
        level = "ERROR" if message.failsafe else "INFO"
        rows += [Shape(LINK_LOG, rr.TextLog(text, level=level)) for text in changed if text]
        if changed[0]:
            rows.append(Shape("states/betaflight", rr.StateChange(state=state)))
        return rows

    def _changed(self, source: str, text: str) -> str:
        """Return a text when it is another than the last one of its source, else ""."""
        if self._logged.get(source) == text:
            return ""
        self._logged[source] = text
        return text

    def _rotors(self, message) -> list[Row]:
        rows: list[Row] = []
        if len(message.motor):
            rows.append(Values("motors/command", tuple(message.motor)))
        if len(message.speed):
            rows.append(Values("motors/speed", tuple(message.speed)))
        if rows and self._changed("rotors", str(len(message.motor))):
            rows += series.motor_styles(len(message.motor))
        return rows

    def _battery(self, message) -> list[Row]:
        return [Values("battery/voltage", (message.voltage,)), Values("battery/current", (-message.current,))]

    def _status(self, message) -> list[Row]:
        event = from_race_status(message)
        text = f"{event.state}: {event.text}" if event.text else event.state
        if event.is_passage:
            text += f", split {event.split_s:.3f} s, margin {event.margin_m:.2f} m"
        rows: list[Row] = [Shape(RACE_LOG, rr.TextLog(text, level="INFO"))]
        rows.append(Values("race/next_gate", (event.next_gate + 1,)))
        if self._changed("race", event.state):
            rows.append(Shape("states/race", rr.StateChange(state=event.state)))
        self._next_gate = event.next_gate
        return rows + self._next_ring()

    def _next_ring(self) -> list[Row]:
        """Return the next gate in amber; the race and the gates may come in any order."""
        if self._corners is None or self._next_gate is None or self._next_gate >= len(self._corners):
            return []
        ring = scene.gate_rings(self._corners[self._next_gate : self._next_gate + 1], scene.AMBER)
        return [Shape(scene.NEXT_GATE, ring)]

    def _markers(self, message) -> list[Row]:
        if not self._draws_markers:
            return []
        rings = [[(p.x, p.y, p.z) for p in marker.points[:4]] for marker in message.markers if len(marker.points) == 5]
        if not rings:
            return []
        self._corners = np.array(rings)
        centres, sides = self._corners.mean(axis=1), np.linalg.norm(np.diff(self._corners[:, :2], axis=1)[:, 0], axis=1)
        return [
            Shape(scene.GATES, scene.gate_rings(self._corners, scene.STEEL)),
            Shape("map/track/numbers", scene.gate_numbers(centres, sides)),
            *self._next_ring(),
        ]

    def _diagnostics(self, message) -> list[Row]:
        rows: list[Row] = []
        for status in message.status:
            level = status.level[0] if isinstance(status.level, bytes) else status.level
            is_first = status.name not in self._logged
            if self._changed(status.name, f"{level} {status.message}") and (level or not is_first):
                text = f"{status.name}: {status.message}"
                rows.append(Shape(NODE_LOG, rr.TextLog(text, level=LEVELS.get(level, "WARN"))))
            name = status.name.removeprefix("topic ").replace("/", ".").strip(".")
            for pair in status.values:
                if (value := _number(pair.value)) is not None:
                    rows.append(Values(f"diagnostics/{pair.key}/{name}", (value,)))
        return rows


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if np.isfinite(value) else None


def latency_rows(topic: str, message, at_ns: int) -> list[Row]:
    """Return the age of a message of the chain from image and odometry to the MSP frame, ms.

    Args:
        topic: its name in the table.
        message: of ROS.
        at_ns: time of its publication or, in a bag, of its recording.
    """
    stamp_ns = message_stamp_ns(message)
    if topic == "betaflight/link":
        at_ns = latency.written_ns(stamp_ns, at_ns)
        stamp_ns = from_time(message.command_stamp)
    if topic not in latency.TOPICS or not stamp_ns or abs(at_ns - stamp_ns) > latency.MAX_SAME_CLOCK_NS:
        return []
    return [Values(f"latency/{topic.replace('/', '.')}", (1e-6 * (at_ns - stamp_ns),))]


def static_rows(track: Track | None, vehicle) -> list[Shape]:
    """Return what a flight shows at all times.

    Args:
        track: of the flight; None for none.
        vehicle: that is drawn.
    """
    shapes = [Shape(scene.MAP, rr.ViewCoordinates.RIGHT_HAND_Z_UP), *series.styles()]
    shapes.append(Shape(f"{scene.VEHICLE}/body", scene.vehicle_shape(vehicle)))
    shapes.append(Shape(f"{scene.ESTIMATE}/axes", rr.TransformAxes3D(0.3)))
    return shapes + (scene.track_shapes(track) if track is not None else [])

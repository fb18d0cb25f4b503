"""`swiftros view` on a running graph: what is published is shown, and the graph does not notice the view."""

import threading

import numpy as np
import pytest
import rclpy
from one_gate_flight import INCOMPLETE, INCOMPLETE_EDGES, incomplete_gates
from patience import wait_for
from std_msgs.msg import Header

from swift_ros import cli, configuration
from swift_ros.graph.qos import qos_profile
from swift_ros.graph.topic_table import TOPICS
from swift_ros.messages.control import to_command
from swift_ros.messages.gates import to_detections
from swift_ros.messages.motion import to_odometry
from swift_ros.messages.race import to_race_status, to_track_markers
from swift_ros.messages.serialization import message_type
from swift_ros.messages.stamps import to_time
from swift_ros.race.judge import RaceEvent
from swift_ros.track import Track
from swift_ros.types import BodyRateThrust, Odometry

PERIOD_S, SECONDS = 0.02, 6.0
SPEED = 2.0  # m/s, along x
BEGIN_NS = 1_700_000_000_000_000_000


class Graph:
    """A node that publishes a flight along x: its thrust is the number of the tick."""

    def __init__(self, domain: int, track: Track):
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = rclpy.create_node("graph", namespace="swift", context=self.context)
        names = ("command/body_rate_thrust", "state/odometry", "gates/detections", "race/status", "track/markers")
        self.publishers = {name: self.publisher(TOPICS[name]) for name in names}
        self.publishers["track/markers"].publish(to_track_markers(track))
        self.publishers["race/status"].publish(to_race_status(RaceEvent(BEGIN_NS, "racing", 1)))
        self.ended = threading.Event()
        self.thread = threading.Thread(target=self.fly)

    def publisher(self, topic):
        return self.node.create_publisher(message_type(topic.type), topic.name, qos_profile(topic, False))

    def fly(self):
        tick = 0
        while not self.ended.wait(PERIOD_S):
            stamp_ns = BEGIN_NS + round(1e9 * PERIOD_S * tick)
            p = np.array([SPEED * PERIOD_S * tick, 0.0, 1.0])
            state = Odometry(stamp_ns, p, np.array([0.0, 0.0, 0.0, 1.0]), np.array([SPEED, 0.0, 0.0]), np.zeros(3))
            self.publishers["state/odometry"].publish(to_odometry(state, "map"))
            self.publishers["command/body_rate_thrust"].publish(to_command(BodyRateThrust(stamp_ns, tick)))
            header = Header(stamp=to_time(stamp_ns))
            self.publishers["gates/detections"].publish(to_detections(header, [], incomplete_gates()))
            tick += 1

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *exception):
        self.ended.set()
        self.thread.join()
        self.node.destroy_node()
        self.context.try_shutdown()


def test_a_running_graph_is_shown_and_left_as_it_was(tmp_path, domain, capsys):
    pytest.importorskip("rerun", reason="needs Rerun: make view")
    from rerun_file import RerunFile

    track = configuration.load(Track, configuration.configuration_folder() / "track.yaml")
    out = tmp_path / "live.rrd"
    with Graph(domain, track) as graph:
        assert cli.main(["view", "--save", str(out), "--seconds", str(SECONDS)]) == 0
        counts = [publisher.get_subscription_count for publisher in graph.publishers.values()]
        wait_for(lambda: not any(count() for count in counts))
    assert "none on" in capsys.readouterr().out  # the topics that no node publishes
    shown = RerunFile(out)
    t, ticks = shown.curve("thrust/command")
    assert len(t) > 0.2 * SECONDS / PERIOD_S
    assert np.diff(ticks[:, 0]) == pytest.approx(np.diff(t) / PERIOD_S, abs=1e-6)
    t, places = shown.column("map/vehicle", "Transform3D:translation")
    x = np.array([place[0][0] for place in places])
    assert np.diff(x) == pytest.approx(SPEED * np.diff(t), abs=1e-4)
    _, corners = shown.column("camera/image/incomplete_gates", "Points2D:positions")
    assert np.array(corners[0]) == pytest.approx(INCOMPLETE[np.isfinite(INCOMPLETE)].reshape(-1, 2) + 0.5)
    _, edges = shown.column("camera/image/incomplete_gates/edges", "LineStrips2D:strips")
    assert np.array(edges[0]) == pytest.approx(np.array(INCOMPLETE_EDGES) + 0.5)
    _, rings = shown.column("map/track/gates", "LineStrips3D:strips")
    assert np.array(rings[0])[:, :4] == pytest.approx(track.corners, abs=1e-5)
    assert shown.texts("log/race") == ["racing"]  # latched before the view began
    _, ring = shown.column("map/track/next_gate", "LineStrips3D:strips")
    assert np.array(ring[0])[0, :4] == pytest.approx(track.corners[1], abs=1e-5)


def test_a_domain_without_a_graph_is_named(capsys, tmp_path, domain):
    pytest.importorskip("rerun", reason="needs Rerun: make view")
    assert cli.main(["view", "--save", str(tmp_path / "live.rrd"), "--domain", str(domain)]) == 2
    error = capsys.readouterr().err
    assert f"no graph is running in ROS domain {domain}" in error and len(error.strip().splitlines()) == 1

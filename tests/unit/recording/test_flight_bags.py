"""Flight tables from bags: of this graph, and of imported recordings."""

import gzip
import json

import numpy as np
import pytest

from swift_ros import cli, geometry
from swift_ros.camera.model import Camera
from swift_ros.configuration import configuration_folder, load
from swift_ros.errors import UsageError
from swift_ros.graph.topic_table import TOPICS, full_name
from swift_ros.messages.control import to_battery, to_command, to_rotors
from swift_ros.messages.gates import to_detections
from swift_ros.messages.motion import to_odometry
from swift_ros.messages.serialization import serialize
from swift_ros.recording import flight_files
from swift_ros.recording.bag_writer import BagWriter
from swift_ros.track import Track
from swift_ros.types import BodyRateThrust, GateCorners, Odometry

RATE = 200.0
N = 400


def record(folder, topics, stamps_ns, custom=None):
    """Write a bag.

    Args:
        folder: of the bag.
        topics: by name (every, message): a message for every n-th stamp, and a function of its index and stamp.
        stamps_ns: stamps (n,).
        custom: custom data of the bag.
    """
    writer = BagWriter(folder, custom)
    for topic, (_, _) in topics.items():
        writer.add_topic(full_name(topic), TOPICS[topic].type)
    for k, stamp_ns in enumerate(stamps_ns):
        for topic, (every, message) in topics.items():
            if k % every == 0:
                writer.write(full_name(topic), serialize(message(k, int(stamp_ns))), int(stamp_ns))
    writer.close()


def test_a_bag_of_this_graph_is_a_flight_with_ground_truth_and_not_with_its_own_estimate(tmp_path):
    t = np.arange(N) / RATE
    q = geometry.quaternion_from_yaw(np.sin(t))
    noise = 0.01 * np.random.default_rng(3).standard_normal((10, N))
    p, v_world = (np.stack([9.0 + np.sin((i + k) * t) + noise[i + k] for i in range(3)], axis=-1) for k in (0, 3))
    v_body = geometry.rotate_inverse(q, v_world)
    rotors = np.stack([1000.0 + 200.0 * np.sin((i + 6) * t) + 2000.0 * noise[i + 6] for i in range(4)], axis=-1)

    def odometry(k, stamp_ns):
        return to_odometry(Odometry(stamp_ns, p[k], q[k], v_body[k], np.zeros(3)), "map")

    stamps_ns = 1_700_000_000_000_000_000 + np.round(t * 1e9).astype(np.int64)
    topics = {
        "ground_truth/odometry": (1, odometry),
        "betaflight/rotors": (2, lambda k, t: to_rotors(t, rotors[k], [])),
        "battery": (20, lambda k, t: to_battery(t, 15.5 - 1e-3 * k, 40.0 + 1e-3 * k * k, 0.1, 1.55)),
        "command/body_rate_thrust": (1, lambda k, t: to_command(BodyRateThrust(t, 9.0 + k % 3))),
    }
    record(tmp_path / "imported", topics, stamps_ns, {"imported": json.dumps([*topics])})
    table = flight_files.read(tmp_path / "imported")
    np.testing.assert_allclose(table["v_world"].values, v_world, atol=1e-9)
    np.testing.assert_allclose(table["rotor_speed"].t, t[::2], atol=1e-9)
    np.testing.assert_allclose(table["rotor_speed"].values, rotors[::2])
    assert "motor_command" not in table and table["current"].values[1] == pytest.approx(40.4)
    assert not table.skips_commands
    record(
        tmp_path / "merged", topics, stamps_ns, {"imported": '["betaflight/rotors"]'}
    )  # motors of a foreign log, other topics of this graph
    merged = flight_files.read(tmp_path / "merged")
    assert not merged.skips_commands and "v_world" not in merged and len(merged["voltage"].t) < len(table["voltage"].t)
    record(tmp_path / "without_truth", {"state/odometry": (1, odometry), **dict([*topics.items()][1:])}, stamps_ns)
    with pytest.raises(UsageError, match="neither a pose"):
        flight_files.read(tmp_path / "without_truth")


def test_the_low_passes_of_a_flight_controllers_meters_are_inverted(tmp_path):
    """Betaflight reports voltage and current behind low-passes of 0.5 s and 0.17 s, which change the apparent battery
    sag."""
    dt = 0.005
    t = dt * np.arange(4000)
    truth = {"voltage": 15.5 - 0.5 * np.sin(2.0 * t), "current": 50.0 + 30.0 * np.sin(3.0 * t)}
    displayed = {name: np.empty(len(t)) for name in truth}
    for name, period in (("voltage", 3.0), ("current", 1.0)):  # vbat_display_lpf_period 30, ibat_lpf_period 10
        kept, at = np.exp(-2.0 * np.pi * dt / period), truth[name][0]
        for k, value in enumerate(truth[name]):
            displayed[name][k] = at = kept * at + (1.0 - kept) * value
    topics = {
        "ground_truth/odometry": (
            1,
            lambda k, stamp_ns: to_odometry(
                Odometry(stamp_ns, [0, 0, 1 + 0.1 * t[k]], [0, 0, 0, 1], np.full(3, 7.0), np.zeros(3)), "map"
            ),
        ),
        "betaflight/rotors": (2, lambda k, stamp_ns: to_rotors(stamp_ns, 900 + t[k] * np.ones(4), [0.4] * 4)),
        "battery": (
            20,
            lambda k, stamp_ns: to_battery(stamp_ns, displayed["voltage"][k], displayed["current"][k], 0.1, 1.55),
        ),
    }
    record(tmp_path / "bag", topics, np.round(t * 1e9).astype(np.int64))
    table = flight_files.read(tmp_path / "bag")
    for name, error in (("voltage", 0.01), ("current", 0.5)):
        expected = np.interp(table[name].t, t, truth[name])
        assert np.abs(table[name].values - expected).max() < error
        assert (
            np.abs(np.interp(table[name].t, t, displayed[name]) - expected).max() > 10 * error
        )  # error of the displayed values
    assert table.skips_commands  # motor commands are polled at 100 Hz from a loop at several kHz
    assert "v_world" not in table  # it follows from the position


def test_detected_gates_of_a_bag_come_with_the_camera_and_track_stored_in_it(tmp_path):
    stamps_ns = np.arange(0, N) * 5_000_000
    seen = np.arange(8.0).reshape(4, 2)

    def odometry(k, stamp_ns):
        return to_odometry(Odometry(stamp_ns, np.zeros(3), [0, 0, 0, 1], np.zeros(3), np.zeros(3)), "map")

    def detections(k, stamp_ns):
        gates = [GateCorners(seen + k + i, np.ones(4)) for i in range(2)]
        return to_detections(odometry(k, stamp_ns).header, gates if k else [])

    topics = {
        "ground_truth/odometry": (1, odometry),
        "gates/detections": (10, detections),
        "command/body_rate_thrust": (1, lambda k, t: to_command(BodyRateThrust(t, 9.0))),
    }
    folder = configuration_folder()
    stored = {f"config/{name}.yaml": (folder / f"{name}.yaml").read_text() for name in ("camera", "track")}
    record(tmp_path / "stored", topics, stamps_ns, stored)
    table = flight_files.read(tmp_path / "stored")
    assert table.detected_gates.t[:4] == pytest.approx([0.05, 0.05, 0.1, 0.1])
    np.testing.assert_array_equal(table.detected_gates.corners[1], seen + 11)
    assert table.detected_gates.camera == load(Camera, folder / "camera.yaml")
    assert table.detected_gates.track == load(Track, folder / "track.yaml")
    record(tmp_path / "bare", topics, stamps_ns)
    assert flight_files.read(tmp_path / "bare").detected_gates is None


def test_an_imported_nanobench_flight_is_a_table_and_keeps_its_rejections(tmp_path, shared_data):
    with gzip.open(shared_data / "nanobench" / "B2_circle_slow_rep2.csv.gz", "rt") as file:
        lines = file.readlines()
    with gzip.open(tmp_path / "end.csv.gz", "wt") as file:
        file.writelines([lines[0], *lines[-500:]])
    assert cli.main(["import", str(tmp_path / "end.csv.gz"), "--out", str(tmp_path / "out")]) == 0
    table = flight_files.read(tmp_path / "out")
    assert {"p_world", "gyro_body", "motor_command", "voltage"} < set(table.channels)
    assert "rotor_speed" not in table and any(rejection.channel == "gyro" for rejection in table.rejections)

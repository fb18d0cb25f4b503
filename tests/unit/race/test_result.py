"""The result of a race from its bag: a known race is written into a bag, read back, and its planted values found."""

import dataclasses
import json

import numpy as np
import pytest
from rclpy.serialization import serialize_message

from swift_ros import configuration
from swift_ros.errors import UsageError
from swift_ros.graph.topic_table import TOPICS, full_name
from swift_ros.messages.motion import to_odometry
from swift_ros.messages.race import to_race_status
from swift_ros.race import result as race_result
from swift_ros.race.judge import RaceEvent
from swift_ros.recording import race_bag
from swift_ros.recording.bag_writer import BagWriter
from swift_ros.track import Gate, Track
from swift_ros.types import Odometry
from swift_ros.vehicle import Vehicle

LEVEL = np.array([0.0, 0.0, 0.0, 1.0])
GATES = Gate((5.0, 0.0, 2.0), 0.0), Gate((-5.0, 0.0, 4.0), 180.0)
TRACK = Track("ring", GATES, 1.5, 2.1, 0.1, (0.0, 0.0, 2.0), 0.0, 1, (-20.0, -20.0, 0.0), (20.0, 20.0, 9.0))
START_NS = 1_000_000_000


@pytest.fixture(scope="module")
def vehicle(repository):
    return configuration.load(Vehicle, repository / "config" / "drone.yaml")


def course():
    """Positions at 100 Hz: a second on the podium, then round and round at 10 m/s, 0.1 m off the centres."""
    corners = [(0, 0.1, 2), (8, 0.1, 2), (8, 0.1, 4), (-8, 0.1, 4), (-8, 0.1, 2)]
    path = [corners[0], *corners[1:], *corners[1:3]]
    points = [np.array(path[0])] * 100
    for a, b in zip(map(np.array, path[:-1]), map(np.array, path[1:]), strict=True):
        count = round(np.linalg.norm(b - a) / 0.1)
        points += [a + (b - a) * i / count for i in range(count)]
    return points


def odometry(points, drift=0.0):
    v = [(b - a) * 100 for a, b in zip(points[:-1], points[1:], strict=True)] + [np.zeros(3)]
    offset = np.array([0.0, 0.0, drift])
    return [Odometry(i * 10_000_000, p + offset, LEVEL, v[i], np.zeros(3)) for i, p in enumerate(points)]


def record(folder, streams, events, report=None):
    """Write a race as the recorder would."""
    writer = BagWriter(folder / race_result.BAG)
    rows = []
    for topic, states in streams.items():
        rows += [(state.stamp_ns, topic, to_odometry(state, "map")) for state in states]
    rows += [(event.stamp_ns, "race/status", to_race_status(event)) for event in events]
    for topic in {"race/status", *streams}:
        writer.add_topic(full_name(topic), TOPICS[topic].type)
    for stamp_ns, topic, message in sorted(rows, key=lambda row: row[0]):
        writer.write(full_name(topic), serialize_message(message), stamp_ns)
    writer.close()
    (folder / race_result.REPORT).write_text(json.dumps(report or {}))
    return folder


def streams(points):
    return {
        "ground_truth/odometry": odometry(points),
        "state/odometry": odometry(points, drift=0.1),
        "vio/odometry": odometry(points, drift=0.5),
    }


STARTED = [RaceEvent(0, "idle"), RaceEvent(START_NS - 10, "armed"), RaceEvent(START_NS, "racing", text="start")]


def test_the_result_of_a_whole_race_is_read_back(tmp_path, vehicle):
    points = course()
    report = {"seed": 7, "thrust_to_weight": [4.1, 3.9], "msp_sha256": "abc"}
    record(tmp_path, streams(points), [*STARTED, RaceEvent(4_900_000_000, "finished", lap=1, split_s=1.0)], report)
    result, _ = race_bag.read_race(tmp_path, TRACK, vehicle)
    assert (result.finished, result.end, result.gates_passed, result.crash) == (True, "finished", 3, None)
    length = 8 + 2 + 16 + 2 + 8 + 5  # podium to gate 1 again, along the course
    assert result.time_s == pytest.approx(length / 10, abs=0.011)
    assert result.laps_s == [pytest.approx((length - 5) / 10, abs=0.011)]
    assert result.min_gate_margin_m == pytest.approx(0.75 - 0.1 - 0.18, abs=2e-3)
    assert (result.state_rmse_m, result.vio_rmse_m) == (pytest.approx(0.1), pytest.approx(0.5))
    assert (result.seed, result.thrust_to_weight, result.msp_sha256) == (7, [4.1, 3.9], "abc")


def test_the_truth_hash_depends_on_the_flight_up_to_the_end_only(tmp_path, vehicle):
    points, ended = course(), RaceEvent(3_000_000_000, "stopped", text="stopped by race/stop")
    other_end, other_start = [*points[:320], np.array([1.0, 1.0, 1.0])], [points[0] + 1e-9, *points[1:]]
    hashes = []
    for name, tail in (("a", points), ("b", other_end), ("c", other_start)):
        (tmp_path / name).mkdir()
        record(tmp_path / name, streams(tail), [*STARTED, ended])
        hashes.append(race_bag.read_race(tmp_path / name, TRACK, vehicle)[0].truth_sha256)
    assert hashes[0] == hashes[1] != hashes[2]


def test_a_crash_and_a_cut_recording_are_named_as_the_end(tmp_path, vehicle):
    points = [*course()[:130], *(np.array([x, 0.9, 2.0]) for x in np.arange(3.0, 6.0, 0.1))]
    points[129] = points[130] - [0.1, 0.0, 0.0]
    record(tmp_path, {"ground_truth/odometry": odometry(points)}, [*STARTED, RaceEvent(1_500_000_000, "crashed")])
    result, _ = race_bag.read_race(tmp_path, TRACK, vehicle)
    assert (result.end, result.crash, result.gates_passed, result.time_s) == ("crashed", "touched gate 1", 0, None)
    assert result.state_rmse_m is None
    (tmp_path / "cut").mkdir()
    record(tmp_path / "cut", streams(course()[:150]), STARTED)
    cut = race_bag.read_race(tmp_path / "cut", TRACK, vehicle)[0]
    assert cut.end == "lost" and cut.crash == "the bag stops before the race ends"


def test_without_ground_truth_the_published_race_is_the_result(tmp_path, vehicle):
    passage = RaceEvent(2_000_000_000, "racing", 1, 0, split_s=1.0)
    record(tmp_path, {"state/odometry": odometry(course())}, [*STARTED, passage, RaceEvent(3_000_000_000, "stopped")])
    result, _ = race_bag.read_race(tmp_path, TRACK, vehicle)
    assert (result.end, result.gates_passed) == ("stopped", 1)
    (tmp_path / "finish").mkdir()
    finish = RaceEvent(3_000_000_000, "finished", 1, 1, split_s=1.0)
    events = [*STARTED, passage, finish, RaceEvent(3_500_000_000, "stopped")]
    record(tmp_path / "finish", {"state/odometry": odometry(course())}, events)
    assert race_bag.read_race(tmp_path / "finish", TRACK, vehicle)[0].finished  # stopped after the finish
    assert (result.truth_sha256, result.min_gate_margin_m) == (None, None)


def test_the_summary_has_rates_and_medians_and_a_changed_number_is_found(tmp_path, vehicle):
    record(tmp_path, streams(course()), [*STARTED, RaceEvent(4_900_000_000, "finished", lap=1, split_s=1.0)])
    result, _ = race_bag.read_race(tmp_path, TRACK, vehicle)
    lost = dataclasses.replace(result, finished=False, end="lost", laps_s=[])
    summary = race_result.summary([result, lost], {"pilot": "00"})
    assert summary["finish_rate"] == 0.5 and summary["best_lap_s"] == summary["median_lap_s"] == result.laps_s[0]
    stored = json.loads(json.dumps(summary))
    assert race_result.disagreements(stored, summary) == []
    stored["races"][0]["time_s"] += 0.01
    (sentence,) = race_result.disagreements(stored, summary)
    assert sentence.startswith("races[0].time_s")


def test_a_bag_without_race_status_is_refused(tmp_path, vehicle):
    writer = BagWriter(tmp_path / race_result.BAG)
    writer.close()
    with pytest.raises(UsageError, match="/swift/race/status"):
        race_bag.read_race(tmp_path, TRACK, vehicle)

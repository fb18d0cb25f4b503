"""Faults are drawn, planted and judged: each draw is a function of its seed, and no ending is taken for defined."""

import dataclasses
import json
import os
import shutil
import socket
import threading
import time

import numpy as np
import pytest

from swift_ros.errors import UsageError
from swift_ros.graph.topic_table import NODES, TOPICS
from swift_ros.messages.race import to_race_status
from swift_ros.messages.serialization import message_type, serialize
from swift_ros.messages.stamps import message_stamp_ns, to_time
from swift_ros.race.judge import FINISHED, LOST, RACING, RaceEvent
from swift_ros.race.result import BAG, REPORT
from swift_ros.recording.bag_writer import BagWriter
from swift_sim_bridge.faults import batch, catalogue, ending, message_errors, picture, tables
from swift_sim_bridge.faults.injection import Flown
from swift_sim_bridge.faults.serial_line import SerialLine

SECOND = 1_000_000_000


def test_a_draw_is_a_function_of_its_seed_and_four_hundred_meet_every_kind_and_node():
    drawn = [catalogue.draw(seed) for seed in range(400)]
    assert drawn == [catalogue.draw(seed) for seed in range(400)]
    assert {fault.kind for fault in drawn} == set(catalogue.KINDS)
    assert {fault.target for fault in drawn} >= set(catalogue.VICTIMS) | set(catalogue.RELAYED)
    assert sum(fault.clock == catalogue.LOCKSTEP for fault in drawn) == 200
    assert all(str(round(fault.at_s, 2)) in fault.sentence for fault in drawn)


def test_every_topic_from_one_node_to_another_is_a_target():
    needed = {topic for name in catalogue.VICTIMS for topic in NODES[name].subscribes} - {"/diagnostics"}
    assert needed == set(catalogue.RELAYED)


@pytest.mark.parametrize("name", catalogue.WITH_NUMBERS)
def test_a_wrong_number_of_any_size_fits_into_any_message(name):
    rng, kind = np.random.default_rng(0), message_type(TOPICS[name].type)
    for size in (None, 10.0, 1e300):
        message = kind()
        message_errors.make_up(message, rng, 5 * SECOND)
        before = serialize(message)
        message_errors.spoil(message, rng, size)
        changed = serialize(message) != before
        assert changed or not message_errors._numbers(message)


def test_made_up_messages_have_a_valid_stamp_every_other_time():
    rng, kind = np.random.default_rng(1), message_type("swift_msgs/msg/RaceStatus")
    filled = [kind() for _ in range(100)]
    for message in filled:
        message_errors.make_up(message, rng, 5 * SECOND)
    stamps = [message_stamp_ns(message) for message in filled]
    assert set(stamps) == {0, 5 * SECOND} and 30 < stamps.count(0) < 70
    assert {message.state for message in filled} == set(message_errors.STATES)


def connected(port):
    """Return a connection to a port that refuses at first."""
    deadline_s = time.monotonic() + 10.0
    while True:
        try:
            return socket.create_connection(("127.0.0.1", port))
        except ConnectionRefusedError:
            assert time.monotonic() < deadline_s


@pytest.mark.parametrize(("kind", "share"), [(catalogue.LOST_BYTES, 0.2), (catalogue.WRONG_BYTES, 0.2)])
def test_a_serial_line_disturbs_its_share_of_the_bytes_and_no_other(kind, share):
    controller = socket.create_server(("127.0.0.1", 0))
    line = SerialLine(controller.getsockname()[1], 3)
    link = connected(line.port)
    accepted, _ = controller.accept()
    sent = bytes(range(256)) * 40
    received = bytearray()

    def read():
        while data := accepted.recv(4096):
            received.extend(data)

    reader = threading.Thread(target=read)
    reader.start()
    link.sendall(sent)
    while len(received) < len(sent):
        pass
    assert received == sent
    received.clear()
    line.disturb(kind, share)
    link.sendall(sent)
    link.shutdown(socket.SHUT_WR)
    reader.join(timeout=10.0)
    if kind == catalogue.LOST_BYTES:
        assert 0.75 < len(received) / len(sent) < 0.85
    else:
        wrong = sum(a != b for a, b in zip(received, sent, strict=True))
        assert 0.15 < wrong / len(sent) < 0.25
    for end in (line, link, accepted, controller):
        end.close()


@pytest.fixture
def flown_folder(tmp_path):
    """Return the folder of a race that was recorded up to its start, with a report of a vehicle at rest."""
    writer, topic = BagWriter(tmp_path / BAG), "/swift/race/status"
    writer.add_topic(topic, "swift_msgs/msg/RaceStatus")
    start = RaceEvent(SECOND, RACING, 1, 0, text="start")
    writer.write(topic, serialize(to_race_status(start)), SECOND)
    writer.close()
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "vio.log").write_text("all is well\n")
    (tmp_path / REPORT).write_text(json.dumps({"speed_m_s": 0.0, "contact": None, "impact_m_s": None}))
    return tmp_path


FAULT = catalogue.Fault(7, catalogue.REAL_TIME, catalogue.KILL, "vio", 1.0, catalogue.FOREVER_S, 0.0)
HELPER = catalogue.Fault(8, catalogue.LOCKSTEP, catalogue.KILL, "recorder", 1.0, catalogue.FOREVER_S, 0.0)
FOREIGN = catalogue.Fault(
    8, catalogue.LOCKSTEP, catalogue.FOREIGN_PUBLISHER, "state/odometry", 1.0, catalogue.FOREVER_S, 50.0
)
LOST_RACE = RaceEvent(2 * SECOND + 100_000_000, LOST, 2, 0, text="vio was killed")
SAFE_NS = 2 * SECOND + 150_000_000
LANDED = Flown(2 * SECOND, LOST_RACE, SAFE_NS, ())


def test_a_descent_after_a_fault_is_defined(flown_folder):
    found = ending.ending_of(FAULT, LANDED, flown_folder)
    assert (found.way, found.reason, found.problems) == (ending.LANDED, "vio was killed", ())
    assert found.safe_s == pytest.approx(0.05)


def record_end(folder, end_stamp_ns, end_log_ns):
    """Write the bag of a race that is lost, with link statuses that are safe before its start and at its end."""
    shutil.rmtree(folder / BAG)
    writer = BagWriter(folder / BAG)
    writer.add_topic("/swift/race/status", "swift_msgs/msg/RaceStatus")
    writer.add_topic("/swift/betaflight/link", "swift_msgs/msg/BetaflightLink")
    events = [(SECOND, RaceEvent(SECOND, RACING, 1, 0, text="start"))]
    events.append((end_log_ns, dataclasses.replace(LOST_RACE, stamp_ns=end_stamp_ns)))
    for log_ns, event in events:
        writer.write("/swift/race/status", serialize(to_race_status(event)), log_ns)
    for stamp_ns, failsafe in ((SECOND // 2, True), (2 * SECOND, False), (SAFE_NS, True), (3 * SECOND, True)):
        message = message_type("swift_msgs/msg/BetaflightLink")(armed=True, failsafe=failsafe)
        message.header.stamp = to_time(stamp_ns)
        writer.write("/swift/betaflight/link", serialize(message), stamp_ns)
    writer.close()


def test_the_first_safe_frame_is_that_of_the_bag_where_the_runner_saw_it_late(flown_folder):
    record_end(flown_folder, LOST_RACE.stamp_ns, LOST_RACE.stamp_ns)
    late = dataclasses.replace(LANDED, safe_ns=3 * SECOND)
    assert ending.ending_of(FAULT, late, flown_folder).safe_s == pytest.approx(0.05)


def test_the_end_of_a_race_whose_stamps_jump_is_when_it_was_received(flown_folder):
    record_end(flown_folder, 77 * SECOND, LOST_RACE.stamp_ns)
    fault = dataclasses.replace(FAULT, kind=catalogue.TIME_JUMP, target="race/status")
    jumped = dataclasses.replace(LANDED, end=dataclasses.replace(LOST_RACE, stamp_ns=77 * SECOND))
    assert ending.ending_of(fault, jumped, flown_folder).safe_s == pytest.approx(0.05)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"end": None}, "no end"),
        ({"end": RaceEvent(2 * SECOND, LOST, 2, 0)}, "without a reason"),
        ({"safe_ns": 3 * SECOND}, "first safe frame came 0.90 s"),
        ({"safe_ns": None}, "no safe frame"),
        ({"fault_ns": None}, "before the fault"),
    ],
)
def test_an_undefined_course_is_named(flown_folder, change, problem):
    flown = Flown(**{**LANDED.__dict__, **change})
    assert any(problem in text for text in ending.ending_of(FAULT, flown, flown_folder).problems)


def test_a_moving_vehicle_a_traceback_and_a_lost_bag_are_named(flown_folder):
    (flown_folder / REPORT).write_text(json.dumps({"speed_m_s": 2.0, "contact": None, "impact_m_s": None}))
    (flown_folder / "logs" / "vio.log").write_text("Traceback (most recent call last):\n")
    for path in (flown_folder / BAG).iterdir():
        path.write_bytes(b"")
    problems = ending.ending_of(FAULT, LANDED, flown_folder).problems
    assert len(problems) == 3, problems


def test_a_vehicle_that_slips_off_a_gate_after_its_motors_stopped_has_a_defined_ending(flown_folder):
    report = {"speed_m_s": 2.0, "contact": "hit gate 4 at 12.7 m/s after 9.45 s", "impact_m_s": 12.7, "disarmed_s": 9.6}
    (flown_folder / REPORT).write_text(json.dumps(report))
    assert not ending.ending_of(FAULT, LANDED, flown_folder).problems
    (flown_folder / REPORT).write_text(json.dumps(report | {"disarmed_s": None}))
    assert "moves at 2.0 m/s" in ending.ending_of(FAULT, LANDED, flown_folder).problems[0]


def test_motors_that_stop_at_once_are_safe_though_a_dead_line_says_it_late(flown_folder):
    """The link status says it 0.35 s after the crash; the firmware's failsafe stopped the motors after 0.2 s."""
    fault = catalogue.Fault(9, catalogue.REAL_TIME, catalogue.LOST_BYTES, catalogue.SERIAL, 1.0, 0.7, 0.7)
    late = Flown(2 * SECOND, LOST_RACE, LOST_RACE.stamp_ns + 350_000_000, ())
    report = {"speed_m_s": 0.0, "contact": "hit gate 4", "impact_m_s": 13.9, "crash_s": 9.6, "disarmed_s": 9.8}
    (flown_folder / REPORT).write_text(json.dumps(report))
    found = ending.ending_of(fault, late, flown_folder)
    assert (found.safe_s, found.problems) == (0.2, ())
    assert ending.ending_of(FAULT, late, flown_folder).safe_s == 0.35


def test_a_flight_must_go_on_without_what_it_does_not_need_and_despite_other_publishers(flown_folder):
    for fault in (HELPER, FOREIGN):
        assert len(ending.ending_of(fault, LANDED, flown_folder).problems) == 1
        finished = Flown(2 * SECOND, RaceEvent(9 * SECOND, FINISHED, 7, 1), None, ())
        found = ending.ending_of(fault, finished, flown_folder)
        assert (found.way, found.problems) == (ending.FINISHED_RACE, ())


def test_a_crash_is_named_by_what_was_hit(flown_folder):
    for contact, way in (("hit gate 3 at 9.0 m/s", ending.STRUCK), ("hit the ground at 9.0 m/s", ending.FELL)):
        (flown_folder / REPORT).write_text(json.dumps({"speed_m_s": 0.0, "contact": contact, "impact_m_s": 9.0}))
        assert ending.ending_of(FAULT, LANDED, flown_folder).way == way


def test_a_batch_continues_and_flies_a_race_again_that_ended_before_its_fault(
    flown_folder, tmp_path_factory, monkeypatch
):
    out, attempts = tmp_path_factory.mktemp("faults"), []

    def fly(fault, options):
        attempts.append(fault.seed)
        return LANDED if attempts.count(fault.seed) == 2 else Flown(None, LOST_RACE, SAFE_NS, ())

    def ending_of(fault, flown, folder):
        folder.mkdir(parents=True, exist_ok=True)
        return ending.ending_of(fault, flown, flown_folder)

    def refuse(fault, options):
        options.out.mkdir()
        raise UsageError("no track")

    monkeypatch.setattr(batch, "fly", fly)
    monkeypatch.setattr(batch, "ending_of", ending_of)
    chosen = batch.Batch(out, out, keep=False, progress=lambda line: None)
    one, two, three = [seed for seed in range(200) if catalogue.draw(seed).kind == "delay"][:3]
    first = batch.endings(chosen, [one, two])
    assert attempts == [one, one, two, two]
    assert batch.endings(chosen, [one, two, three])[:2] == first
    assert attempts == [one, one, two, two, three, three]
    text = tables.by_kind(first) + tables.by_target(first) + tables.totals(first)
    assert "2 draws" in text and "0 undefined" in text
    picture.draw(first, out / "faults.png")
    assert (out / "faults.png").stat().st_size > 10_000
    (chosen.folder(one) / batch.ENDING).write_text("{}")
    with pytest.raises(UsageError, match=r"delete it"):
        batch.endings(chosen, [one])
    monkeypatch.setattr(batch, "fly", refuse)
    (refused,) = batch.endings(chosen, [three + 1])
    assert refused.problems == ("a node refused its input: no track",)


@pytest.mark.slow
def test_draws_at_the_same_time_have_the_same_endings(flown_folder, tmp_path):
    one, two = batch.Batch(tmp_path, tmp_path, keep=False), batch.Batch(tmp_path, tmp_path, keep=False, jobs=2)
    for seed in (4, 2, 7):
        fault = catalogue.draw(seed)
        two.folder(seed).mkdir()
        found = dataclasses.asdict(ending.ending_of(fault, LANDED, flown_folder))
        (two.folder(seed) / batch.ENDING).write_text(json.dumps(found))
    assert [found.fault.seed for found in batch.endings(two, [4, 2, 7])] == [4, 2, 7]
    assert batch.endings(two, [4, 2, 7]) == batch.endings(one, [4, 2, 7])
    with pytest.raises(UsageError, match=r"needs as many processor cores"):
        batch.endings(dataclasses.replace(two, jobs=1 + os.cpu_count()), [4])
    (two.folder(2) / batch.ENDING).write_text("{}")
    with pytest.raises(UsageError, match=r"delete it"):
        batch.endings(two, [4, 2, 7])

"""Faults in mid-race: whoever dies or freezes, the drone is safe in time, the node is named, the bag survives."""

import enum
import json
import math
import os
import signal

import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from swift_ros.configuration import configuration_folder
from swift_ros.race.result import BAG, REPORT
from swift_ros.recording import bags
from swift_ros.recording.race_bag import read_record
from swift_sim_bridge.racing.race import RACERS, Flight, RaceOptions

SAFE_S, DISARMED_S = 0.3, 3.0
FIRMWARE_S = 0.8  # frames that were read, 0.5 s of failsafe delay, a few ticks


class Fault(enum.Enum):
    """How a process fails: it ends, or it stands still and keeps its sockets."""

    KILLED = signal.SIGKILL
    FROZEN = signal.SIGSTOP


VICTIMS = tuple(name for name in RACERS if name != "bridge")


@pytest.fixture(
    scope="module",
    params=[(name, fault) for name in VICTIMS for fault in Fault],
    ids=lambda case: f"{case[0]}-{case[1].name.lower()}",
)
def wreck(request, tmp_path_factory):
    """A race in which one node fails after gate 2: (victim, fault, flight, lines printed, stamp of the fault)."""
    victim, fault = request.param
    lines = []
    options = RaceOptions(configuration_folder(), tmp_path_factory.mktemp("race"), False, "local", lines.append)
    with Flight(1000, options) as flight:
        flight.follow(until=lambda: flight.listener.passages >= 2)
        assert flight.listener.end is None, lines
        failed_ns = flight.listener.link_ns
        os.kill(flight.nodes.process_id(victim), fault.value)
        flight.follow()
        flight.play_out()
    return victim, fault, flight, lines, failed_ns


def test_the_drone_is_safe_in_time(wreck):
    victim, _, flight, lines, failed_ns = wreck
    listener = flight.listener
    if victim == "betaflight":  # its link is gone with it: the firmware's own failsafe must end the flight
        report = json.loads((flight.options.out / REPORT).read_text())
        assert report["disarmed_s"] - 1e-9 * failed_ns <= FIRMWARE_S
        return
    assert listener.safe_ns is not None and listener.disarmed_ns is not None, lines
    assert 1e-9 * (listener.safe_ns - failed_ns) <= SAFE_S
    assert 1e-9 * (listener.disarmed_ns - failed_ns) <= DISARMED_S


def test_the_node_is_named(wreck):
    victim, fault, flight, lines, _ = wreck
    assert flight.listener.end.state == "lost"
    assert any(victim in line for line in lines)
    if victim != "race_monitor":
        assert victim in flight.listener.end.text


def test_the_bag_opens_everywhere_and_tells_of_the_race(wreck):
    victim, _, flight, _, failed_ns = wreck
    bag = flight.options.out / BAG
    with AnyReader([bag]) as reader:
        assert reader.message_count > 1000
    with open(bags.mcap_file(bag), "rb") as stream:
        assert sum(1 for _ in make_reader(stream).iter_messages()) > 1000
    record = read_record(bag)
    # the recorder itself fails in the very tick of the second passage, before that is on disk
    assert sum(event.is_passage for event in record.events) >= (1 if victim == "recorder" else 2)
    assert record.odometry["state/odometry"][-1].stamp_ns > failed_ns - 1e9
    assert all(math.isfinite(value) for value in record.odometry["ground_truth/odometry"][-1].p_world)

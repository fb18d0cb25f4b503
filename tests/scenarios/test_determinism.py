"""A race depends on its seed only: flown again on a busy machine, its messages are the same to the byte."""

import os
import subprocess
import sys

import pytest

from swift_ros import configuration
from swift_ros.graph.topic_table import full_name
from swift_ros.race.result import BAG
from swift_ros.recording import bags
from swift_ros.recording.race_bag import read_race
from swift_ros.track import Track
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.commands.race import chosen_files, configure
from swift_sim_bridge.racing.race import RaceOptions, fly

BUSY_LOOP = "while True: pass"
STREAMS = ("ground_truth/odometry", "state/odometry", "command/body_rate_thrust", "gates/poses", "battery")


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """Return the configuration folder of a race of one lap."""
    out = tmp_path_factory.mktemp("short")
    track = (configuration.configuration_folder() / "track.yaml").read_text()
    (out / "track.yaml").write_text(track.replace("laps: 3", "laps: 1"))
    return configure(out, chosen_files(None, track=out / "track.yaml"))


def fly_and_read(config, out, seed):
    """Fly one race; return its result and its messages up to the end, by topic."""
    fly(seed, RaceOptions(config, out, False, "local", print))
    track = configuration.load(Track, config / "track.yaml")
    result, record = read_race(out, track, configuration.load(Vehicle, config / "drone.yaml"))
    streams = {name: [] for name in STREAMS}
    for raw in bags.read_raw(out / BAG, [full_name(name) for name in STREAMS]):
        if raw.publish_time_ns <= record.end_ns:
            streams[raw.topic.split("/", 2)[2]].append(raw.data)
    return result, streams


def test_the_same_seed_gives_the_same_messages_on_a_busy_machine(short, tmp_path):
    calm, calm_streams = fly_and_read(short, tmp_path / "calm", 1003)
    processes = [subprocess.Popen([sys.executable, "-c", BUSY_LOOP]) for _ in range(2 * (os.cpu_count() or 1))]
    try:
        busy, busy_streams = fly_and_read(short, tmp_path / "busy", 1003)
    finally:
        for process in processes:
            process.kill()
            process.wait()
    other, _ = fly_and_read(short, tmp_path / "other", 1004)
    assert calm.finished, calm
    assert calm == busy
    for name in STREAMS:
        assert calm_streams[name] == busy_streams[name], name
        assert len(calm_streams[name]) > 50
    assert (other.msp_sha256, other.truth_sha256) != (calm.msp_sha256, calm.truth_sha256)

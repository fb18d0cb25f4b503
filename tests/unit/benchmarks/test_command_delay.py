"""The delay of commands in flight: a planted one is recovered from a bag, and its file is one of a training."""

import argparse

import numpy as np
import pytest
from rclpy.serialization import serialize_message

from swift_ros import configuration
from swift_ros.graph.topic_table import TOPICS, full_name
from swift_ros.messages.control import to_link
from swift_ros.recording.bag_writer import BagWriter
from swift_sim_bridge.benchmarks import command_delay, estimate_errors
from swift_sim_bridge.commands import evaluate
from swift_sim_bridge.pilot.episodes.randomization import EstimateErrors
from swift_sim_bridge.pilot.job import read_settings

TICK_NS = 10_000_000
LINK = {"frames_sent": 1, "frames_bad": 0, "round_trip_ms": 1.0, "armed": True, "modes": [], "arming_blocks": []}


def record(folder, delays_s):
    """Write the bag of a flight; each command has two frames, the second of which comes 4 ms later."""
    writer, name = BagWriter(folder), full_name("betaflight/link")
    writer.add_topic(name, TOPICS["betaflight/link"].type)
    writer.write(name, serialize_message(to_link(5, 0, failsafe=False, **LINK)), 5)  # before the first command
    for i, delay_s in enumerate(delays_s, start=1):
        for late_s in (delay_s, delay_s + 0.004):
            at_ns = i * TICK_NS + round(1e9 * late_s)
            writer.write(name, serialize_message(to_link(at_ns, i * TICK_NS, failsafe=False, **LINK)), at_ns)
    writer.close()
    return folder


@pytest.fixture
def flight(tmp_path):
    """The bag of a flight: delays of 2 to 6 ms, and 1 % of 50 ms, in which the computer was busy."""
    delays = np.random.default_rng(3).uniform(0.002, 0.006, 1000)
    delays[::100] = 0.05
    return record(tmp_path / "real", delays)


def test_the_delay_is_recovered_and_a_busy_computer_does_not_count(flight, tmp_path):
    assert command_delay.measure([flight]) == pytest.approx(0.0058, abs=2e-4)
    assert command_delay.measure([flight, record(tmp_path / "slow", np.full(2000, 0.012))]) == 0.012


def test_lockstep_shows_no_delay(tmp_path):
    assert command_delay.measure([record(tmp_path / "lockstep", np.zeros(100))]) is None


def test_what_is_printed_is_a_settings_file(flight, tmp_path, monkeypatch, capsys):
    errors = EstimateErrors(0.02, 0.5, 0.04, 0.3, 0.003, 0.2, 0.003, 0.2)
    monkeypatch.setattr(estimate_errors, "measure", lambda _: errors)
    monkeypatch.setattr(evaluate, "_bags", lambda folder: [folder])
    assert evaluate.run_estimate(argparse.Namespace(races=[flight])) == 0
    (file := tmp_path / "measured.yaml").write_text(capsys.readouterr().out)
    settings = read_settings(configuration.configuration_folder(), file)
    assert settings.estimate_errors == errors
    assert settings.environment.command_delay_s == command_delay.measure([flight])

"""The comparison with the real firmware: its inputs, the delays of its frames, and the firmware itself if present."""

import os
import struct
from dataclasses import replace

import numpy as np
import pytest

from swift_ros.errors import UsageError
from swift_ros.recording.flight_table import FlightTable, Samples
from swift_sim_bridge.benchmarks import against_firmware, firmware_runs, firmware_sequences
from swift_sim_bridge.benchmarks.against_firmware import Difference
from swift_sim_bridge.benchmarks.firmware_runs import FirmwareRun
from swift_sim_bridge.benchmarks.firmware_sequences import FRAME_PASSES, Sequence
from swift_sim_bridge.flight_controller.sitl.replay import FrameTimes

SITL = os.environ.get("SWIFT_SITL")


def beginning(name, frames):
    """Return the first frames of a sequence."""
    whole = firmware_sequences.sequences(seed=0)[name]
    return {name: Sequence(whole.frames_us[:frames], whole.gyro_omega_body[: frames * FRAME_PASSES])}


def run_with(delays):
    """Return a run without motors that took the frames of a sequence so many passes late."""
    late = np.concatenate([np.zeros(firmware_runs.SETTLED_FRAMES), delays])
    return FirmwareRun({}, (FRAME_PASSES + np.diff(late, prepend=0)) / 8000)


def test_the_delay_of_each_frame_is_found_from_the_motors():
    fed, paced = beginning("multisine", 12), run_with(np.full(12, 7))
    late, _ = against_firmware.simulated_motors("plain", fed, paced, delay=7)
    motors, delays = against_firmware.simulated_motors("plain", fed, replace(paced, motors=late))
    assert set(delays) == {7} and np.array_equal(motors["multisine"], late["multisine"])
    early, _ = against_firmware.simulated_motors("plain", fed, paced, delay=3)
    assert np.sqrt(np.mean((early["multisine"] - late["multisine"]) ** 2)) > 0.01


@pytest.mark.slow
def test_delays_that_change_the_feed_forward_are_found_too():
    # Like a serial task that drifts relative to the frames.
    planted = np.array([1, 9, 1, 2, 9, 9, 1, 34, 2, 2, 3, 3, 11, 3, 3, 3])
    fed, paced = beginning("multisine", len(planted)), run_with(planted)
    known, _ = against_firmware.simulated_motors("default", fed, paced, delay=planted)
    motors, delays = against_firmware.simulated_motors("default", fed, replace(paced, motors=known))
    assert list(delays) == list(planted) and np.array_equal(motors["multisine"], known["multisine"])
    steady, _ = against_firmware.simulated_motors("default", fed, run_with(np.zeros(len(planted))), delay=planted)
    assert np.sqrt(np.mean((steady["multisine"] - known["multisine"]) ** 2)) > 0.005


class FakeFirmware:
    """Reports intervals_us, each one pass after its request; it never answers the last `lost` requests."""

    def __init__(self, intervals_us, lost=0):
        self._left, self._asked, self._answers, self._lost = list(intervals_us), 0, [], lost

    def send(self, code):
        self._asked += 1

    def step(self, *_):
        while self._asked > self._lost and self._left:
            self._asked -= 1
            self._answers.append(struct.pack("<4H", self._left.pop(0) // 10, 0, 0, 0))

    def answers(self, code):
        answers, self._answers = self._answers, []
        return answers


def test_frame_intervals_are_read_from_the_firmware(monkeypatch):
    watch = FrameTimes(FakeFirmware([10004, 8875, 9999]))
    for _ in range(3):
        watch.ask()
    assert watch.intervals_s() == pytest.approx([0.010005, 0.008875, 0.009995])
    monkeypatch.setattr("swift_sim_bridge.flight_controller.sitl.replay.ARM_TIMEOUT_S", 0.01)
    watch = FrameTimes(FakeFirmware([10004, 10004], lost=1))
    watch.ask(), watch.ask()
    with pytest.raises(UsageError, match="time of 1 of 2 frames"):
        watch.intervals_s()


def test_sequences_depend_on_the_seed_only_and_stay_within_the_stick_range():
    first, again = firmware_sequences.sequences(seed=1), firmware_sequences.sequences(seed=1)
    for name, sequence in first.items():
        assert np.array_equal(sequence.gyro_omega_body, again[name].gyro_omega_body)
        assert sequence.frames_us.min() >= 1000 and sequence.frames_us.max() <= 2000
        assert len(sequence.gyro_omega_body) == FRAME_PASSES * len(sequence.frames_us)
    assert set(first["saturation"].frames_us[:, 2]) == {1000, 2000}


def test_a_recorded_race_gives_sticks_from_its_commands_and_its_gyro():
    t = np.arange(0.0, 5.0, 0.01)
    turning = np.stack([t - 2.0, 2.0 - t, 0 * t], axis=-1)
    asked = np.where(t > 1.995, 40.0, 0.0)  # it waits for the start until then
    channels = {
        "omega_command_body": Samples(t, turning),
        "thrust_command": Samples(t, asked),
        "gyro_body": Samples(t, 0.5 * turning),
    }
    sequence = firmware_sequences.recorded(FlightTable("a race", channels), 10.0, start_s=1.0, seconds=1.5)
    assert len(sequence.frames_us) == 150 and list(sequence.frames_us[50]) == [1575, 1425, 2000, 1500, 2000]
    assert sequence.gyro_omega_body[4040, 0] == pytest.approx(0.5 * 1.505, abs=1e-6)
    waits = FlightTable("a wait", channels | {"thrust_command": Samples(t, 0.0 * t)})
    with pytest.raises(UsageError, match="a wait never commands thrust"):
        firmware_sequences.recorded(waits, 10.0, 1.0, 1.0)
    with pytest.raises(UsageError, match="lacks cmd_wx"):
        firmware_sequences.recorded(FlightTable("a race", {"gyro_body": channels["gyro_body"]}), 10.0, 1.0, 1.0)


def test_the_largest_difference_is_named():
    rows = [Difference("default", "rest", 0.0, 0.001, 0.001), Difference("plain", "steps", 0.004, 0.008, 0.03)]
    text = "worst difference: plain, steps: 0.800 %; all within 0.5 % above run to run"
    assert against_firmware.table(rows).endswith(text)
    rows.append(Difference("plain", "multisine", 0.001, 0.0071, 0.01))
    assert "beyond, in plain, multisine, 0.5 %" in against_firmware.table(rows)


def test_saved_runs_are_reused_and_a_failed_run_is_repeated(tmp_path, monkeypatch):
    sequences, calls, lines = beginning("steps", 2), [], []
    binary = tmp_path / "firmware"
    binary.touch(mode=0o755)

    def run(*_):
        calls.append(len(calls))
        if len(calls) == 2:
            raise UsageError("no sticks")
        return FirmwareRun({"steps": np.full((2 * FRAME_PASSES, 4), 0.1 * len(calls))}, np.full(152, 0.01 * len(calls)))

    monkeypatch.setattr(firmware_runs, "run_firmware", run)
    first = firmware_runs.firmware_runs(binary, "plain", sequences, 2, tmp_path / "runs", lines.append)
    assert [saved.motors["steps"][0, 0] for saved in first] == pytest.approx([0.1, 0.3])
    assert lines == [
        "plain: run 1 of 2 is done: 100.0 frames a second by the firmware's clock",
        "plain: run 2 of 2 failed, try 1 of 5: no sticks",
        "plain: run 2 of 2 is done: 33.3 frames a second by the firmware's clock",
    ]
    again = firmware_runs.firmware_runs(binary, "plain", sequences, 3, tmp_path / "runs", lines.append)
    assert len(calls) == 4 and np.array_equal(again[1].intervals_s, first[1].intervals_s)
    assert np.array_equal(again[1].motors["steps"], first[1].motors["steps"])
    firmware_runs.firmware_runs(binary, "default", sequences, 1, tmp_path / "runs", lines.append)
    assert len(calls) == 5  # another set-up is another run
    monkeypatch.setattr(firmware_runs, "run_firmware", lambda *_: (_ for _ in ()).throw(UsageError("no start")))
    with pytest.raises(UsageError, match="no start"):
        firmware_runs.firmware_runs(binary, "default", sequences, 2, tmp_path / "runs", lines.append)


@pytest.mark.skipif(not SITL, reason="needs a binary of Betaflight SITL with gyro sync: SWIFT_SITL=PATH")
def test_motor_commands_are_those_of_the_real_firmware(tmp_path):
    sequences = beginning("rest", 20) | beginning("steps", 50)
    runs = firmware_runs.firmware_runs(SITL, "plain", sequences, 1, tmp_path, print)
    rows = against_firmware.compare(runs, "plain", sequences, print)
    assert max(row.excess for row in rows) < against_firmware.LIMIT

"""The comparison with the real firmware: what is fed, how its frames are found in time, and the real one if here."""

import os
import struct
from dataclasses import replace

import numpy as np
import pytest

from swift_ros.errors import UsageError
from swift_ros.recording.flight_table import FlightTable, Samples
from swift_sim_bridge.benchmarks import against_firmware, firmware_lives, firmware_sequences
from swift_sim_bridge.benchmarks.against_firmware import Difference
from swift_sim_bridge.benchmarks.firmware_lives import Life
from swift_sim_bridge.benchmarks.firmware_sequences import FRAME_PASSES, Sequence
from swift_sim_bridge.flight_controller.sitl.replay import FrameTimes

SITL = os.environ.get("SWIFT_SITL")


def begun(name, frames):
    whole = firmware_sequences.sequences(seed=0)[name]
    return {name: Sequence(whole.frames_us[:frames], whole.gyro_omega_body[: frames * FRAME_PASSES])}


def life_of(delays):
    """Return a life without motors, whose frames of a sequence were taken so many passes late."""
    late = np.concatenate([np.zeros(firmware_lives.SETTLED_FRAMES), delays])
    return Life({}, (FRAME_PASSES + np.diff(late, prepend=0)) / 8000)


def test_the_pass_in_which_a_frame_took_effect_is_found_in_the_motors():
    fed, paced = begun("multisine", 12), life_of(np.full(12, 7))
    late, _ = against_firmware.simulated_motors("plain", fed, paced, delay=7)
    motors, delays = against_firmware.simulated_motors("plain", fed, replace(paced, motors=late))
    assert set(delays) == {7} and np.array_equal(motors["multisine"], late["multisine"])
    early, _ = against_firmware.simulated_motors("plain", fed, paced, delay=3)
    assert np.sqrt(np.mean((early["multisine"] - late["multisine"]) ** 2)) > 0.01


def test_a_frame_that_is_taken_late_changes_the_feed_forward_and_is_found_too():
    told = np.array([1, 9, 1, 2, 9, 9, 1, 34, 2, 2, 3, 3, 11, 3, 3, 3])  # as a serial task drifts across the frames
    fed, paced = begun("multisine", len(told)), life_of(told)
    known, _ = against_firmware.simulated_motors("default", fed, paced, delay=told)
    motors, delays = against_firmware.simulated_motors("default", fed, replace(paced, motors=known))
    assert list(delays) == list(told) and np.array_equal(motors["multisine"], known["multisine"])
    steady, _ = against_firmware.simulated_motors("default", fed, life_of(np.zeros(len(told))), delay=told)
    assert np.sqrt(np.mean((steady["multisine"] - known["multisine"]) ** 2)) > 0.005


class Telling:
    """Tells intervals_us, each a pass after it was asked for; `lost` questions it never answers."""

    def __init__(self, intervals_us, lost=0):
        self._left, self._asked, self._answers, self._lost = list(intervals_us), 0, [], lost

    def send(self, code):
        self._asked += 1

    def step(self, *_):
        while self._asked > self._lost and self._left:
            self._asked -= 1
            self._answers.append(struct.pack("<4H", self._left.pop(0) // 10, 0, 0, 0))

    def heard(self, code):
        answers, self._answers = self._answers, []
        return answers


def test_the_firmware_tells_the_time_between_its_frames(monkeypatch):
    watch = FrameTimes(Telling([10004, 8875, 9999]))
    for _ in range(3):
        watch.ask()
    assert watch.intervals_s() == pytest.approx([0.010005, 0.008875, 0.009995])
    monkeypatch.setattr("swift_sim_bridge.flight_controller.sitl.replay.ARM_PATIENCE_S", 0.01)
    watch = FrameTimes(Telling([10004, 10004], lost=1))
    watch.ask(), watch.ask()
    with pytest.raises(UsageError, match="time of 1 of 2 frames"):
        watch.intervals_s()


def test_sequences_are_the_same_for_a_seed_and_stay_within_the_sticks():
    first, again = firmware_sequences.sequences(seed=1), firmware_sequences.sequences(seed=1)
    for name, one in first.items():
        assert np.array_equal(one.gyro_omega_body, again[name].gyro_omega_body)
        assert one.frames_us.min() >= 1000 and one.frames_us.max() <= 2000
        assert len(one.gyro_omega_body) == FRAME_PASSES * len(one.frames_us)
    assert set(first["saturation"].frames_us[:, 2]) == {1000, 2000}


def test_a_recorded_race_is_fed_by_its_commands_and_gyro():
    t = np.arange(0.0, 5.0, 0.01)
    turning = np.stack([t - 2.0, 2.0 - t, 0 * t], axis=-1)
    asked = np.where(t > 1.995, 40.0, 0.0)  # it waits for the start until then
    channels = {
        "omega_command_body": Samples(t, turning),
        "thrust_command": Samples(t, asked),
        "gyro_body": Samples(t, 0.5 * turning),
    }
    one = firmware_sequences.recorded(FlightTable("a race", channels), 10.0, start_s=1.0, seconds=1.5)
    assert len(one.frames_us) == 150 and list(one.frames_us[50]) == [1575, 1425, 2000, 1500, 2000]
    assert one.gyro_omega_body[4040, 0] == pytest.approx(0.5 * 1.505, abs=1e-6)
    waits = FlightTable("a wait", channels | {"thrust_command": Samples(t, 0.0 * t)})
    with pytest.raises(UsageError, match="a wait never asks for thrust"):
        firmware_sequences.recorded(waits, 10.0, 1.0, 1.0)
    with pytest.raises(UsageError, match="lacks cmd_wx"):
        firmware_sequences.recorded(FlightTable("a race", {"gyro_body": channels["gyro_body"]}), 10.0, 1.0, 1.0)


def test_the_worst_case_is_named():
    rows = [Difference("default", "rest", 0.0, 0.001, 0.001), Difference("plain", "steps", 0.004, 0.008, 0.03)]
    told = "worst difference: plain, steps: 0.800 %; all within 0.5 % above run to run"
    assert against_firmware.table(rows).endswith(told)
    rows.append(Difference("plain", "multisine", 0.001, 0.0071, 0.01))
    assert "beyond, in plain, multisine, 0.5 %" in against_firmware.table(rows)


def test_a_comparison_goes_on_where_it_stopped_and_a_failed_life_is_lived_again(tmp_path, monkeypatch):
    fed, lived, told = begun("steps", 2), [], []
    binary = tmp_path / "firmware"
    binary.touch(mode=0o755)

    def life(*_):
        lived.append(len(lived))
        if len(lived) == 2:
            raise UsageError("it starved")
        return Life({"steps": np.full((2 * FRAME_PASSES, 4), 0.1 * len(lived))}, np.full(152, 0.01 * len(lived)))

    monkeypatch.setattr(firmware_lives, "live", life)
    first = firmware_lives.lives(binary, "plain", fed, 2, tmp_path / "lives", told.append)
    assert [one.motors["steps"][0, 0] for one in first] == pytest.approx([0.1, 0.3])
    assert told == [
        "plain: life 1 of 2 is over, with 100.0 frames a second by its own clock",
        "plain: life 2 of 2 failed, try 1 of 5: it starved",
        "plain: life 2 of 2 is over, with 33.3 frames a second by its own clock",
    ]
    again = firmware_lives.lives(binary, "plain", fed, 3, tmp_path / "lives", told.append)
    assert len(lived) == 4 and np.array_equal(again[1].intervals_s, first[1].intervals_s)
    assert np.array_equal(again[1].motors["steps"], first[1].motors["steps"])
    firmware_lives.lives(binary, "default", fed, 1, tmp_path / "lives", told.append)
    assert len(lived) == 5  # another set-up is another life
    monkeypatch.setattr(firmware_lives, "live", lambda *_: (_ for _ in ()).throw(UsageError("it is dead")))
    with pytest.raises(UsageError, match="it is dead"):
        firmware_lives.lives(binary, "default", fed, 2, tmp_path / "lives", told.append)


@pytest.mark.skipif(not SITL, reason="needs a binary of Betaflight SITL with gyro sync: SWIFT_SITL=PATH")
def test_motor_commands_are_the_real_firmwares(tmp_path):
    fed = begun("rest", 20) | begun("steps", 50)
    rows = against_firmware.compare(firmware_lives.lives(SITL, "plain", fed, 1, tmp_path, print), "plain", fed, print)
    assert max(row.excess for row in rows) < against_firmware.LIMIT

"""Races with the real firmware, if $SWIFT_SITL names a binary built with gyro sync."""

import os
import signal
from pathlib import Path

import numpy as np
import pytest

from swift_ros import configuration
from swift_ros.configuration import configuration_folder
from swift_ros.errors import UsageError
from swift_ros.recording.race_bag import read_race
from swift_ros.track import Track
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.racing.race import Flight, RaceOptions, fly

SEED = 1000
LAP_SHARE = 0.02  # accepted relative difference of times


def options(out, sitl=""):
    return RaceOptions(configuration_folder(), out, False, "local", print, sitl)


def fly_and_read(out, sitl=""):
    try:
        fly(SEED, options(out, sitl))
    except UsageError as error:
        if "by the wall clock" in str(error):
            pytest.skip("needs a binary with gyro sync, the firmware's option SIMULATOR_GYROPID_SYNC")
        raise
    folder = configuration_folder()
    track = configuration.load(Track, folder / "track.yaml")
    return read_race(out, track, configuration.load(Vehicle, folder / "drone.yaml"))[0]


def test_the_pilot_is_as_fast_with_the_real_firmware_as_with_the_simulated_one(sitl_binary, tmp_path):
    real, simulated = fly_and_read(tmp_path / "real", sitl_binary), fly_and_read(tmp_path / "simulated")
    assert real.finished, real
    assert simulated.finished, simulated
    assert real.time_s == pytest.approx(simulated.time_s, rel=LAP_SHARE)
    assert np.median(real.laps_s) == pytest.approx(np.median(simulated.laps_s), rel=LAP_SHARE)


def test_a_firmware_that_dies_is_reported_in_one_sentence(sitl_binary, tmp_path):
    sentence = "killed by SIGKILL|by the wall clock"
    with Flight(SEED, options(tmp_path, sitl_binary)) as flight, pytest.raises(UsageError, match=sentence) as error:
        flight.follow(until=lambda: flight.listener.link_ns > 0)
        os.kill(child_of(flight.nodes.process_id("bridge")), signal.SIGKILL)
        flight.follow()
    if "by the wall clock" in str(error.value):
        pytest.skip("needs a binary with gyro sync, the firmware's option SIMULATOR_GYROPID_SYNC")


def child_of(process_id: int) -> int:
    """Return the only child of a process."""
    (children,) = (path.read_text() for path in Path(f"/proc/{process_id}/task").glob(f"{process_id}/children"))
    (child,) = children.split()
    return int(child)

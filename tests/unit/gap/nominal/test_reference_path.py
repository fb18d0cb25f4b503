"""The path of reference flights is as smooth as the vehicle's between the rows of a recording, too."""

import numpy as np
import pytest

from swift_ros.configuration import configuration_folder, load
from swift_ros.recording.flight_table import FlightTable, Samples
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.nominal.reference_flights import reference_path
from swift_sim_bridge.gap.recording.recording import read_recording

STEP_S = 0.002


@pytest.mark.parametrize("row_s", [0.002, 0.008, 0.02])
def test_accelerations_of_reference_flights_have_no_jerks_at_the_rows(row_s):
    """Straight lines between rows of 8 ms had accelerations of four times the right one, and of none in between.

    Commands that follow them stop at full throttle and at none, and lift less on average.
    """
    t = np.arange(0.0, 12.0, row_s)
    p = np.array([4.0, 3.0, 0.5]) * np.sin(np.array([1.3, 1.7, 2.1]) * t[:, None])
    channels = {
        "p_world": Samples(t, p + [0.0, 0.0, 3.0]),
        "q_world_body": Samples(t, np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1))),
        "motor_command": Samples(t, np.full((len(t), 4), 0.5)),
    }
    vehicle = load(Vehicle, configuration_folder() / "drone.yaml")
    recording = read_recording(FlightTable("flight", channels), vehicle, simulated=True)
    path = reference_path(recording, STEP_S, 1, 0)
    jerk = np.diff(path.a_world[:, 0], axis=0)[5:-5] / STEP_S
    assert np.max(np.abs(jerk)) < 100.0  # m/s^3; the sines have 15, the deviation from them 40

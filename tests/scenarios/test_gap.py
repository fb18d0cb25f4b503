"""A race is diagnosed from its bag: the gap tool finds hidden effects and the errors of the simulated sensors."""

import numpy as np
import pytest
import yaml

from swift_ros import configuration
from swift_ros.race.result import BAG
from swift_ros.recording import flight_files
from swift_ros.vehicle import Vehicle
from swift_sim_bridge import seeds
from swift_sim_bridge.commands.race import chosen_files, configure
from swift_sim_bridge.gap.api import diagnose
from swift_sim_bridge.racing.race import RaceOptions, fly

FILE = configuration.configuration_folder() / "drone.yaml"
SEED = 1005
# effects of the simulated race that no vehicle file has: sensor biases drawn for the flight, inertial sensors half a
# step older than the pose, and 2 % of inertia because rotor speeds are recorded at 100 Hz only
SIMULATED = {"accel_bias", "gyro_bias", "time_offset", "processing_latency", "inertia"}


def diagnosed(tmp_path, pilot=None, **terms) -> dict:
    """Fly a race of the file's vehicle with other terms, and return the report of its bag against the file."""
    content = configuration.read_yaml(FILE)
    content["terms"] |= terms
    (tmp_path / "flown.yaml").write_text(yaml.safe_dump(content))
    config = configure(tmp_path, chosen_files(None, vehicle=tmp_path / "flown.yaml", pilot=pilot))
    fly(SEED, RaceOptions(config, tmp_path / "race", False, "local", print))
    bag = flight_files.read(tmp_path / "race" / BAG)
    return diagnose([bag], configuration.load(Vehicle, FILE), print, validate=False).report


def estimate(report: dict, effect: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the estimated parameters of an effect and their half intervals."""
    (finding,) = (one for one in report["findings"] if one["effect"] == effect)
    values = np.array([one["value"] for one in finding["parameters"].values()])
    return values, np.array([one["interval95"][1] for one in finding["parameters"].values()]) - values


def test_a_race_of_the_vehicle_file_shows_only_the_errors_of_the_simulated_sensors(tmp_path):
    report = diagnosed(tmp_path)
    names = {one["effect"] for one in report["findings"]}
    assert "accel_bias" in names and names <= SIMULATED
    drawn, rng = configuration.read_yaml(FILE.with_name("simulation.yaml"))["imu"], seeds.generator(SEED, "imu")
    for effect in ("gyro_bias", "accel_bias"):
        bias = drawn[effect] * rng.standard_normal(3)
        if effect in names:
            values, half = estimate(report, effect)
            assert np.all(np.abs(values - bias) < 2.0 * half), (effect, values, bias)
    assert "some of a faster loop's" in report["not_testable"]["motor_time_constant"]


def test_drag_and_a_centre_of_mass_offset_are_identified_from_a_race(tmp_path):
    hidden = {"body_drag": {"c": [0.008, 0.008, 0.016]}, "com_offset": {"position": [0.003, -0.002, 0.0]}}
    robust = FILE.parent / "pilots" / "split_s_robust.onnx"  # the default pilot hits gate 4 with these two
    report = diagnosed(tmp_path, robust, **hidden)
    assert {one["effect"] for one in report["findings"]} - SIMULATED == {"body_drag", "com_offset"}
    assert estimate(report, "body_drag")[0] == pytest.approx(hidden["body_drag"]["c"], rel=0.1)
    assert estimate(report, "com_offset")[0][:2] == pytest.approx(hidden["com_offset"]["position"][:2], rel=0.1)

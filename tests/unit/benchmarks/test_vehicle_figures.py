"""The operating points of the vehicle: hover and full throttle."""

import pytest

from swift_ros import configuration
from swift_ros.errors import UsageError
from swift_ros.graph.topic_table import TOPICS, full_name
from swift_ros.recording.bag_writer import BagWriter
from swift_ros.vehicle import GRAVITY, Vehicle
from swift_sim_bridge.benchmarks import vehicle_figures


@pytest.fixture(scope="module")
def vehicle():
    return configuration.load(Vehicle, configuration.configuration_folder() / "drone.yaml")


def test_in_hover_the_thrust_is_the_weight_and_the_power_that_of_the_rotors(vehicle):
    at = vehicle_figures.hover(vehicle)
    assert at.thrust == pytest.approx(vehicle.mass * GRAVITY, rel=1e-6)
    mechanical = 4 * vehicle.torque_coefficient * at.rotor_speed**3
    assert at.power == pytest.approx(mechanical / vehicle.battery.efficiency + vehicle.battery.avionics_w, rel=1e-6)


def test_full_throttle_gives_the_paper_s_35_n_at_the_reference_voltage(vehicle):
    full = vehicle_figures.at_command(vehicle, 1.0)
    assert full.thrust == pytest.approx(35.0, rel=0.01)
    assert full.voltage == pytest.approx(vehicle.battery.reference_voltage, abs=0.05)


def test_a_bag_without_a_flown_race_is_refused(vehicle, tmp_path):
    writer = BagWriter(tmp_path / "bag")
    for name in (vehicle_figures.ROTORS, vehicle_figures.PACK, "race/status", "ground_truth/odometry"):
        writer.add_topic(full_name(name), TOPICS[name].type)
    writer.close()
    with pytest.raises(UsageError, match="holds no race from start to end"):
        vehicle_figures.race_means(tmp_path / "bag", vehicle)

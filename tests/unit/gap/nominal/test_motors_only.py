"""A flight controller's own log without a pose: errors of motors and battery are identified, and no others.

The logs come from a second, plain implementation of motors and battery. Rotor speeds that were not recorded are
modelled as far as the vehicle file allows.
"""

from dataclasses import replace

import jax
import numpy as np
import pytest
from motor_log import SHIPPED, VEHICLE, T, log

from swift_ros.recording.flight_table import FlightTable, Samples
from swift_sim_bridge.gap import api
from swift_sim_bridge.gap.nominal import motors_only, rotor_speed_model
from swift_sim_bridge.gap.pipeline import references
from swift_sim_bridge.gap.recording.recording import read_recording
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel


def test_a_log_of_the_vehicle_of_the_file_gives_no_finding(monkeypatch):
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", 12)
    found = api.diagnose([log(1)], VEHICLE, lambda text: None).report
    assert found["verdict"] == "cannot_tell" and "rotor_drag" in found["not_testable"]


def test_slow_motors_and_a_worn_battery_are_identified_with_their_sizes(monkeypatch):
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", 12)
    found = api.diagnose([log(2, lag_s=0.040, resistance=0.03)], VEHICLE, lambda text: None).report
    sizes = {one["effect"]: one["parameters"] for one in found["findings"]}
    assert set(sizes) == {"motor_time_constant", "battery_sag"}
    assert sizes["motor_time_constant"]["time_constant_up"]["value"] == pytest.approx(0.040, rel=0.02)
    assert sizes["battery_sag"]["resistance"]["value"] == pytest.approx(0.03, rel=0.05)
    shown = found["improvement"]["held_out"]["one_step_rmse_by_channel"]
    assert found["channels"]["voltage"]["unit"] == "V"
    assert shown["voltage"]["after"] < 0.3 * shown["voltage"]["before"]
    assert all(shown[f"rotor_speed_{i}"]["after"] < 0.8 * shown[f"rotor_speed_{i}"]["before"] for i in (1, 2, 3, 4))


def without(table: FlightTable, *names: str) -> FlightTable:
    return replace(table, channels={name: rows for name, rows in table.channels.items() if name not in names})


@pytest.mark.parametrize("missing", ["motor_command", "rotor_speed"])
def test_without_motor_commands_or_rotor_speeds_the_battery_alone_is_simulated(missing):
    worn = without(log(4, resistance=0.03), missing)
    recording = read_recording(rotor_speed_model.with_modelled_rotor_speeds(worn, VEHICLE), VEHICLE)
    with jax.enable_x64(True):
        found = motors_only.reference_tables(worn, recording, VEHICLE, 3, seed=0)
    for one in found:
        assert set(one.channels) == set(worn.channels)
        assert np.std(one["voltage"].values) < 0.6 * np.std(worn["voltage"].values)  # it has the resistance of the file
    first, second = (one["voltage"].values for one in found[:2])
    assert np.std(first - second) > 0.02  # each has its own commands


def test_the_rotor_speeds_of_a_bag_without_a_pose_load_the_battery_and_its_incomplete_commands_do_not():
    bag = replace(log(4), skips_commands=True)
    recording = read_recording(rotor_speed_model.with_modelled_rotor_speeds(bag, VEHICLE), VEHICLE)
    with jax.enable_x64(True):
        found = motors_only.reference_tables(bag, recording, VEHICLE, 2, seed=0)
    read = read_recording(rotor_speed_model.with_modelled_rotor_speeds(found[0], VEHICLE), VEHICLE)
    assert recording.motor_record is None and read.motor_record is None and read.has("voltage", "rotor_speed")


@pytest.mark.parametrize("missing", ["motor_command", "rotor_speed"])
def test_a_worn_battery_is_identified_without_motor_commands_or_rotor_speeds(missing, monkeypatch):
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", 12)
    found = api.diagnose([without(log(6, resistance=0.03), missing)], VEHICLE, lambda text: None, validate=False)
    (finding,) = found.report["findings"]
    assert finding["effect"] == "battery_sag"
    assert finding["parameters"]["resistance"]["value"] == pytest.approx(0.03, rel=0.05)
    nominal = api.diagnose([without(log(7), missing)], VEHICLE, lambda text: None, validate=False).report
    assert nominal["verdict"] == "cannot_tell"
    assert 1e-4 < nominal["minimum_detectable"]["battery_sag"]["resistance"] < 0.01


def test_residuals_of_rotor_speeds_are_zero_while_commands_or_voltage_are_missing():
    whole, rms = log(3), {}
    for name, begin, end in (("motor_command", 6.0, 8.0), ("voltage", 9.0, 99.0), ("whole", 0.0, 0.0)):
        channels = dict(whole.channels)
        if name in channels:
            t, values = channels[name].t, channels[name].values
            kept = (t < begin) | (t > end)
            channels[name] = Samples(t[kept], values[kept])
        residual_model = ResidualModel(read_recording(replace(whole, channels=channels), VEHICLE))
        rotors = residual_model.residual(VEHICLE)[residual_model.good][:, residual_model.columns["rotors"]]
        rms[name] = np.sqrt(np.mean(np.square(rotors)))
        zero_share = np.all(rotors == 0.0, axis=1).mean()
        assert zero_share > 0.1 if name in channels else zero_share == 0.0
    assert rms["motor_command"] < 1.1 * rms["whole"] and rms["voltage"] < 1.1 * rms["whole"]


def test_modelled_rotor_speeds_are_the_common_speed_of_the_files_motors():
    whole = log(3)
    filled = rotor_speed_model.with_modelled_rotor_speeds(without(whole, "rotor_speed"), VEHICLE)
    common = np.sqrt(np.mean(whole["rotor_speed"].values ** 2, axis=1))
    late = T > 0.5  # the first speed is not known
    assert filled["rotor_speed"].values[late, 2] == pytest.approx(common[late], rel=0.01)
    recording = read_recording(filled, VEHICLE)
    assert recording.has("rotor_speed") and not recording.has("single_rotor_speeds") and recording.motor_record is None
    assert rotor_speed_model.with_modelled_rotor_speeds(whole, VEHICLE) is whole


def test_a_battery_with_two_branches_is_the_same_in_reference_flights_and_residuals():
    shipped = replace(SHIPPED, sensors={"vbat_v": 0.001, "ibat_a": 0.05})
    one_branch = replace(shipped, battery=VEHICLE.battery)

    def error_of(vehicle):
        volts = [channel.name for channel in residual_model.channels].index("voltage")
        error = residual_model.residual(vehicle)[residual_model.good, volts]
        half_a_second = round(0.5 / (residual_model.t[1] - residual_model.t[0]))  # the slow branch is still settling
        return (error[half_a_second:] - error[:-half_a_second]).std()

    with jax.enable_x64(True):
        table = log(3)
        reference = motors_only.reference_tables(table, read_recording(table, shipped), shipped, 1, 0)[0]
        residual_model = ResidualModel(read_recording(reference, shipped))
        assert error_of(shipped) < 0.7 * error_of(one_branch)

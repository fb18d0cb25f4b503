"""The repaired vehicle file: it loads, and has the estimated values, whatever the file had before."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from swift_ros.configuration import configuration_folder, load
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.attribution.evidence import SelectedEffect
from swift_sim_bridge.gap.discovery.polynomial_search import Found, equation_effects
from swift_sim_bridge.gap.effects.catalogue import catalogue
from swift_sim_bridge.gap.effects.injection import inject
from swift_sim_bridge.gap.report import repaired_files
from swift_sim_bridge.physics.state import parameters_from_vehicle
from swift_sim_bridge.physics.terms import motion, registry
from swift_sim_bridge.simulation import checks

SOURCE = configuration_folder() / "drone.yaml"
VEHICLE = load(Vehicle, SOURCE)
EFFECTS = {effect.key: effect for effect in catalogue(VEHICLE)}


def repaired(tmp_path, content: dict, **found) -> Vehicle:
    """Write the repaired file of a diagnosis that found these values by key, and load it."""
    vehicle, selected = replace(VEHICLE, terms=content["terms"]), []
    for key, values in found.items():
        vehicle = inject(vehicle, EFFECTS[key], values)
        selected.append(SelectedEffect(EFFECTS[key], np.array(values), 1e-6 * np.eye(len(values)), 9.0))
    path = tmp_path / "vehicle.yaml"
    path.write_text(repaired_files.vehicle_text(content, SimpleNamespace(selected=selected, vehicle=vehicle), SOURCE))
    return load(Vehicle, path)


def content(**terms) -> dict:
    found = yaml.safe_load(SOURCE.read_text())
    return found | {"terms": found["terms"] | terms}


def test_command_latency_and_jitter_are_written_to_one_entry_of_the_file(tmp_path):
    vehicle = repaired(tmp_path, content(), command_latency=[0.012], command_jitter=[0.003])
    assert vehicle.terms["command_latency"] == {"delay": 0.012, "jitter": 0.003}
    parameters_from_vehicle(vehicle)
    text = (tmp_path / "vehicle.yaml").read_text()
    assert text.count(", which the file did not have\n") == 2


def test_the_comment_on_a_change_names_the_value_before(tmp_path):
    repaired(tmp_path, content(), mass=[1.1 * VEHICLE.mass])
    assert f"was {VEHICLE.mass:.5g}\n" in (tmp_path / "vehicle.yaml").read_text()


def test_the_comment_on_an_ambiguous_change_has_the_weights_of_all_that_it_could_be(tmp_path):
    offset = SelectedEffect(
        EFFECTS["com_offset"],
        np.array([0.001, 0.0, 0.0]),
        1e-8 * np.eye(3),
        9.0,
        confounders={"com_offset": 0.95, "damaged_propeller[2]": 0.05},
    )
    found = SimpleNamespace(selected=[offset], vehicle=inject(VEHICLE, offset.effect, offset.values))
    text = repaired_files.vehicle_text(content(), found, SOURCE)
    comment = "# terms.com_offset.position[0] (ambiguous: com_offset 0.95, damaged_propeller[2] 0.05): 0.001 "
    assert comment in text


def test_another_damaged_propeller_replaces_the_one_in_the_file(tmp_path):
    before = content(damaged_propeller={"rotor": 2, "loss": 0.1})
    vehicle = repaired(tmp_path, before, **{"damaged_propeller[3]": [0.05]})
    assert vehicle.terms["damaged_propeller"]["rotor"] == 3
    assert vehicle.terms["damaged_propeller"]["loss"] == pytest.approx(0.05)
    assert "# terms.damaged_propeller.rotor: 3 +- 0, was 2\n" in (tmp_path / "vehicle.yaml").read_text()


def test_the_largest_latency_and_jitter_of_the_catalogue_can_be_simulated():
    vehicle = VEHICLE
    for key in ("command_latency", "command_jitter"):
        vehicle = inject(vehicle, EFFECTS[key], [EFFECTS[key].parameters[0].high])
    assert vehicle.terms["command_latency"] == {"delay": 0.05, "jitter": 0.01}
    assert parameters_from_vehicle(vehicle).mass == pytest.approx(VEHICLE.mass)  # which raises for what cannot be flown


def test_vectors_of_two_effects_of_one_size_do_not_share_their_values(tmp_path):
    found = {
        "accel_bias": [0.1, 0.2, 0.3],
        "imu_lever_arm": [0.01, 0.02, 0.03],
        "frame_misalignment": [1e-3, 0.0, 2e-3],
    }
    vehicle = repaired(tmp_path, content(), **found)
    assert vehicle.terms["accel_bias"]["bias"] == [0.1, 0.2, 0.3]
    assert vehicle.terms["imu_lever_arm"]["position"] == [0.01, 0.02, 0.03]
    assert vehicle.terms["frame_misalignment"]["rotation"] == [1e-3, 0.0, 2e-3]
    assert "&id" not in (tmp_path / "vehicle.yaml").read_text()
    assert all(value == 0.0 for value in EFFECTS["accel_bias"].idle["accel_bias"]["bias"])


def test_an_equation_is_written_with_ranges_and_covariance_read_again_and_flown(tmp_path):
    found = [Found("force_y", "v_x v_z", (-60.0, 60.0), 0.9), Found("moment_z", "v_y", (-9.0, 9.0), 0.5)]
    effects = equation_effects(VEHICLE, found)
    selected, vehicle = [], VEHICLE
    for effect, value in zip(effects, (0.02, 1e-4), strict=True):
        vehicle = inject(vehicle, effect, [value])
        selected.append(SelectedEffect(effect, np.array([value]), np.array([[1e-4 * value**2]]), 0.0))
    path = tmp_path / "vehicle.yaml"
    diagnosis = SimpleNamespace(selected=selected, vehicle=vehicle)
    path.write_text(repaired_files.vehicle_text(content(), diagnosis, SOURCE))
    again = load(Vehicle, path)
    entry = again.terms["equation"]
    assert entry["force_y"] == {"v_x v_z": {"coefficient": 0.02, "range": [-60.0, 60.0]}}
    assert np.sqrt(np.diag(entry["covariance"])) == pytest.approx([2e-4, 1e-6])
    assert "# terms.equation.force_y.v_x v_z.coefficient: 0.02 +- 0.0002 N s^2/m^2, which the file" in path.read_text()
    assert checks.vehicle_findings(again) == []
    moving = motion.Motion(np.zeros(3), np.array([0, 0, 0, 1.0]), np.array([5.0, 2, 3]), *np.zeros((3, 4)))
    moving = moving._replace(omega_body=np.zeros(3))
    with_it, without = (registry.wrench(moving, parameters_from_vehicle(one)) for one in (again, VEHICLE))
    assert float(with_it[0][1] - without[0][1]) == pytest.approx(0.02 * 15.0, rel=1e-4)
    assert float(with_it[1][2] - without[1][2]) == pytest.approx(2e-4, rel=1e-3)

"""Vehicle files that cannot fly are refused by a sentence each; odd but possible ones are used.

A case is a change of the shipped file: keys joined by dots, and the new value.
"""

import functools

import numpy as np
import pytest
import yaml
from changed_files import CONFIG, changed, rotors
from dotted_keys import set_value
from file_checks import check_acceptance, check_advice, check_refusal

from swift_ros import cli, configuration
from swift_ros.plausibility import of_propulsion
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.flight_controller.rate_loop import mixer

ROTORS = [[-0.0775, -0.1, -1], [0.0775, -0.1, 1], [-0.0775, 0.1, 1], [0.0775, 0.1, -1]]

IMPOSSIBLE = [
    ({"inertia": [2.9e-3, 2.4e-3, 9.0e-3]}, "belongs to no body"),
    ({"inertia": [1.0e-2, 2.4e-3, 5.0e-3]}, "belongs to no body"),
    ({"inertia": [[3e-3, 1e-3, 0], [0, 3e-3, 0], [0, 0, 5e-3]]}, "not symmetric"),
    ({"inertia": [2.9e-3, -2.4e-3, 4.9e-3]}, "positive"),
    ({"inertia": [0.0, 0.0, 0.0]}, "positive"),
    ({"mass": 870.0}, "'mass' is 870 kg, and its rotors lift 3.57 kg, .*; if 'mass' is in g, it is 0.87 kg;"),
    ({"thrust_coefficient": 1.224e-8}, "if 'thrust_coefficient' is in N/RPM.2, it is 1.116e-06 N"),
    ({"mass": -0.87}, "positive"),
    ({"mass": 0.0}, "positive"),
    ({"mass": 3.6}, "cannot hover"),
    ({"rotors": rotors(*([x, y, 1] for x, y, _ in ROTORS))}, "all rotors turn in one direction"),
    ({"rotors": rotors(*([x, y, -s] for x, y, s in ROTORS))}, "against the firmware's yaw"),
    ({"controller.yaw_motors_reversed": True}, "against the firmware's yaw"),
    (
        {"rotors": rotors(*([x, y, 1 if y > 0 else -1] for x, y, _ in ROTORS))},
        "one diagonal do not turn alike, .* the spins -1, 1, 1, -1 in their order",
    ),
    (
        {"rotors": rotors(*([x, y, 1 if x > 0 else -1] for x, y, _ in ROTORS)), "controller.yaw_motors_reversed": True},
        "one diagonal do not turn alike, .* the spins 1, -1, -1, 1 in their order",
    ),
    (
        {"rotors": [{"position": [x, y, 20.0], "spin": s} for x, y, s in ROTORS]},
        "a hub is 20 m above or below",
    ),
    ({"terms.rotor_gyroscopic.inertia": 8.0e-3}, "is that of 2 kg at the tips of each propeller"),
    ({"terms.rotor_gyroscopic.inertia": 9.0e-4}, "at the tips of each propeller, and the vehicle of 0.87 kg"),
    ({"motor.time_constant_down": 3.3e-5}, "motors need 0.02 to 0.1 s"),
    ({"sensors.accel_m_s2": 70.0}, "a sensor with more than 50 measures nothing"),
    ({"rotors": rotors(ROTORS[1], ROTORS[0], ROTORS[2], ROTORS[3])}, "listed as front right, rear right"),
    ({"rotors": rotors(ROTORS[3], ROTORS[1], ROTORS[2], ROTORS[0])}, "would tumble"),
    ({"rotors": rotors(*([-x, y, s] for x, y, s in ROTORS))}, "would tumble"),
    ({"rotors": rotors(*([x, -y, s] for x, y, s in ROTORS))}, "would tumble"),
    ({"rotors": rotors(ROTORS[0], ROTORS[0], ROTORS[2], ROTORS[3])}, "at one place"),
    ({"rotors": rotors(*ROTORS[:3])}, "3 rotors cannot control"),
    ({"rotors": rotors(*([x + 0.3, y, s] for x, y, s in ROTORS))}, "in front of the centre of mass"),
    (
        {"rotors": rotors(*([x - 0.1, y + 0.12, s] for x, y, s in ROTORS))},
        "all rotors are behind and to the left of the centre of mass",
    ),
    ({"rotors": rotors(*([x + 0.077, y, s] for x, y, s in ROTORS))}, "hold this vehicle level"),
    ({"rotors": rotors(*([1e3 * x, 1e3 * y, s] for x, y, s in ROTORS))}, "'position' in m"),
    ({"mass": 0.01, "inertia": [5e-5, 5e-5, 8e-5]}, "times the weight, of the best racers 15"),
    ({"inertia": [29000.0, 24400.0, 49900.0]}, "radii of gyration of .* give 'inertia' in kg m"),
    ({"inertia": [2.9e-6, 2.44e-6, 4.99e-6]}, "radii of gyration"),
    (
        {"torque_coefficient": 3.0e-9},
        "'torque_coefficient' 3e-09 is too small, or 'thrust_coefficient' 1.116e-06",
    ),
    ({"torque_coefficient": 1.1e-6}, "more drag than lift"),
    ({"rotor_radius": 0.11}, "propellers of rotors 1 and 2 strike each other"),
    ({"rotor_radius": 0.00635}, "17% of the power of ideal ones: 'rotor_radius' 0.00635 m or"),
    ({"rates.max": [600.0, 600.0, 286.0]}, "give rad/s, not deg/s"),
    ({"motor.time_constant_up": 33.0}, "give s, not ms"),
    ({"motor.map.coefficients": [0.0, 0.0, 2387.0, 955.0, 1472.0]}, "not rpm"),
    ({"motor.map.coefficients": [1900.0, 0.0, 250.0, 100.0, 40.0]}, "never comes down"),
    ({"controller.motor_idle": 95.0}, "never comes down; check 'controller.motor_idle'"),
    ({"hull_radius": 0.05}, "smaller than the distance of a rotor's hub"),
    ({"hull_radius": 180.0}, "do not fit a vehicle"),
    ({"terms.com_offset": {"position": [0.3, 0.0, 0.0]}}, "with 'terms.com_offset' no rotor speeds"),
    ({"terms.payload": {"mass": 4.0}}, "with 'terms.payload' no rotor speeds"),
    ({"sensors.gyro_rad_s": 20.0}, "a sensor with more than 3 measures nothing"),
    ({"battery.cells": 6}, "2.80 V for each of 6"),
    ({"battery.capacity": 1.55}, "1 Ah is 3,600 A s"),
    ({"battery.capacity": 5.58e6}, "1 Ah is 3,600 A s"),
    ({"battery.resistance": 12.0}, "ohm, not milliohm"),
    ({"battery.resistance": 0.5}, "hover needs 151 W, .* the battery gives 140 W at most"),
    ({"inertia": [2.9e-5, 2.44e-5, 4.99e-5]}, "less than the 0.00015 of a solid ball of osmium"),
    (
        {"motor.map.coefficients": [0.0, 0.0, 5550.0, -5714.0, 154.1], "controller.motor_idle": 1.0},
        "fall from 2.* rad/s at 49% throttle to 2286 rad/s at 100%, .* give c0 to c4 of a map that rises",
    ),
    (
        {"motor.map.coefficients": [1500.0, 0.0, -4500.0, 5500.0, 0.0], "controller.motor_idle": 1.0},
        "fall from 1105 rad/s at 1% throttle to 580 rad/s at 17%",
    ),
    ({"battery.reference_voltage": 25.0}, "exceeds the full pack's 'open_circuit_full'"),
    ({"battery.reference_voltage": 3.9, "motor.map.coefficients": [0, 0, 250, 100, 628]}, "not of a cell"),
    ({"battery.open_circuit_curve": [12.8, 16.8]}, "must fall"),
    ({"battery.energy": 26.0}, "1 Wh is 3,600 J"),
    ({"battery.temperature": 298.0}, "degrees Celsius"),
    ({"battery.rc_time": 0.0}, "'battery.rc_time' must be positive"),
    ({"rotor_speed_range": [150.0, 1e200]}, "too large or too small"),
    ({"rotors": rotors(*([x, y, s] for x, y, s in ROTORS[:3]), [0.0775, 0.1, 2])}, "must be 1 or -1"),
    ({"thrust_coefficient": -1.1e-6}, "'thrust_coefficient' must be positive"),
    ({"thrust_coefficient": 1.1e-8}, "cannot hover"),
    ({"torque_coefficient": -1.1e-8}, "'torque_coefficient' must be positive"),
    ({"rotor_radius": 0.0}, "'rotor_radius' must be positive"),
    ({"rotor_radius": 63.5}, "strike each other"),
    ({"rotor_speed_range": [150.0, 26700.0]}, "faster than sound"),
    ({"rotor_speed_range": [2800.0, 150.0]}, "'rotor_speed_range' must rise .*; exchange them"),
    ({"rotor_speed_range": [-150.0, 2800.0]}, "must rise"),
    ({"motor.map.coefficients": [0.0, 0.0, 50.0, 10.0, 5.0]}, "below the 1383 of hover|of hover"),
    ({"motor.time_constant_up": 0.0}, "must be positive"),
    ({"rates.max": [10.0, 0.0, 4.0]}, "'rates.max' must be positive"),
    ({"hull_radius": -0.1}, "'hull_radius' must be positive"),
    ({"terms.rotor_drag.k_d": -4.0e-5}, "would drive the vehicle"),
    ({"terms.body_drag.c": [0.004, -0.004, 0.008]}, "would drive the vehicle"),
    ({"battery.efficiency": 85.0}, "a share of 0 to 1"),
    ({"battery.efficiency": 0.0}, "a share of 0 to 1"),
    ({"battery.resistance": -0.012}, "'battery.resistance' must be 0 or more"),
    ({"battery.capacity": 0.0}, "'battery.capacity' must be positive"),
    ({"battery.cells": 8}, "for each of 8 'cells'"),
    ({"battery.open_circuit_slope": 17.0}, "leaves an empty pack no voltage"),
    ({"battery.reference_voltage": -15.9}, "positive|below the"),
]
POSSIBLE = [
    ({"mass": 0.25, "inertia": [5e-4, 5e-4, 8e-4]}),
    ({"mass": 2.6}),
    ({"inertia": [[2.9e-3, 1e-5, 0], [1e-5, 2.44e-3, 0], [0, 0, 4.99e-3]]}),
    ({"rotors": rotors(*([x, y, -s] for x, y, s in ROTORS)), "controller.yaw_motors_reversed": True}),
    ({"rotors": rotors(*([x + 0.01, y, s] for x, y, s in ROTORS))}),
    ({"rotors": rotors(*([1.6 * x, 0.8 * y, s] for x, y, s in ROTORS))}),
    ({"rotor_speed_range": [0.0, 2800.0]}),
    ({"terms.rotor_drag.k_d": 0.0}),
    ({"terms": {}}),
    ({"battery.cells": 0}),
    ({"battery.resistance": 0.0}),
    ({"battery.resistance": 0.35}),
    ({"motor.map.coefficients": [0.0, 0.0, 900.0, -1150.0, 180.0]}),
    ({"hull_radius": 0.13}),
    ({"rotor_radius": 0.0755}),
    ({"battery.open_circuit_full": 13.6, "battery.reference_voltage": 13.2}),
    ({"terms.payload": {"mass": 0.4, "position": [0.0, 0.0, -0.05]}}),
    ({"rates.max": [30.0, 30.0, 15.0]}),
]
ODD = [
    (
        {"mass": 0.11, "inertia": [4e-4, 4e-4, 7e-4], "controller.motor_idle": 3.0},
        "times the weight; check 'mass' in kg",
    ),
    ({"inertia": [2.9e-4, 2.44e-4, 4.99e-4]}, "radii of gyration"),
    ({"motor.time_constant_up": 0.33}, "give s, not ms"),
    ({"terms.rotor_gyroscopic.inertia": 2.0e-4}, "needs 23% of the vehicle's mass at the tips"),
    ({"battery.capacity": 900.0}, "3,600 A s"),
    ({"torque_coefficient": 4.0e-8}, "drag torque over thrust"),
    ({"hull_radius": 0.13}, "does not cover the propellers"),
    ({"battery.cells": 5}, "check 'battery.cells'"),
    ({"terms.payload": {"mass": 1.5}}, "'terms.payload.mass' is 1.5 kg"),
]


@pytest.mark.parametrize(("changes", "sentence"), IMPOSSIBLE)
def test_an_impossible_vehicle_is_refused_by_one_sentence(tmp_path, changes, sentence):
    check_refusal(Vehicle, changed(tmp_path, "drone", changes), sentence)


@pytest.mark.parametrize("changes", POSSIBLE)
def test_an_odd_vehicle_is_accepted(tmp_path, changes):
    check_acceptance(Vehicle, changed(tmp_path, "drone", changes))


@pytest.mark.parametrize(("changes", "sentence"), ODD)
def test_what_is_odd_of_a_vehicle_is_said(tmp_path, capsys, changes, sentence):
    check_advice(changed(tmp_path, "drone", changes), sentence, capsys)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"rotors": rotors(*ROTORS[:2], ROTORS[3], ROTORS[3])}, "rotors 3 and 4 are at one place"),
        ({"rotor_speed_range": [1432.0, 26738.0]}, "faster than sound"),
        ({"mass": 0.01, "inertia": [5e-5, 5e-5, 8e-5]}, "times the weight, of the best racers 15"),
        ({"motor.map.coefficients": [0.0, 0.0, 250.0, 100.0, -154.1]}, "a map that rises"),
    ],
)
def test_what_follows_from_a_wrong_value_is_not_said(tmp_path, changes, sentence):
    vehicle = configuration.load_unchecked(Vehicle, changed(tmp_path, "drone", changes))
    [found] = vehicle.findings()
    assert sentence in found.sentence


def test_errors_that_do_not_follow_from_each_other_are_all_said(tmp_path):
    changes = {
        "rotor_speed_range": [1432.0, 26738.0],
        "motor.time_constant_up": 33.0,
        "rates.max": [600.0, 600.0, 286.0],
    }
    vehicle = configuration.load_unchecked(Vehicle, changed(tmp_path, "drone", changes))
    assert len(vehicle.findings()) == 3


def resized(scale: float) -> dict:
    """Return the shipped vehicle with another mass, built alike: with the same materials and speed of the tips."""
    content = yaml.safe_load((CONFIG / "drone.yaml").read_text())
    powers = {  # of the mass
        "mass": 1,
        "inertia": 5 / 3,
        "rotor_radius": 1 / 3,
        "thrust_coefficient": 5 / 3,
        "torque_coefficient": 2,
        "rotor_speed_range": -1 / 3,
        "motor.map.coefficients": -1 / 3,
        "hull_radius": 1 / 3,
        "hull_height": 1 / 3,
        "battery.capacity": 1,
        "battery.avionics_w": 1,
        "battery.resistance": -1,
        "battery.rc_resistance": -1,
        "battery.rc2_resistance": -1,
        "terms.rotor_drag.k_d": 4 / 3,
        "terms.body_drag.c": 1,
        "terms.drag_center.position": 1 / 3,
        "terms.axial_inflow.k_z": 4 / 3,
        "terms.translational_lift.k_h": 1,
        "terms.flapping_moment.k_f": 5 / 3,
        "terms.rotor_gyroscopic.inertia": 5 / 3,
    }
    for key, power in powers.items():
        value = functools.reduce(lambda part, name: part[name], key.split("."), content)
        set_value(content, key, (np.array(value, dtype=float) * scale**power).tolist())
    for rotor in content["rotors"]:
        rotor["position"] = [value * scale ** (1 / 3) for value in rotor["position"]]
    return content


@pytest.mark.parametrize("mass", [0.03, 0.25, 0.87, 3.0, 12.0])
def test_vehicles_of_any_size_are_accepted_and_their_coefficients_measured_by_it(tmp_path, capsys, mass):
    path = tmp_path / "drone.yaml"
    path.write_text(yaml.safe_dump(resized(mass / 0.87)))
    assert cli.main(["check", str(path)]) == 0
    assert "nothing is impossible or odd" in capsys.readouterr().out
    for term, key in (("rotor_drag", "k_d"), ("flapping_moment", "k_f"), ("rotor_gyroscopic", "inertia")):
        wrong = yaml.safe_load(path.read_text())
        wrong["terms"][term][key] *= 1e5
        (tmp_path / "wrong.yaml").write_text(yaml.safe_dump(wrong))
        assert cli.main(["check", str(tmp_path / "wrong.yaml")]) == 1
        assert f"'terms.{term}.{key}'" in capsys.readouterr().out


def test_the_expected_motors_are_those_of_the_simulated_firmware():
    np.testing.assert_array_equal(of_propulsion.MIX, mixer.MIX)  # the checks are below the simulator in the layers

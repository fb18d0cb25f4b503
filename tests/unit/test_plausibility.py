"""Files that no vehicle, track or camera can have are refused by a sentence each; odd but possible ones are flown.

A case is a change of a shipped file: keys joined by dots, and the new value.
"""

from pathlib import Path

import numpy as np
import pytest
import yaml

from swift_ros import cli, configuration
from swift_ros.camera.model import Camera
from swift_ros.errors import UsageError
from swift_ros.plausibility import of_vehicle
from swift_ros.plausibility.finding import ODD
from swift_ros.track import Track
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.flight_controller.rate_loop import mixer

CONFIG = Path(__file__).parents[2] / "config"
KINDS = {"drone": Vehicle, "track": Track, "camera": Camera}
ROTORS = [[-0.0775, -0.1, -1], [0.0775, -0.1, 1], [-0.0775, 0.1, 1], [0.0775, 0.1, -1]]


def rotors(*rows):
    return [{"position": [x, y, 0.0], "spin": spin} for x, y, spin in rows]


def gates(*rows):
    return [{"position": list(row[:3]), "yaw_deg": row[3], **(row[4] if len(row) > 4 else {})} for row in rows]


LEVEL = (0.0, 0.0, 2.0, 0.0)
IMPOSSIBLE = [
    ("drone", {"inertia": [2.9e-3, 2.4e-3, 9.0e-3]}, "belongs to no body"),
    ("drone", {"inertia": [1.0e-2, 2.4e-3, 5.0e-3]}, "belongs to no body"),
    ("drone", {"inertia": [[3e-3, 1e-3, 0], [0, 3e-3, 0], [0, 0, 5e-3]]}, "not symmetric"),
    ("drone", {"inertia": [2.9e-3, -2.4e-3, 4.9e-3]}, "positive"),
    ("drone", {"inertia": [0.0, 0.0, 0.0]}, "positive"),
    ("drone", {"mass": 870.0}, "cannot hover"),
    ("drone", {"mass": -0.87}, "positive"),
    ("drone", {"mass": 0.0}, "positive"),
    ("drone", {"mass": 3.6}, "cannot hover"),
    ("drone", {"rotors": rotors(*([x, y, 1] for x, y, _ in ROTORS))}, "all rotors turn in one direction"),
    ("drone", {"rotors": rotors(*([x, y, -s] for x, y, s in ROTORS))}, "against the firmware's yaw"),
    ("drone", {"controller.yaw_motors_reversed": True}, "against the firmware's yaw"),
    ("drone", {"rotors": rotors(ROTORS[1], ROTORS[0], ROTORS[2], ROTORS[3])}, "listed as front right, rear right"),
    ("drone", {"rotors": rotors(ROTORS[3], ROTORS[1], ROTORS[2], ROTORS[0])}, "would tumble"),
    ("drone", {"rotors": rotors(*([-x, y, s] for x, y, s in ROTORS))}, "would tumble"),
    ("drone", {"rotors": rotors(*([x, -y, s] for x, y, s in ROTORS))}, "would tumble"),
    ("drone", {"rotors": rotors(ROTORS[0], ROTORS[0], ROTORS[2], ROTORS[3])}, "at one place"),
    ("drone", {"rotors": rotors(*ROTORS[:3])}, "3 rotors cannot control"),
    ("drone", {"rotors": rotors(*([x + 0.3, y, s] for x, y, s in ROTORS))}, "hold this vehicle level"),
    ("drone", {"rotors": rotors(*([x, y, s] for x, y, s in ROTORS[:3]), [0.0775, 0.1, 2])}, "must be 1 or -1"),
    ("drone", {"thrust_coefficient": -1.1e-6}, "cannot hover"),
    ("drone", {"thrust_coefficient": 1.1e-8}, "cannot hover"),
    ("drone", {"torque_coefficient": -1.1e-8}, "'torque_coefficient' must be positive"),
    ("drone", {"rotor_radius": 0.0}, "'rotor_radius' must be positive"),
    ("drone", {"rotor_radius": 63.5}, "faster than sound"),
    ("drone", {"rotor_speed_range": [150.0, 26700.0]}, "faster than sound"),
    ("drone", {"rotor_speed_range": [2800.0, 150.0]}, "cannot hover|must rise"),
    ("drone", {"rotor_speed_range": [-150.0, 2800.0]}, "must rise"),
    ("drone", {"motor.map.coefficients": [0.0, 0.0, 50.0, 10.0, 5.0]}, "below the 1383 of hover|of hover"),
    ("drone", {"motor.time_constant_up": 0.0}, "must be positive"),
    ("drone", {"rates.max": [10.0, 0.0, 4.0]}, "'rates.max' must be positive"),
    ("drone", {"hull_radius": -0.1}, "'hull_radius' must be positive"),
    ("drone", {"terms.rotor_drag.k_d": -4.0e-5}, "would drive the vehicle"),
    ("drone", {"terms.body_drag.c": [0.004, -0.004, 0.008]}, "would drive the vehicle"),
    ("drone", {"battery.efficiency": 85.0}, "a share of 0 to 1"),
    ("drone", {"battery.efficiency": 0.0}, "a share of 0 to 1"),
    ("drone", {"battery.resistance": -0.012}, "'battery.resistance' must be 0 or more"),
    ("drone", {"battery.capacity": 0.0}, "'battery.capacity' must be positive"),
    ("drone", {"battery.cells": 8}, "for each of 8 cells"),
    ("drone", {"battery.open_circuit_slope": 17.0}, "leaves an empty pack no voltage"),
    ("drone", {"battery.reference_voltage": -15.9}, "positive|below the"),
    ("track", {"gates": gates((0.0, 0.0, 0.5, 0.0))}, "gate 1 reaches 0.25 m into the ground"),
    ("track", {"gates": gates((0.0, 0.0, -3.0, 0.0))}, "into the ground"),
    ("track", {"gates": gates((14.9, 0.0, 2.0, 0.0), (40.0, 0.0, 2.0, 0.0))}, "gate 2 is not within the flight volume"),
    ("track", {"gates": gates((0.0, 0.0, 7.6, 0.0))}, "not within the flight volume"),
    ("track", {"gates": gates((0.0, 14.5, 2.0, 0.0))}, "not within the flight volume"),
    ("track", {"gates": gates(LEVEL, LEVEL, (5.0, 0.0, 2.0, 0.0))}, "gates 1 and 2 follow each other at one place"),
    ("track", {"gates": gates(LEVEL, (0.3, 0.0, 2.0, 45.0))}, "stand in each other"),
    ("track", {"gates": gates(LEVEL, (0.0, 0.0, 2.0, 90.0))}, "stand in each other"),
    ("track", {"gates": []}, "no gates"),
    ("track", {"inner_side": 2.2}, "less than 'outer_side'"),
    ("track", {"inner_side": -1.5}, "positive"),
    ("track", {"inner_side": 150.0, "outer_side": 210.0}, "into the ground|not within"),
    ("track", {"gates": gates((*LEVEL, {"inner_side": 3.0}))}, "less than 'outer_side'"),
    ("track", {"gates": gates((0.0, 0.0, 0.8, 0.0, {"roll_deg": 45.0}))}, "into the ground"),
    ("track", {"depth": 0.0}, "'depth' must be positive"),
    ("track", {"start": [-5.0, 45.0, 1.2]}, "'start' is outside"),
    ("track", {"start": [-5.0, 4.5, -1.2]}, "'start' is outside"),
    ("track", {"laps": 0}, "at least 1"),
    ("track", {"bounds_min": [15.0, -15.0, 0.0]}, "'bounds_min' must be less"),
    ("camera", {"cx": 424.0}, "principal point"),
    ("camera", {"fx": -137.3}, "must be positive"),
    ("camera", {"width": 0}, "must be positive"),
    ("camera", {"image_circle_deg": 400.0}, "no field of view"),
    ("camera", {"distortion": [-0.4, 0.037, -0.036, 0.006]}, "two directions"),
    ("camera", {"distortion": [-0.9, 0.0, 0.0, 0.0], "model": "pinhole", "image_circle_deg": None}, "less than half"),
    ("camera", {"exposure_s": 6.0}, "'exposure_s'"),
    ("camera", {"exposure_s": -0.006}, "'exposure_s'"),
    ("camera", {"rate_hz": 0.0}, "must be positive"),
    ("camera", {"processing_latency": 40.0}, "'processing_latency'"),
    ("camera", {"processing_latency": -0.04}, "'processing_latency'"),
    ("camera", {"position": [60.0, 0.0, 20.0]}, "'position' is 63.2 m"),
    ("camera", {"pitch_deg": 120.0}, "beyond the vertical"),
    ("camera", {"model": "fisheye"}, "must be one of"),
    ("camera", {"distortion": [0.1]}, "has 4 values"),
]
POSSIBLE = [
    ("drone", {"mass": 0.25, "inertia": [5e-4, 5e-4, 8e-4]}),
    ("drone", {"mass": 2.6}),
    ("drone", {"inertia": [[2.9e-3, 1e-5, 0], [1e-5, 2.44e-3, 0], [0, 0, 4.99e-3]]}),
    ("drone", {"rotors": rotors(*([x, y, -s] for x, y, s in ROTORS)), "controller.yaw_motors_reversed": True}),
    ("drone", {"rotors": rotors(*([x + 0.01, y, s] for x, y, s in ROTORS))}),
    ("drone", {"rotors": rotors(*([1.6 * x, 0.8 * y, s] for x, y, s in ROTORS))}),
    ("drone", {"rotor_speed_range": [0.0, 2800.0]}),
    ("drone", {"terms.rotor_drag.k_d": 0.0}),
    ("drone", {"terms": {}}),
    ("drone", {"battery.cells": 0}),
    ("drone", {"battery.resistance": 0.0}),
    ("drone", {"hull_radius": 0.1}),
    ("track", {"gates": gates((0.0, 0.0, 0.75, 0.0))}),
    ("track", {"gates": gates(LEVEL)}),
    ("track", {"gates": gates(LEVEL, (5.0, 0.0, 2.0, 0.0), (0.0, 0.0, 2.0, 180.0), (5.0, 0.0, 2.0, 180.0))}),
    ("track", {"gates": gates(LEVEL, (5.0, 0.0, 2.0, 0.0), LEVEL, (0.0, 6.0, 2.0, 0.0))}),
    ("track", {"gates": gates((0.0, 0.0, 3.0, 0.0, {"pitch_deg": 90.0}), (5.0, 0.0, 2.0, 0.0))}),
    ("track", {"gates": gates((*LEVEL, {"inner_side": 0.8, "outer_side": 1.0}), (5.0, 0.0, 2.0, 0.0))}),
    ("track", {"start_yaw_deg": 140.0}),
    ("track", {"laps": 50}),
    ("camera", {"pitch_deg": 45.0, "roll_deg": 90.0}),
    ("camera", {"pitch_deg": -30.0}),
    ("camera", {"exposure_s": 0.0}),
    ("camera", {"model": "pinhole", "distortion": [], "image_circle_deg": None}),
    ("camera", {"model": "double_sphere", "distortion": [-0.18, 0.59], "image_circle_deg": None}),
]


def changed(tmp_path, kind: str, changes: dict) -> Path:
    """Write a shipped file with changes and return its path."""
    content = yaml.safe_load((CONFIG / f"{kind}.yaml").read_text())
    for key, value in changes.items():
        *folders, last = key.split(".")
        place = content
        for folder in folders:
            place = place[folder]
        if value is None:
            place.pop(last)
        else:
            place[last] = value
    path = tmp_path / f"{kind}.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


@pytest.mark.parametrize(("kind", "changes", "sentence"), IMPOSSIBLE)
def test_an_impossible_file_is_refused_by_one_sentence(tmp_path, kind, changes, sentence):
    path = changed(tmp_path, kind, changes)
    with pytest.raises(UsageError, match=sentence) as caught:
        configuration.load(KINDS[kind], path)
    text = str(caught.value)
    assert text.startswith(str(path)) and "\n" not in text and len(text) < 400


@pytest.mark.parametrize(("kind", "changes"), POSSIBLE)
def test_an_odd_file_is_accepted(tmp_path, kind, changes):
    record = configuration.load(KINDS[kind], changed(tmp_path, kind, changes))
    assert all(finding.level == ODD for finding in record.findings())


@pytest.mark.parametrize(
    ("kind", "changes", "sentence"),
    [
        ("drone", {"mass": 0.1}, "times the weight; check 'mass' in kg"),
        ("drone", {"inertia": [2.9, 2.44, 4.99]}, "radii of gyration"),
        ("drone", {"motor.time_constant_up": 33.0}, "give s, not ms"),
        ("drone", {"battery.capacity": 1.55}, "1 Ah is 3,600 A s"),
        ("drone", {"torque_coefficient": 1.1e-6}, "drag torque over thrust"),
        ("drone", {"hull_radius": 0.05}, "'hull_radius' 0.05 m is smaller"),
        ("track", {"gates": gates((*LEVEL, {"roll_deg": 45.0}))}, "the detector confuses its corners"),
        ("track", {"gates": gates((*LEVEL, {"pitch_deg": 80.0}))}, "rarely finds it"),
        ("track", {"start_yaw_deg": 140.0}, "away from gate 1"),
        ("camera", {"fx": 3000.0, "fy": 3000.0, "image_circle_deg": None}, "field of view is 10 degrees"),
        ("camera", {"fx": 286.0}, "differ by a factor of 2.1"),
        ("camera", {"yaw_deg": 180.0}, "180 degrees to the side"),
    ],
)
def test_what_is_odd_is_said(tmp_path, capsys, kind, changes, sentence):
    path = changed(tmp_path, kind, changes)
    assert cli.main(["check", str(path)]) == 0
    assert sentence in capsys.readouterr().out


def test_check_names_all_that_is_impossible_in_a_folder_of_files(tmp_path, capsys):
    changed(tmp_path, "drone", {"inertia": [1.0e-2, 2.4e-3, 5.0e-3], "battery.efficiency": 85.0})
    changed(tmp_path, "track", {"gates": gates((0.0, 0.0, 0.5, 0.0))})
    assert cli.main(["check", str(tmp_path)]) == 1
    assert capsys.readouterr().out.count(": impossible: ") == 3


def test_an_opening_smaller_than_the_vehicle_is_impossible(tmp_path, capsys):
    changed(tmp_path, "drone", {})
    changed(tmp_path, "track", {"gates": gates(LEVEL, (5.0, 0.0, 2.0, 0.0, {"inner_side": 0.35, "outer_side": 0.5}))})
    assert cli.main(["check", str(tmp_path)]) == 1
    assert "the opening of gate 2 is 0.35 m wide, and Swift 5-inch racer is 0.36 m" in capsys.readouterr().out


def test_a_file_of_another_kind_is_named(tmp_path, capsys):
    assert cli.main(["check", str(CONFIG / "nodes.yaml")]) == 2
    assert "none of the keys" in capsys.readouterr().err


def test_the_expected_motors_are_those_of_the_simulated_firmware():
    np.testing.assert_array_equal(of_vehicle.MIX, mixer.MIX)  # the checks are below the simulator in the layers

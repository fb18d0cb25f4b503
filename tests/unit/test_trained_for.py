"""What a network was not trained for is a warning in one sentence; the shipped files have none."""

import dataclasses
import json
import shutil

import pytest
import yaml
from dotted_keys import set_value

from swift_ros import cli, configuration
from swift_ros.camera.model import Camera
from swift_ros.track import Track
from swift_ros.trained_for import pilot
from swift_ros.trained_for.folder import warnings
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.commands import race
from swift_sim_bridge.sensors.terms import SENSOR_TERMS


@pytest.fixture
def folder(repository, tmp_path):
    return shutil.copytree(repository / "config", tmp_path / "config")


def change(folder, name, key, value):
    """Set a value of a file by its dotted key; None removes it."""
    content = yaml.safe_load((folder / name).read_text())
    set_value(content, key, value)
    (folder / name).write_text(yaml.safe_dump(content))


def test_the_shipped_configuration_has_no_warning(repository, capsys):
    assert warnings(repository / "config") == []
    assert cli.main(["check", str(repository / "config")]) == 0
    assert "not trained" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "key", "value", "sentence"),
    [
        ("track", "gates.2.position", [9.2, -5.0, 1.2], "another track: gate 3 is 1.0 m away from where it was; train"),
        ("track", "gates.1.yaw_deg", 20.0, "another track: gate 2 is turned by 40 degrees; train"),
        ("track", "gates.1.inner_side", 1.4, "the opening of gate 2 is 1.40 m wide, it was 1.50 m"),
        ("track", "gates.6", None, "another track: it had 7 gates, not 6"),
        ("track", "start", [-5.0, 5.5, 1.2], "the podium is 1.0 m away"),
        ("track", "start_yaw_deg", 0.0, "the heading on the podium is turned by 57 degrees"),
        ("track", "bounds_max", [15.0, 15.0, 6.0], "the flight volume is smaller"),
        ("drone", "mass", 0.95, "another vehicle: 'mass' is 0.95 kg, it was 0.87; train"),
        ("drone", "thrust_coefficient", 1.3e-6, "another vehicle: the largest thrust is 40.77 N, it was 35"),
        ("drone", "rates.max", [10.0, 10.0, 3.5], "'rates.max' has other values"),
        ("drone", "motor.time_constant_up", 0.05, "'motor.time_constant_up' is 0.05 s, it was 0.033"),
        ("drone", "terms.rotor_drag", None, "its file has no term 'rotor_drag'"),
        ("drone", "terms.rotor_drag.k_d", 8e-5, "'terms.rotor_drag.k_d' is 8e-05, it was 4e-05"),
        ("drone", "terms.body_drag.c.2", 0.02, "another vehicle: 'terms.body_drag.c' has other values; train"),
        (
            "drone",
            "terms.camera_focal",
            {"scale": 0.01},
            "other instruments: its file has the new term 'camera_focal'",
        ),
        ("drone", "controller.motor_idle", 7.0, "'controller.motor_idle' has another value"),
        ("camera", "fx", 160.0, "another camera: 'fx' is 160 px, it was 137.3; train"),
        ("camera", "pitch_deg", 45.0, "another camera: its mount is turned by 25 degrees"),
        ("camera", "image_circle_deg", 120.0, "another camera: its field of view is 120 degrees, it was 163"),
        ("simulation", "renderer.noise", [1.0, 20.0], "other looks: 'noise' is drawn from 1 to 20, it was 0.5 to 7"),
    ],
)
def test_what_a_network_was_not_trained_for_is_a_warning(folder, capsys, name, key, value, sentence):
    change(folder, f"{name}.yaml", key, value)
    found = warnings(folder)
    assert len(found) == 1 and sentence in found[0] and "\n" not in found[0]
    assert cli.main(["check", str(folder)]) == 0
    assert f"{folder}: odd: {found[0]}" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "key", "value"),
    [
        ("track", "gates.2.position", [9.2, -4.05, 1.2]),
        ("track", "laps", 5),
        ("track", "name", "my hall"),
        ("drone", "mass", 0.88),
        ("drone", "terms.rotor_drag.k_d", 4.5e-5),
        ("camera", "fx", 139.0),
    ],
)
def test_what_a_training_varies_is_no_warning(folder, name, key, value):
    change(folder, f"{name}.yaml", key, value)
    assert warnings(folder) == []


def test_a_frame_of_another_shape_is_a_warning_about_the_detector(folder):
    change(folder, "track.yaml", "outer_side", 2.6)
    assert "other gates: the frame of gate 1 is 1.73 times as wide as its opening" in warnings(folder)[0]


def test_a_race_says_it_before_take_off(repository, tmp_path, capsys):
    moved = tmp_path / "track.yaml"
    shutil.copy(repository / "config" / "track.yaml", moved)
    change(tmp_path, "track.yaml", "gates.2.position", [9.2, -5.0, 1.2])
    folder = race.configure(tmp_path, race.chosen_files(None, track=moved))
    race.print_warnings(folder)
    expected = (
        "warning: the pilot was trained for another track: gate 3 is 1.0 m away from where it was; train one with"
    )
    assert capsys.readouterr().out == f"{expected} `swiftros train policy --track FILE`\n"


def test_a_provenance_of_another_network_or_none_is_said_or_silent(folder):
    models = folder / "models"
    (models / "pilot.onnx").write_bytes((models / "gate_detector.onnx").read_bytes())
    assert "pilot.json describes another pilot.onnx; copy both files" in warnings(folder)[0]
    for damage in ("{torn", "[1, 2]"):
        (models / "pilot.json").write_text(damage)
        assert "pilot.json is not the provenance of pilot.onnx" in warnings(folder)[0]
    (models / "pilot.json").unlink()
    assert warnings(folder) == []


def test_a_record_that_is_damaged_is_said(folder):
    path = folder / "models" / "pilot.json"
    record = json.loads(path.read_text())
    record["trained_for"]["track"]["gates"] = "lost"
    path.write_text(json.dumps(record))
    assert "what the pilot was trained for is not known" in warnings(folder)[0]
    record["trained_for"] = 3
    path.write_text(json.dumps(record))
    assert warnings(folder) == []


def test_the_instruments_are_the_sensors_of_the_simulator():
    assert frozenset(SENSOR_TERMS) == pilot.INSTRUMENTS  # the records are below the simulator in the layers


def test_a_record_is_the_file_it_was_made_of(repository):
    folder = repository / "config"
    for kind, name in ((Track, "track.yaml"), (Vehicle, "drone.yaml"), (Camera, "camera.yaml")):
        loaded = configuration.load(kind, folder / name)
        again = configuration.build(kind, json.loads(json.dumps(configuration.content(loaded))), name)
        assert again == dataclasses.replace(loaded)

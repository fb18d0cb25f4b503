"""`swiftros gap` from files to files: its report, page and repaired vehicle file can be used."""

import json

import numpy as np
import pytest
import yaml
from motor_log import VEHICLE, log

from swift_ros import cli
from swift_ros.configuration import configuration_folder, load
from swift_ros.recording import flight_files
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.pipeline import references
from swift_sim_bridge.gap.report import residual_file
from swift_sim_bridge.physics.state import parameters_from_vehicle

SOURCE = configuration_folder() / "drone.yaml"


@pytest.fixture
def vehicle_file(tmp_path):
    """Write the shipped vehicle with the simple battery and the sensor noise of the log's writer."""
    content = yaml.safe_load(SOURCE.read_text())
    content["battery"] |= {"rc2_resistance": 0.0, "rc2_time": 0.0}
    path = tmp_path / "drone.yaml"
    path.write_text(yaml.safe_dump(content | {"sensors": VEHICLE.sensors}))
    return path


def test_a_slow_motor_in_a_log_gives_a_report_a_page_and_a_vehicle_that_flies(
    tmp_path, vehicle_file, monkeypatch, capsys
):
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", 8)
    flight_files.write(log(5, lag_s=0.040), tmp_path / "log.csv")
    flight_files.write(log(6, lag_s=0.040), tmp_path / "later.csv")
    out = tmp_path / "report"
    options = ["--unseen", str(tmp_path / "later.csv"), "--vehicle", str(vehicle_file), "--out", str(out)]
    assert cli.main(["gap", str(tmp_path / "log.csv"), *options]) == 0
    report = json.loads((out / "report.json").read_text(), parse_constant=lambda name: pytest.fail(f"{name} in JSON"))
    (one,), (later,) = report["findings"], report["unseen_flights"]
    assert (one["effect"], one["layer"]) == ("motor_time_constant", "motor")
    errors = later["one_step_rmse_by_channel"]["rotor_speed_1"]
    assert later["recording"] == "later.csv" and errors["after"] < 0.5 * errors["before"]
    assert one["channels"] == [f"rotor_speed_{i}" for i in (1, 2, 3, 4)]
    assert "motor time constant" in capsys.readouterr().out
    repaired = load(Vehicle, out / "vehicle.yaml")
    assert repaired.motor.time_constant_up == pytest.approx(0.040, rel=0.02)
    parameters_from_vehicle(repaired)
    (residuals,) = residual_file.read(out / "residuals.npz")
    for i, channel in enumerate(residuals.channels):
        if channel.startswith("rotor"):
            before, after = (np.sqrt(np.nanmean(side[:, i] ** 2)) for side in (residuals.before, residuals.after))
            assert after < 0.5 * before, channel
    assert "rotor 1 speed" in residuals.channels
    page, pictures = (out / "report.html").read_text(), list(out.glob("*.png"))
    assert {"curves_rotor_speed_1.png", "time_before.png", "time_after.png"} <= {path.name for path in pictures}
    assert all(path.name in page and path.stat().st_size > 10_000 for path in pictures)
    lag = one["parameters"]["time_constant_up"]
    assert (lag["was"], lag["key"]) == (VEHICLE.motor.time_constant_up, "motor.time_constant_up")
    assert one["removes"] > 0.5 and one["most_improved"]["channel"].startswith("rotor_speed")
    assert report["next_steps"][0]["commands"][0] == f"swiftros race --vehicle {out / 'vehicle.yaml'}"
    assert f"{1e3 * VEHICLE.motor.time_constant_up:.0f}" in page and "motor.time_constant_up" in page


def test_an_unusable_recording_is_refused_in_one_sentence_and_the_last_report_stays(tmp_path, capsys):
    (tmp_path / "flight.csv").write_text("t,px,py\n0,1,2\n")
    out = tmp_path / "report"
    out.mkdir()
    (out / "report.json").write_text("{}")
    assert cli.main(["gap", str(tmp_path / "flight.csv"), "--out", str(out)]) == 2
    message = capsys.readouterr().err.strip()
    assert "flight.csv" in message and "\n" not in message and "Traceback" not in message
    assert (out / "report.json").read_text() == "{}"

"""Settings of nodes, simulation and trainings, and files that do not fit each other, are refused by a sentence each."""

import re

import pytest
from changed_files import CONFIG, LEVEL, changed, gates

from swift_ros import cli


def test_check_names_all_that_is_impossible_in_a_folder_of_files(tmp_path, capsys):
    changed(tmp_path, "drone", {"inertia": [1.0e-2, 2.4e-3, 5.0e-3], "rates.max": [100.0, 100.0, 100.0]})
    changed(tmp_path, "track", {"gates": gates((0.0, 0.0, 0.5, 0.0))})
    assert cli.main(["check", str(tmp_path)]) == 1
    out = capsys.readouterr().out
    assert out.count(": impossible: ") == 4
    assert "has no camera.yaml and no nodes.yaml and no simulation.yaml; copy the missing files" in out


def test_an_opening_smaller_than_the_vehicle_is_impossible(tmp_path, capsys):
    changed(tmp_path, "drone", {})
    changed(tmp_path, "track", {"gates": gates(LEVEL, (5.0, 0.0, 2.0, 0.0, {"inner_side": 0.35, "outer_side": 0.5}))})
    assert cli.main(["check", str(tmp_path)]) == 1
    assert "the opening of gate 2 is 0.35 m wide, and Swift 5-inch racer is 0.36 m" in capsys.readouterr().out


# Settings of nodes, simulation and trainings, and what the simulator takes of a vehicle.
SETTINGS = [
    ("nodes", {"gate_detector.peak_threshold": 5.5}, "'peak_threshold' must be from 0.0 to 1.0, not 5.5"),
    ("nodes", {"gate_detector.providers": ["cpu", "gpu"]}, "'providers' must be one of tensorrt, cuda, cpu, not 'gpu'"),
    ("nodes", {"gate_detector.providers": []}, "'providers' names none"),
    ("nodes", {"gate_detector.model": "models/other.onnx"}, "section 'gate_detector', key 'model': .*is missing"),
    ("nodes", {"gate_detector.model": "models/pilot.onnx"}, "section 'gate_detector', key 'model'"),
    ("nodes", {"policy.model": "models/gate_detector.onnx"}, "section 'policy', key 'model': .* is not a pilot"),
    ("nodes", {"betaflight.stale_s": 0.03}, "'stale_s' 0.03 s is below 'silence_s' 0.05 s"),
    ("nodes", {"betaflight.port": "tcp://127.0.0.1:99999"}, "a port from 1 to 65535"),
    ("nodes", {"betaflight.port": "udp://127.0.0.1:5761"}, "neither tcp://HOST:PORT nor a serial device"),
    ("nodes", {"betaflight.port": "/dev/ttyACM0", "betaflight.baud": 921601}, "not a serial speed"),
    ("nodes", {"betaflight.receiver": "sbus"}, "'receiver' must be one of msp, msp_override, not 'sbus'"),
    ("nodes", {"betaflight.min_cell_v": 35.0}, "must be from 0 to 4.4, not 35.0 .V per cell, not of the pack"),
    ("nodes", {"betaflight.min_cell_v": 4.3}, "the vehicle never arms"),
    ("nodes", {"betaflight.baud": "921k6"}, "'baud' must be a whole number, not '921k6'"),
    ("nodes", {"betaflight.lockstep_silence_s": 5.0}, "must be above 'patience_s' 5 s of the section 'bridge'"),
    ("nodes", {"betaflight.bauds": 9600}, "unknown key 'bauds'; known are port, baud"),
    ("nodes", {"race_monitor.time_limit_s": 1.0}, "'time_limit_s' 1 s is too short: 3 'laps' .* take 4.* s at"),
    ("nodes", {"vio.max_speed": 1.0}, "'time_limit_s' 60 s is too short: .* at 'max_speed' 1 m/s of the section 'vio'"),
    (
        "nodes",
        {"vio.max_speed": 3.0},
        "3 'laps' of track.yaml are at least 194 m, and take 64.7 s at 'max_speed' 3 m/s",
    ),
    ("nodes", {"race_monitor.nodes": ["camera", "race_monitor"]}, "would wait for its own topics"),
    (
        "camera",
        {"position": [0.6, 0.0, 0.2]},
        "'position' is 0.632 m from the middle of Swift 5-inch racer",
    ),
    ("track", {"laps": 500}, "'time_limit_s' 60 s is too short: 500 'laps'"),
    ("track", {"start": [-14.95, 4.5, 1.2]}, "'start' is 0.05 m from a wall, and Swift 5-inch racer reaches 0.18 m"),
    (
        "simulation",
        {"flight_controller.small_angle_deg": 0.0},
        "'small_angle_deg' must be from 1.0 to 180.0, not 0.0",
    ),
    ("simulation", {"imu.accel_bias": 70.0}, "'accel_bias' must be from 0.0 to 3.0, not 70.0 .m/s.2, of MEMS"),
    ("simulation", {"imu.gyro_bias": 5.0}, "'gyro_bias' must be from 0.0 to 1.0, not 5.0 .rad/s after calibration"),
    ("simulation", {"vio.scale": 0.9}, "'scale' must be from 0.0 to 0.3, not 0.9 .relative error"),
    ("simulation", {"attitude_estimate.tilt_deg": 45.0}, "'tilt_deg' must be from 0.0 to 20.0, not 45.0"),
    ("training", {"policy.rewards": {"progress": [0.0, 0.0]}}, "'rewards' are all 0, so nothing is learned"),
    ("drone", {"terms.accel_bias": {"bias": [0.0, 0.0, 45.0]}}, "'terms.accel_bias.bias.2.' is 45 m/s.2"),
    ("nodes", {"betaflight": None}, "lacks the section 'betaflight'"),
    ("nodes", {"race_monitor.nodes": ["camera", "viod"]}, "'nodes' must be one of .*, not 'viod'"),
    ("nodes", {"bridge.nodes": ["pilot"]}, "'nodes' must be one of .*, not 'pilot'"),
    ("nodes", {"gate_pose.samples": 0}, "'samples' must be from 4 to 200, not 0"),
    ("nodes", {"mavlink_telemetry.endpoint": "udpout:127.0.0.1:0"}, "give udpout:HOST:PORT"),
    ("nodes", {"recorder.topics": " , "}, "'topics' names none"),
    ("nodes", {"vio.source_position": [60.0, 0.0, 0.0]}, "'source_position' must be from -1.0 to 1.0"),
    ("nodes", {"camera.kind": "webcam"}, "'kind' must be one of"),
    ("nodes", {"camera.kind": "video", "camera.path": "nowhere.mp4"}, "names nowhere.mp4, which does not exist"),
    ("nodes", {"state_estimator.filter": "magic"}, "'filter' must be one of corners, drift, not 'magic'"),
    ("training", {"policy.ppo.discount": 1.2}, "'discount' must be from 0.0 to 0.99999, not 1.2"),
    ("training", {"policy.ppo.gae": [0.95, 1.8]}, "'gae' must be from 0.0 to 1.0, not 1.8"),
    ("training", {"policy.agents": 0}, "'agents' must be from 1"),
    (
        "training",
        {"policy.ppo.minibatch": 65536},
        "'ppo.minibatch' 65536 must divide .*, 256 x 128 = 32768; give 32768, or",
    ),
    ("training", {"policy.ppo.minibatch": 3000}, "give 2048, or another divisor"),
    (
        "training",
        {"policy.difficulty_from": 0.8},
        "'difficulty_from' 0.8 must be below 'difficulty_full' 0.5, both shares of the training; exchange them",
    ),
    ("training", {"policy.difficulty_from": 0.5}, "'difficulty_full' 0.5, .*; give a larger one"),
    (
        "training",
        {"policy.fine_tuning.critic_first": 20_000_000},
        "'critic_first' 20000000 must be less than 'interactions' 6000000, of which it is a part",
    ),
    ("training", {"policy.rewards.crash": [-2.0, -10.0]}, "'rewards.crash' must be 0 or more"),
    ("training", {"policy.environment.podium_share": 15.0}, "'podium_share' must be from 0.0 to 1.0"),
    ("training", {"policy.environment.bank_fixed": 200}, "'bank_fixed' 200 must be at most 'bank_size' 128"),
    ("training", {"detector.panorama.side": 385}, "multiples of 32"),
    ("training", {"detector.panorama.pixels_per_radian": 2.36}, "spans 163 rad, .* radian, not per degree"),
    ("training", {"detector.crop_px": 416}, "'crop_px' 416 must be at most 'panorama.side' 384"),
    ("training", {"detector.looks.gain": [1.5, 0.5]}, "'gain' must rise .*, not from 1.5 to 0.5; exchange them"),
    ("training", {"detector.warmup_steps": 20_000}, "'warmup_steps' 20000 must be at most 'steps' [0-9]+, of which"),
    ("training", {"detector.pool": 4}, "'batch' 8 must be at most 'pool' 4"),
    ("simulation", {"flight_controller.modes.ARM.low_us": 2100}, "the lower one first"),
    ("simulation", {"flight_controller.modes.ANGLE.aux": 1}, "section 'flight_controller': .* share AUX1"),
    ("simulation", {"flight_controller.modes.ARM": None}, "no switch turns ARM on"),
    ("simulation", {"flight_controller.modes.FAILSAFE.aux": 1}, "ranges of ARM and FAILSAFE overlap on AUX1"),
    (
        "simulation",
        {"flight_controller.modes.FAILSAFE": {"aux": 2, "low_us": 900, "high_us": 1750}},
        "ranges of ANGLE and FAILSAFE overlap on AUX2",
    ),
    (
        "simulation",
        {"flight_controller.channel_map": "AETT1234"},
        "'channel_map' must contain each of A, E, R, T, 1, 2, 3, 4 once",
    ),
    ("simulation", {"flight_controller.override_channels": "AETX"}, "letters of 'channel_map'"),
    ("simulation", {"flight_controller.mid_us": 1000}, "must rise in this order"),
    ("simulation", {"flight_controller.failsafe.delay_s": -0.5}, "'delay_s' must be from 0.0"),
    (
        "simulation",
        {"flight_controller.failsafe.delay_s": 5.0},
        "by 'failsafe.delay_s' 5 s the motors stop 5 s after the last command, .* allows 3 s; give a smaller "
        "'failsafe.delay_s', in s$",
    ),
    (
        "simulation",
        {"flight_controller.failsafe.procedure": "land", "flight_controller.failsafe.landing_s": 4.0},
        "'failsafe.landing_s' 4 s the motors stop 4.5 s .*, or the 'failsafe.procedure' drop$",
    ),
    ("simulation", {"flight_controller.motor_poles": 13}, "poles come in pairs"),
    ("simulation", {"renderer.families": ["plaid"]}, "'families' must be one of"),
    ("simulation", {"renderer.noise": [400.0, 1.0]}, "'noise' must be from 0.0 to 255.0"),
    ("simulation", {"imu.gyro_bias": -0.1}, "'gyro_bias' must be from 0.0"),
    ("simulation", {"vio.rate_memory_s": 0.0}, "'rate_memory_s' must be from 0.001"),
    ("drone", {"controller.super_rate": [0.0, 0.0, 0.0]}, "raise its rate profile under 'controller'"),
    ("drone", {"controller.rates_type": "linear"}, "rates_type 'linear' is not one of"),
    ("drone", {"controller.motor_idle": 110.0}, "'motor_idle' 110 must be a percentage"),
    (
        "drone",
        {"controller.motor_idle": 550},
        "below 100: 'dshot_idle_value' is in hundredths of a percent, 5.5 percent here",
    ),
    ("drone", {"controller.dterm_lpf1_static_hz": 20000}, "dterm_lpf1_static_hz is 20000, .* takes 0 to 1000"),
    ("drone", {"controller.pid.roll": [520, 40, 48]}, "p_roll is 520, and the firmware takes 0 to 250"),
    ("drone", {"controller.iterm_windup": 20}, "iterm_windup is 20, and the firmware takes 30 to 100"),
    ("drone", {"torque_coefficient": 1.116e-6}, "the blades would have more drag than lift"),
    (
        "drone",
        {
            "battery.reference_voltage": 4.0,
            "battery.open_circuit_full": 4.0,
            "battery.cells": 1,
            "battery.capacity": 900.0,
        },
        "of hover; check",
    ),
    (
        "drone",
        {"terms.rotor_drag.k_d": 0.02},
        "'terms.rotor_drag.k_d' is 0.02 .* vehicles of this size have 0 to 0.001",
    ),
    ("drone", {"terms.payload": {"mass": -0.5}}, "'terms.payload.mass' is -0.5 kg"),
    ("drone", {"terms.slung_load": {"mass": 0.03, "length": 200.0}}, "'length' of at most 100, in m"),
    ("drone", {"terms.damaged_propeller": {"rotor": 9, "loss": 0.1}}, "must name a 'rotor' from 1 to 4, not 9"),
    ("drone", {"terms.damaged_propeller": {"rotor": 1, "loss": 1.4}}, "'terms.damaged_propeller.loss' is 1.4"),
    ("drone", {"terms.rotor_dragg": {"k_d": 4e-5}}, "unknown term 'rotor_dragg'"),
]


@pytest.mark.parametrize(("kind", "changes", "sentence"), SETTINGS)
def test_a_wrong_setting_is_refused_by_one_sentence(folder, capsys, kind, changes, sentence):
    changed(folder, kind, changes)
    assert cli.main(["check", str(folder)]) == 1
    [line] = capsys.readouterr().out.splitlines()
    assert re.match(f"{folder}/[a-z]+.yaml: impossible: ", line) and re.search(sentence, line), line


def test_the_shipped_configuration_has_no_finding(capsys):
    assert cli.main(["check", str(CONFIG)]) == cli.main(["check", str(CONFIG / "vehicles")]) == 0
    assert capsys.readouterr().out.count("nothing is impossible or odd") == 2


def test_a_folder_is_checked_with_its_cameras_tracks_and_vehicles(folder, capsys):
    assert cli.main(["check", str(folder)]) == 0
    printed = capsys.readouterr().out
    for kind in ("cameras", "tracks", "vehicles"):
        names = [f"{kind}/{path.name}" for path in sorted((folder / kind).glob("*.yaml"))]
        assert names and ", ".join(names) in printed
    for name, old, new in (("crazyflie", "mass: 0.032 ", "mass: 32.0 "), ("blackbird", "1.8512e-6", "2.03e-8")):
        path = folder / "vehicles" / f"{name}.yaml"
        path.write_text(path.read_text().replace(old, new))
    assert cli.main(["check", str(folder)]) == 1
    first, second = capsys.readouterr().out.splitlines()
    assert first.startswith(f"{folder}/vehicles/blackbird.yaml: impossible: this vehicle cannot hover")
    assert second.startswith(f"{folder}/vehicles/crazyflie.yaml: impossible: this vehicle cannot hover")


def test_images_later_than_the_history_of_the_estimator_are_impossible(folder, capsys):
    changed(folder, "camera", {"processing_latency": 0.4})
    assert cli.main(["check", str(folder)]) == 0
    capsys.readouterr()
    changed(folder, "nodes", {"state_estimator.history_s": 0.4})
    assert cli.main(["check", str(folder)]) == 1
    assert "'history_s' 0.4 s is not above the 'processing_latency' 0.4 s of camera.yaml" in capsys.readouterr().out


def test_a_real_vehicle_whose_radio_keeps_the_switches_is_possible_and_not_simulated(folder, capsys):
    changed(folder, "nodes", {"betaflight.receiver": "msp_override", "betaflight.port": "/dev/ttyACM0"})
    assert cli.main(["check", str(folder)]) == 0
    assert "nodes.yaml has msp_override: simulated races are flown with the same in both" in capsys.readouterr().out


def test_a_small_vehicle_may_carry_the_camera_ahead(folder, capsys):
    changed(folder, "camera", {"position": [0.2, 0.0, 0.1]})
    assert cli.main(["check", str(folder)]) == 0
    assert "nothing is impossible or odd" in capsys.readouterr().out


def test_a_failsafe_may_share_a_channel_at_other_positions_of_the_switch(folder, capsys):
    changed(folder, "simulation", {"flight_controller.modes.FAILSAFE": {"aux": 1, "low_us": 900, "high_us": 1200}})
    assert cli.main(["check", str(folder)]) == 0
    assert "nothing is impossible or odd" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("start", "sentence"), [([-0.1, 1.15, 2.0], "touches the frame of gate 1"), ([-5.0, 4.5, 0.02], "above the ground")]
)
def test_a_podium_at_a_frame_or_in_the_ground_is_impossible(tmp_path, capsys, start, sentence):
    changed(tmp_path, "drone", {})
    changed(tmp_path, "track", {"start": start, "gates": gates(LEVEL)})
    assert cli.main(["check", str(tmp_path)]) == 1
    assert sentence in capsys.readouterr().out

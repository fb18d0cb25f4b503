"""The recording of a known flight with sensor errors, and the same errors in the simulator."""

import shutil
from dataclasses import replace
from types import SimpleNamespace

import jax
import numpy as np
import pytest
import yaml
from known_motion import motion, specific_force
from simulated_controller import sticks

from swift_ros import configuration, geometry
from swift_ros.recording.flight_checks import checked_table
from swift_ros.vehicle import GRAVITY, Vehicle
from swift_sim_bridge.seeds import generator
from swift_sim_bridge.sensors.recording import record, record_vio
from swift_sim_bridge.sensors.terms import sensor_terms
from swift_sim_bridge.sensors.vio import VioSettings
from swift_sim_bridge.simulation.simulated_vehicle import TICK_NS, SimulatedVehicle

FOLDER = configuration.configuration_folder()
SHIPPED = configuration.load(Vehicle, FOLDER / "drone.yaml")
T = np.arange(2500) * 0.002


def flight():
    """Return a trace of the known motion, its rotors and battery varying."""
    body, wave = motion(T), np.sin(3 * T)
    return SimpleNamespace(
        **body._asdict(),
        specific_force_body=specific_force(T),
        rotor_speed=1500.0 + 300.0 * wave[:, None] * [1, -1, 1, -1],
        motor_command=0.5 + 0.2 * wave[:, None] * [1, -1, 1, -1],
        voltage=15.5 + 0.5 * wave,
        current=40.0 + 10.0 * wave,
    )


def test_without_terms_and_noise_the_recording_is_the_truth():
    trace = flight()
    table = record(T, trace, replace(SHIPPED, terms={}, sensors={}), generator(1, "recording"))
    for channel, truth in (
        ("p_world", trace.p_world),
        ("gyro_body", trace.omega_body),
        ("specific_force_body", trace.specific_force_body),
        ("rotor_speed", trace.rotor_speed),
        ("voltage", trace.voltage),
    ):
        assert table[channel].values == pytest.approx(truth, abs=1e-12), channel
    assert table["motor_command"].t[1:] == pytest.approx(T[:-1])  # of the start of its sub-step


def test_a_recording_has_the_noise_of_its_sheet_and_the_errors_of_its_terms():
    sheet = {
        "position_m": 1e-3,
        "attitude_rad": 2e-3,
        "gyro_rad_s": 0.03,
        "accel_m_s2": 0.3,
        "vibration_m_s2": 0.4,
        "rotor_relative": 5e-3,
        "vbat_v": 0.02,
        "ibat_a": 0.5,
        "velocity_m_s": 0.01,
    }
    terms = {"gyro_bias": {"bias": [0.1, -0.1, 0.05]}, "marker_offset": {"position": [0.03, 0.0, 0.01]}}
    trace = flight()
    table = record(T, trace, replace(SHIPPED, terms=terms, sensors=sheet), generator(2, "recording"))
    off = table["gyro_body"].values - trace.omega_body
    assert off.mean(axis=0) == pytest.approx([0.1, -0.1, 0.05], abs=0.003) and off.std(axis=0).max() < 0.032
    assert (table["specific_force_body"].values - trace.specific_force_body).std() == pytest.approx(0.5, rel=0.03)
    assert (table["rotor_speed"].values / trace.rotor_speed - 1).std() == pytest.approx(5e-3, rel=0.03)
    offset = geometry.rotate(trace.q_world_body, np.broadcast_to([0.03, 0.0, 0.01], (len(T), 3)))
    assert (table["p_world"].values - trace.p_world - offset).std() == pytest.approx(1e-3, rel=0.03)
    checked = checked_table("known", table.channels)
    assert not checked.rejections and set(checked.channels) == set(table.channels)


def test_a_delayed_vio_is_recorded_with_its_delay():
    settings = configuration.load_section(VioSettings, FOLDER / "simulation.yaml", "vio")
    zero = dict.fromkeys(("walk", "rate_share", "scale", "position_noise", "tilt_deg", "yaw_walk_deg"), 0.0)
    terms = sensor_terms(replace(SHIPPED, terms={"vio_latency": {"delay": 0.03}}))
    t = np.arange(300) * 0.01
    channels = record_vio(t, motion(t), replace(settings, **zero), terms, generator(3, "vio"))
    assert channels["p_vio"].values[3:] == pytest.approx(motion(t - 0.03).p_world[3:], abs=1e-3)


# In the simulator.


@pytest.fixture(scope="module", autouse=True)
def double_precision():
    before = jax.config.jax_enable_x64
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", before)


TERMS = {
    "gyro_bias": {"bias": [0.2, -0.1, 0.3]},
    "gyro_scale": {"scale": [0.1, 0.0, 0.0]},
    "imu_lever_arm": {"position": [0.02, 0.0, 0.0]},
    "imu_clipping": {"gyro": 30.0, "accel": 9.0},
    "imu_bandwidth": {"accel_hz": 100.0},
    "marker_offset": {"position": [0.1, 0.0, 0.0]},
    "time_offset": {"delay": 0.02},
    "vio_latency": {"delay": 0.03},
    "processing_latency": {"delay": 0.05},
    "gate_displaced": {"gates": {1: {"position": [0.3, 0.0, 0.0]}}},
}


@pytest.fixture(scope="module")
def vehicle(tmp_path_factory):
    folder = tmp_path_factory.mktemp("config")
    for name in ("track.yaml", "simulation.yaml"):
        shutil.copy(FOLDER / name, folder)
    content = configuration.read_yaml(FOLDER / "drone.yaml")
    content["terms"] |= TERMS
    (folder / "drone.yaml").write_text(yaml.safe_dump(content))
    return SimulatedVehicle(folder, 1000)


def test_the_simulated_vehicle_has_the_sensor_errors_of_its_file(vehicle):
    rows = []
    for _ in range(200):
        rows.append(vehicle.sense(vehicle.tick * TICK_NS))
        vehicle.advance()
    last = rows[-1]
    gyro = np.mean([row.gyro for row in rows], axis=0)
    assert gyro == pytest.approx([0.2, -0.1, 0.3], abs=0.02)  # with the random bias of the flight
    assert max(row.specific_force_body[2] for row in rows) == 9.0 < GRAVITY
    offset = last.motion_capture.p_world - last.truth.p_world
    assert offset == pytest.approx(geometry.rotate(last.truth.q_world_body, np.array([0.1, 0.0, 0.0])), abs=1e-6)
    displaced = vehicle.track.positions - configuration.load(type(vehicle.track), FOLDER / "track.yaml").positions
    assert displaced[0] == pytest.approx([0.3, 0.0, 0.0]) and not displaced[1:].any()


def test_the_flight_controller_controls_the_measured_rate(vehicle):
    """It holds the gyro's reading at the setpoint, which has a scale error of 10 % and a bias, not the true rate."""
    rates = []
    while vehicle.tick < 600:
        armed = {"arm": 2000} if vehicle.tick > 520 else {}
        rolling = {"throttle": 1600, "roll": 1750} if vehicle.tick > 540 else {}
        vehicle.flight_controller.feed(sticks(**armed, **rolling))
        vehicle.advance()
        rates.append(vehicle.sense(vehicle.tick * TICK_NS).truth.omega_body[0])
    setpoint = np.radians(200 * 1.2 * 0.5 / (1 - 0.6 * 0.5))  # half a stick by the vehicle file's rates
    assert np.mean(rates[-10:]) == pytest.approx((setpoint - 0.2) / 1.1, rel=0.03)

"""Errors of sensors: each is planted in a known motion and recovered; a coefficient of zero changes nothing."""

from dataclasses import replace

import numpy as np
import pytest
from known_motion import imu_truth, motion

from swift_ros import configuration, geometry
from swift_ros.errors import UsageError
from swift_ros.track import Track
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.physics.state import parameters_from_vehicle
from swift_sim_bridge.seeds import generator
from swift_sim_bridge.sensors import imu_errors
from swift_sim_bridge.sensors.clock import History, Moving, moving_at, pose_delay
from swift_sim_bridge.sensors.imu_errors import ImuMemory, distort
from swift_sim_bridge.sensors.motion_capture import MotionCapture, captured, odometry
from swift_sim_bridge.sensors.terms import SENSOR_TERMS, sensor_terms
from swift_sim_bridge.sensors.vio import Vio, VioSettings
from swift_sim_bridge.sensors.world import flown_track

FOLDER = configuration.configuration_folder()
SHIPPED = configuration.load(Vehicle, FOLDER / "drone.yaml")
EFFECTS = {
    *("gyro_bias", "gyro_scale", "imu_lever_arm", "marker_offset", "accel_bias", "accel_scale", "time_offset"),
    *("clock_drift", "frame_misalignment", "vio_scale", "vio_drift", "camera_extrinsic", "camera_focal"),
    *("rolling_shutter", "corner_noise", "processing_latency", "gate_displaced", "map_scale", "map_tilt"),
}


def terms(**entries):
    return sensor_terms(replace(SHIPPED, terms=entries))


def rng():
    return generator(1, "test")


def solve(columns, values):
    return np.linalg.lstsq(columns, values, rcond=None)[0]


# The registry.


def test_every_sensor_effect_is_a_term_and_the_error_of_a_misspelt_one_lists_all_names():
    assert set(SENSOR_TERMS) >= EFFECTS
    with pytest.raises(UsageError, match="'gyro_bais'.*rotor_drag.*gyro_bias.*map_scale"):
        parameters_from_vehicle(replace(SHIPPED, terms={"gyro_bais": {"bias": [0, 0, 0]}}))
    with pytest.raises(UsageError, match="terms.gyro_bias has the unknown key 'offset'; known are bias"):
        terms(gyro_bias={"offset": [0, 0, 0]})
    with pytest.raises(UsageError, match="terms.time_offset: 'delay' must lie between"):
        terms(time_offset={"delay": 2.0})


def test_sensor_terms_do_not_change_the_physics():
    with_terms = parameters_from_vehicle(replace(SHIPPED, terms={**SHIPPED.terms, "gyro_bias": {"bias": [1, 0, 0]}}))
    assert with_terms.terms.keys() == parameters_from_vehicle(SHIPPED).terms.keys()


# The IMU.


def test_bias_scale_misalignment_and_g_sensitivity_are_recovered_together():
    truth = imu_truth()
    planted = terms(
        gyro_bias={"bias": [0.02, -0.01, 0.03]},
        gyro_scale={"scale": [0.01, -0.02, 0.015]},
        gyro_misalignment={"cross": [0.01, 0.02, -0.01, 0.005, -0.02, 0.015]},
        gyro_g_sensitivity={"gain": [1e-3, -5e-4, 2e-3]},
        accel_bias={"bias": [0.3, -0.2, 0.1]},
        accel_scale={"scale": [0.02, 0.01, -0.01]},
        accel_misalignment={"cross": [0.01, -0.02, 0.03, 0.01, 0.02, -0.01]},
    )
    gyro, accel, _ = distort(truth, planted, rng())
    ones = np.ones((len(gyro), 1))
    of_accel = solve(np.hstack([truth.specific_force_body, ones]), accel)
    gain, bias = of_accel[:3].T, of_accel[3]
    assert gain == pytest.approx(np.array([[1.02, 0.01, -0.02], [0.03, 1.01, 0.01], [0.02, -0.01, 0.99]]))
    assert bias == pytest.approx([0.3, -0.2, 0.1])
    expected = np.array([[1.01, 0.01, 0.02], [-0.01, 0.98, 0.005], [-0.02, 0.015, 1.015]])
    for axis, (bias, gain) in enumerate(((0.02, 1e-3), (-0.01, -5e-4), (0.03, 2e-3))):
        columns = np.hstack([truth.omega_body, ones, truth.specific_force_body[:, axis, None]])
        assert solve(columns, gyro[:, axis]) == pytest.approx([*expected[axis], bias, gain])


def test_a_lever_arm_is_recovered_within_a_percent_in_the_sensor_s_noise():
    truth, arm = imu_truth(), np.array([0.02, -0.01, 0.015])
    _, accel, _ = distort(truth, terms(imu_lever_arm={"position": arm.tolist()}), rng())
    accel = accel + 0.3 * rng().standard_normal(accel.shape)
    omega = geometry.skew(truth.omega_body)
    columns = geometry.skew(truth.alpha_body) + omega @ omega
    found = solve(columns.reshape(-1, 3), (accel - truth.specific_force_body).reshape(-1))
    assert np.linalg.norm(found - arm) < 0.01 * np.linalg.norm(arm)


def test_vibration_is_proportional_to_rotor_speed_and_an_unbalance_acts_once_per_revolution():
    noise = terms(imu_vibration={"accel": 5e-3, "gyro": 1e-4})
    for speed in (800.0, 2400.0):
        truth = imu_truth(rotor_speed=speed)
        gyro, accel, _ = distort(truth, noise, rng())
        assert (accel - truth.specific_force_body).std() == pytest.approx(5e-3 * speed, rel=0.02)
        assert (gyro - truth.omega_body).std() == pytest.approx(1e-4 * speed, rel=0.02)
    truth = imu_truth(dt=2.5e-4, seconds=2.0, rotor_speed=1500.0)
    truth = truth._replace(rotor_speed=truth.rotor_speed[:, :1])
    _, accel, _ = distort(truth, terms(imu_vibration={"unbalance": 1e-6}), rng())
    shaken = (accel - truth.specific_force_body)[:, 0]
    t = truth.dt * np.arange(1, len(shaken) + 1)
    line = solve(np.stack([np.cos(1500.0 * t), np.sin(1500.0 * t)], axis=1), shaken)
    assert np.linalg.norm(line) == pytest.approx(1e-6 * 1500.0**2, rel=0.01)


def test_clipped_samples_have_the_value_of_the_range_and_the_mean_is_biased():
    truth = imu_truth()
    gyro, accel, _ = distort(truth, terms(imu_clipping={"gyro": 4.0, "accel": 20.0}), rng())
    for seen, true, limit in ((gyro, truth.omega_body, 4.0), (accel, truth.specific_force_body, 20.0)):
        beyond = np.abs(true) > limit
        assert beyond.mean() > 0.02 and np.array_equal(seen[beyond], limit * np.sign(true[beyond]))
        assert np.array_equal(seen[~beyond], true[~beyond])


def test_the_bandwidth_is_the_specified_one_and_ticks_give_the_same_result_as_the_whole_flight():
    dt, hz = 1e-3, 80.0
    t = np.arange(4000) * dt
    for at, gain in ((hz, np.sqrt(0.5)), (8.0, 1.0)):
        tone = np.sin(2 * np.pi * at * t)[:, None]
        seen, _ = imu_errors.band_limit(tone, hz, dt)
        assert np.sqrt(2) * seen[2000:].std() == pytest.approx(gain, rel=2e-3)
    limited = terms(imu_bandwidth={"gyro_hz": 60.0, "accel_hz": 90.0}, imu_vibration={"unbalance": 1e-6})
    truth, memory, pieces = imu_truth(seconds=1.0), ImuMemory(), []
    for rows in range(0, 500, 5):
        piece = (field[rows : rows + 5] for field in truth[1:])
        gyro, accel, memory = distort(imu_errors.ImuTruth(truth.dt, *piece), limited, rng(), memory)
        pieces.append(np.hstack([gyro, accel]))
    assert np.concatenate(pieces) == pytest.approx(np.hstack(distort(truth, limited, rng())[:2]), abs=1e-9)
    with pytest.raises(UsageError, match="must be below 250 Hz"):
        distort(imu_truth(seconds=0.1), terms(imu_bandwidth={"gyro_hz": 300.0}), rng())


def test_imu_coefficients_of_zero_change_nothing():
    zero, truth = [0.0, 0.0, 0.0], imu_truth(seconds=1.0)
    nothing = terms(
        gyro_bias={"bias": zero},
        accel_scale={"scale": zero},
        gyro_misalignment={"cross": [0.0] * 6},
        gyro_g_sensitivity={"gain": zero},
        imu_lever_arm={"position": zero},
        imu_vibration={},
        imu_clipping={},
        imu_bandwidth={},
    )
    gyro, accel, _ = distort(truth, nothing, rng())
    assert np.array_equal(gyro, truth.omega_body) and np.array_equal(accel, truth.specific_force_body)


# Motion capture and clocks.


def test_offset_and_rotation_of_the_markers_are_recovered():
    t = np.arange(1000) * 0.01
    body, offset, turn = motion(t), np.array([0.02, -0.03, 0.01]), np.array([0.01, -0.02, 0.03])
    planted = terms(marker_offset={"position": offset.tolist()}, frame_misalignment={"rotation": turn.tolist()})
    seen = captured(body, planted)
    rotations = geometry.rotation_matrix(body.q_world_body)
    assert solve(rotations.reshape(-1, 3), (seen.p_world - body.p_world).reshape(-1)) == pytest.approx(offset)
    error = geometry.quaternion_multiply(geometry.quaternion_conjugate(body.q_world_body), seen.q_world_body)
    assert geometry.rotation_vector_from_quaternion(error) == pytest.approx(np.broadcast_to(turn, (1000, 3)))
    by_difference = np.gradient(seen.p_world, t, axis=0)[1:-1]
    assert seen.v_world[1:-1] == pytest.approx(by_difference, abs=0.02)


def test_a_tilted_world_rotates_path_and_attitude_equally():
    t, rotation = np.arange(1000) * 0.01, [0.008, -0.005]
    body = motion(t)
    seen = captured(body, terms(map_tilt={"rotation": rotation}))
    turn = np.broadcast_to(geometry.quaternion_from_rotation_vector(np.array([*rotation, 0.0])), (1000, 4))
    assert geometry.rotate_inverse(turn, seen.p_world) == pytest.approx(body.p_world)
    assert geometry.rotate_inverse(turn, seen.v_world) == pytest.approx(body.v_world)
    v_body, v_seen = (geometry.rotate_inverse(one.q_world_body, one.v_world) for one in (body, seen))
    assert v_seen == pytest.approx(v_body) and seen.omega_body is body.omega_body


def delay_of(seen, t, guess=0.0):
    """Return the delay of positions (n, 3) stamped t (n,), by Gauss-Newton on the known motion."""
    for _ in range(6):
        known = motion(t - guess)
        guess -= np.sum((seen - known.p_world) * known.v_world) / np.sum(known.v_world**2)
    return guess


def test_offset_and_drift_of_a_clock_are_recovered_in_seconds_and_ppm():
    t = np.arange(12_000) * 0.01
    planted = terms(time_offset={"delay": 0.012}, clock_drift={"ppm": 80.0})
    seen = moving_at(t - pose_delay(t, planted), t, motion(t))
    windows = [slice(first, first + 500) for first in range(500, 11_500, 500)]
    delays = [delay_of(seen.p_world[window], t[window]) for window in windows]
    drift, offset = np.polyfit([t[window].mean() for window in windows], delays, 1)
    assert 1e6 * drift == pytest.approx(80.0, rel=0.01) and offset == pytest.approx(0.012, rel=0.01)


def test_the_past_between_ticks_is_interpolated_to_a_tenth_of_a_millimetre():
    t, history = np.arange(200) * 0.01, History()
    for stamp, *row in zip(t, *motion(t), strict=True):
        history.add(stamp, Moving(*row))
        for delay in (0.013, 0.0471, -0.004):
            then = motion(np.array([max(stamp - delay, 0.0)]))
            found = history.before(delay)
            assert np.linalg.norm(found.p_world - then.p_world[0]) < (1e-4 if delay > 0 else 2e-3)
            assert np.abs(found.q_world_body @ then.q_world_body[0]) > 1 - (1e-7 if delay > 0 else 1e-4)
    assert history.before(0.0).p_world is row[0]


def test_pose_coefficients_of_zero_change_nothing():
    t, zero = np.arange(300) * 0.01, [0.0, 0.0, 0.0]
    planted = terms(
        marker_offset={"position": zero},
        frame_misalignment={"rotation": zero},
        map_tilt={"rotation": zero[:2]},
        time_offset={"delay": 0.0},
        clock_drift={"ppm": 0.0},
    )
    seen = captured(moving_at(t - pose_delay(t, planted), t, motion(t)), planted)
    for found, true in zip(seen, motion(t), strict=True):
        assert found == pytest.approx(true, abs=1e-14)


def test_motion_capture_without_errors_is_the_truth_and_with_noise_has_the_noise_of_the_sheet():
    history, body = History(), Moving(*(field[0] for field in motion(np.zeros(1))))
    history.add(0.0, body)
    truth = odometry(0, body)
    assert MotionCapture({}, SHIPPED.sensors, rng()).measure(truth, 0.0, history) is truth
    noisy = MotionCapture({}, {"position_m": 1e-3, "attitude_rad": 2e-3}, rng())
    seen = [noisy.measure(truth, 0.0, history) for _ in range(2000)]
    assert np.std([s.p_world - body.p_world for s in seen]) == pytest.approx(1e-3, rel=0.05)
    angles = [2 * np.arccos(min(1.0, abs(s.q_world_body @ body.q_world_body))) for s in seen]
    assert np.sqrt(np.mean(np.square(angles)) / 3) == pytest.approx(2e-3, rel=0.05)


# VIO and the map.

MEMORIES = {"rate_memory_s": 1.0, "velocity_memory_s": 1.0, "tilt_memory_s": 1.0, "rotation_ref": 1e9}
SILENT = VioSettings(**dict.fromkeys(VioSettings.__dataclass_fields__, 0.0) | MEMORIES)


def see(planted, settings=SILENT, turning=None, seconds=5.0):
    """Return the true motion and the output of a VIO with these terms at 100 Hz."""
    t = np.arange(round(100 * seconds)) * 0.01
    body, vio = motion(t), Vio(settings, rng(), planted)
    if turning is not None:
        body = body._replace(omega_body=np.broadcast_to([0.0, turning, 0.0], body.omega_body.shape))
    rows = [vio.measure(round(1e9 * stamp), *row) for stamp, *row in zip(t, *body, strict=True)]
    return body, np.stack([row.p_world for row in rows]), np.stack([row.v_body for row in rows])


def test_vio_scale_and_drift_are_recovered_from_position_and_velocity():
    body, p_vio, v_vio = see(terms(vio_scale={"scale": 0.03}))
    travelled = (body.p_world - body.p_world[0]).reshape(-1, 1)
    assert solve(travelled, (p_vio - p_vio[0]).reshape(-1)) == pytest.approx([1.03])
    assert np.linalg.norm(v_vio, axis=1) == pytest.approx(1.03 * np.linalg.norm(body.v_world, axis=1))
    body, p_vio, _ = see(terms(vio_drift={"share": [0.01, -0.005, 0.002]}))
    heading = geometry.quaternion_from_yaw(geometry.yaw_of(body.q_world_body))
    drift = np.diff(p_vio - body.p_world, axis=0) / 0.01
    in_heading = geometry.rotate_inverse(heading[1:], drift)
    speed = np.linalg.norm(body.v_world, axis=1)[1:, None]
    assert solve(speed, in_heading)[0] == pytest.approx([0.01, -0.005, 0.002])


def test_vio_coefficients_of_zero_change_nothing():
    settings = configuration.load_section(VioSettings, FOLDER / "simulation.yaml", "vio")
    zero = terms(vio_scale={"scale": 0.0}, vio_drift={"share": [0.0, 0.0, 0.0]})
    (_, *found), (_, *shipped) = (see(entries, settings, seconds=1.0) for entries in (zero, {}))
    assert np.array_equal(found, shipped)


def test_motion_blur_increases_the_drift_of_vio_with_rotation_as_specified():
    walking = replace(SILENT, walk=0.03)
    planted = terms(vio_blur={"rate_ref": 2.0, "power": 2.0})

    def drift(turning, entries):
        body, p_vio, _ = see(entries, walking, turning, seconds=1.0)
        return np.linalg.norm((p_vio - body.p_world)[-1])

    assert drift(10.0, planted) / drift(10.0, {}) == pytest.approx(np.sqrt(1 + 5.0**2), rel=1e-3)
    assert drift(0.0, planted) == drift(0.0, {})


def test_displaced_gates_and_a_wrong_scale_of_the_map_move_the_gates():
    track = configuration.load(Track, FOLDER / "track.yaml")
    assert flown_track(track, {}) is track
    flown = flown_track(track, terms(gate_displaced={"gates": {3: {"position": [0.2, -0.1, 0.05], "yaw": 0.1}}}))
    moved = flown.positions - track.positions
    assert moved[2] == pytest.approx([0.2, -0.1, 0.05]) and np.count_nonzero(moved) == 3
    assert flown.yaws - track.yaws == pytest.approx(np.eye(len(track.gates))[2] * 0.1)
    stretched = flown_track(track, terms(map_scale={"scale": 0.015}))
    away = (track.positions - track.start).reshape(-1, 1)
    assert solve(away, (stretched.positions - track.positions).reshape(-1)) == pytest.approx([0.015])
    assert stretched.inner_side == track.inner_side
    with pytest.raises(UsageError, match="names gate 9"):
        flown_track(track, terms(gate_displaced={"gates": {9: {}}}))

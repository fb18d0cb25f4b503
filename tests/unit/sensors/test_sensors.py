"""Simulated sensors have the errors of their constants, start aligned, and are reproducible by seed."""

import numpy as np
import pytest

from swift_ros import configuration, geometry
from swift_sim_bridge.seeds import generator
from swift_sim_bridge.sensors import AttitudeEstimate, AttitudeSettings, Imu, ImuSettings, Vio, VioSettings

STEP_NS = 20_000_000  # half the simulator's rate: the model does not depend on it
LAP_S, SPEED, TURNING = 5.65, 13.0, 3.0  # a lap of 73.5 m as it is raced, with the mean body rate of the fastest one
PATH = configuration.configuration_folder() / "simulation.yaml"


def settings(record_type, section):
    return configuration.load_section(record_type, PATH, section)


def race(laps=3):
    """Yield stamp, position, attitude, velocity and body rate along an inclined circle flown at racing speed."""
    radius = SPEED * LAP_S / (2 * np.pi)
    tilt = geometry.quaternion_from_rotation_vector(np.array([0.25, 0.0, 0.0]))
    for k in range(round(laps * LAP_S * 50)):
        angle = 2 * np.pi * k * 0.02 / LAP_S
        around = np.array([np.cos(angle), np.sin(angle), 0.0])
        along = np.array([-np.sin(angle), np.cos(angle), 0.0])
        q = geometry.quaternion_multiply(tilt, geometry.quaternion_from_yaw(np.array(angle)))
        yield k * STEP_NS, geometry.rotate(tilt, radius * around), q, geometry.rotate(tilt, SPEED * along), TURNING


def fly(seed, laps=3):
    """Return (position errors (n, 3), velocity errors (n,), attitude errors (n,) rad) of a race."""
    vio = Vio(settings(VioSettings, "vio"), generator(seed, "vio"))
    position, velocity, attitude = [], [], []
    for stamp_ns, p, q, v, turning in race(laps):
        seen = vio.measure(stamp_ns, p, q, v, np.array([0.0, 0.0, turning]))
        position.append(seen.p_world - p)
        velocity.append(np.linalg.norm(seen.v_body - geometry.rotate_inverse(q, v)))
        error = geometry.quaternion_multiply(geometry.quaternion_conjugate(q), seen.q_world_body)
        attitude.append(np.linalg.norm(geometry.rotation_vector_from_quaternion(error)))
    return np.array(position), np.array(velocity), np.array(attitude)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.fixture(scope="module")
def flights():
    return [fly(seed) for seed in range(1000, 1012)]


def test_vio_drifts_by_half_a_metre_to_one_and_a_half_over_a_race(flights):
    errors = [rms(np.linalg.norm(position, axis=1)) for position, _, _ in flights]
    assert 0.5 < np.median(errors) < 1.5
    assert np.mean([0.4 < error < 1.8 for error in errors]) > 0.8


def test_vio_drifts_by_about_one_percent_of_a_lap(flights):
    lap = round(50 * LAP_S) - 1
    drifts = [np.linalg.norm(p[start + lap] - p[start]) for p, _, _ in flights for start in (0, lap, 2 * lap)]
    assert 0.008 < rms(drifts) / (SPEED * LAP_S) < 0.02


def test_errors_of_vio_velocity_and_attitude_are_as_measured_on_prototypes(flights):
    assert 0.15 < rms([rms(velocity) for _, velocity, _ in flights]) < 0.4
    assert 0.4 < np.degrees(rms([rms(attitude) for _, _, attitude in flights])) < 1.5


def test_vio_starts_aligned_and_never_jumps(flights):
    for position, _, attitude in flights:
        assert np.linalg.norm(position[0]) < 0.03 and attitude[0] < 1e-6
        assert np.max(np.linalg.norm(np.diff(position, axis=0), axis=1)) < 0.1  # 20 ms at 13 m/s are 0.26 m


def test_vio_at_rest_does_not_drift():
    vio = Vio(settings(VioSettings, "vio"), generator(1, "vio"))
    p, q, zero = np.array([1.0, 2.0, 3.0]), np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3)
    seen = [vio.measure(k * STEP_NS, p, q, zero, zero) for k in range(1000)]
    assert max(np.linalg.norm(s.p_world - p) for s in seen) < 0.04  # noise alone


def test_drift_grows_with_rotation():
    def end(turning, seed):
        vio = Vio(settings(VioSettings, "vio"), generator(seed, "vio"))
        for stamp_ns, p, q, v, _ in race(laps=1):
            seen = vio.measure(stamp_ns, p, q, v, np.array([0.0, turning, 0.0]))
        return np.linalg.norm(seen.p_world - p)

    calm, wild = (rms([end(turning, seed) for seed in range(8)]) for turning in (0.0, 15.0))
    assert wild > 1.4 * calm


def test_the_same_seed_gives_the_same_measurements_and_another_does_not():
    first, again, other = (fly(seed, laps=0.2)[0] for seed in (7, 7, 8))
    assert np.array_equal(first, again) and not np.array_equal(first, other)
    assert generator(7, "vio").random() != generator(7, "imu").random()


def test_the_imu_has_a_bias_for_each_flight_and_noise_for_each_sample():
    truth = (np.array([0.5, -0.2, 1.0]), np.array([0.0, 0.0, 9.81]))
    imu = Imu(settings(ImuSettings, "imu"), 0.02, 0.3, generator(5, "imu"))
    gyro, accel = (np.array(rows) for rows in zip(*(imu.measure(*truth) for _ in range(4000)), strict=True))
    assert gyro.std(axis=0) == pytest.approx([0.02] * 3, rel=0.05)
    assert accel.std(axis=0) == pytest.approx([0.3] * 3, rel=0.05)
    assert np.all(np.abs(gyro.mean(axis=0) - truth[0]) < 4 * 0.005)
    assert np.any(np.abs(accel.mean(axis=0) - truth[1]) > 0.02)


def test_the_attitude_estimate_has_its_tilt_error_and_the_true_heading():
    estimate = AttitudeEstimate(settings(AttitudeSettings, "attitude_estimate"), generator(2, "attitude"))
    q = geometry.quaternion_from_yaw(np.array(1.0))
    seen = np.array([estimate.measure(q, 0.01) for _ in range(6000)])
    tilts = np.degrees(geometry.tilt_of(seen))
    assert 0.3 < rms(tilts) < 1.3
    assert np.max(np.abs(geometry.yaw_of(seen) - 1.0)) < 0.01

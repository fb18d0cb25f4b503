"""The velocity of the odometry, smoothed by the accelerometer: planted errors of both, and an IMU that is wrong."""

from dataclasses import replace

import numpy as np
import pytest

from swift_ros import geometry
from swift_ros.estimation.estimator import StateEstimator
from swift_ros.estimation.inertial_velocity import InertialVelocity
from swift_ros.estimation.settings import EstimatorSettings
from swift_ros.types import ImuSample, Odometry
from swift_ros.vehicle import GRAVITY
from tests.support.synthetic_flight import CAMERA, TRACK, Drift, odometry, race, settings

SETTINGS = settings("state_estimator", EstimatorSettings)
# Errors like those of the simulated source: slow ones of 1 % of the speed, and hardly any white noise.
DRIFT = Drift(rate_share=0.012, rate_memory_s=0.5, velocity_share=0.001, start_yaw_deg=0.0, yaw_walk_deg=0.0)


def specific_force() -> np.ndarray:
    """Return the true specific force (n, 3) m/s^2 of the race, body frame."""
    truth = race()
    acceleration = np.gradient(truth.v_map, 0.01, axis=0) + np.array([0.0, 0.0, GRAVITY])
    return geometry.rotate_inverse(truth.q_map_body, acceleration)


def accelerometer(bias=(0.1, -0.1, 0.05), noise: float = 0.1) -> list[ImuSample]:
    """Return samples with the stamps of the race's ticks."""
    truth, rng = race(), np.random.default_rng(5)
    forces = specific_force() + np.array(bias)
    forces += noise * rng.standard_normal(forces.shape)
    return [ImuSample(int(stamp), np.zeros(3), force) for stamp, force in zip(truth.stamps_ns, forces, strict=True)]


def flown(raw: list[Odometry], samples: list[ImuSample]) -> tuple[list[Odometry], list[bool]]:
    """Return odometry with smoothed velocities, and where they are inertial; each sample comes with its odometry."""
    core, by_stamp = InertialVelocity(SETTINGS), {sample.stamp_ns: sample for sample in samples}
    smoothed, inertial = [], []
    for each in raw:
        if each.stamp_ns in by_stamp:
            core.imu(by_stamp[each.stamp_ns])
        smoothed.append(core.add(each))
        inertial.append(core.is_inertial)
    return smoothed, inertial


def errors(states: list[Odometry]) -> np.ndarray:
    """Return the errors (n, 3) of the velocity in the body frame, m/s, while the vehicle flies."""
    truth = race()
    true = geometry.rotate_inverse(truth.q_map_body, truth.v_map)
    return (np.array([state.v_body for state in states]) - true)[np.linalg.norm(true, axis=1) > 1.0]


def rms(values) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_velocity_is_better_than_that_of_the_odometry(seed):
    """With a bias of the accelerometer and a tilt of the odometry of half a degree, which is 0.3 m/s^2 at 35 m/s^2."""
    raw = odometry(race(), DRIFT, seed)
    smoothed, inertial = flown(raw, accelerometer())
    assert np.mean(inertial) > 0.99
    assert rms(errors(smoothed)) < 0.9 * rms(errors(raw))
    changes, raw_changes = (rms(np.diff(errors(states)[::10], axis=0)) for states in (smoothed, raw))
    assert changes < 0.7 * raw_changes  # within 0.1 s: what a pilot feels


def turned(axis, degrees: float) -> np.ndarray:
    return geometry.rotation_matrix(geometry.quaternion_from_rotation_vector(np.radians(degrees) * np.array(axis)))


@pytest.mark.parametrize(
    "wrong",
    [
        pytest.param(turned([0.0, 0.0, 1.0], 90.0), id="forward is left"),
        pytest.param(-np.eye(3), id="upside down"),
        pytest.param(turned([1.0, 0.0, 0.0], 5.0), id="five degrees of roll"),
        pytest.param(1.05 * np.eye(3), id="a scale of 1.05"),
        pytest.param(np.eye(3) / GRAVITY, id="in units of g"),
    ],
)
def test_a_wrong_accelerometer_is_recognised_and_not_used(wrong):
    raw = odometry(race(), DRIFT, 1)
    samples = [replace(each, specific_force_body=wrong @ each.specific_force_body) for each in accelerometer()]
    smoothed, inertial = flown(raw, samples)
    assert np.mean(inertial[-400:]) < 0.1
    assert rms(errors(smoothed)[-400:]) < 1.1 * rms(errors(raw)[-400:])


def test_the_operator_gets_one_warning_of_a_wrong_accelerometer():
    core, warnings = StateEstimator(SETTINGS, TRACK, CAMERA, lockstep=True), []
    for each, sample in zip(odometry(race(), DRIFT, 1)[:300], accelerometer(), strict=False):
        core.imu(replace(sample, specific_force_body=sample.specific_force_body / GRAVITY))
        warnings += core.odometry(each).warnings
    assert [warning.split(";")[0] for warning in warnings] == [
        "the accelerometer does not agree with the odometry, whose velocity is now used without it"
    ]


def test_without_an_imu_nothing_changes():
    raw = odometry(race(), DRIFT, 1)
    smoothed, inertial = flown(raw, [])
    assert not any(inertial) and smoothed == raw


def test_an_imu_that_stops_and_comes_back():
    raw, samples = odometry(race(), DRIFT, 1), accelerometer()
    smoothed, inertial = flown(raw, samples[:200] + samples[300:])
    assert all(inertial[3:200]) and not any(inertial[206:301]) and all(inertial[305:])
    assert smoothed[250] == raw[250]
    assert rms(errors(smoothed)) < rms(errors(raw))


def test_a_sample_that_is_late_by_a_tick_changes_nothing():
    """The newest sample may come before or after the odometry of its stamp: the velocity does not depend on it."""
    raw, samples = odometry(race(), DRIFT, 1), accelerometer()
    smoothed, _ = flown(raw, samples)
    core = InertialVelocity(SETTINGS)
    for each, sample, expected in zip(raw, samples, smoothed, strict=True):
        assert core.add(each).v_body == pytest.approx(expected.v_body, abs=1e-12)
        core.imu(sample)


def test_a_faster_imu_gives_the_same_velocity():
    raw, samples = odometry(race(), DRIFT, 1), accelerometer(noise=0.0)
    smoothed, _ = flown(raw, samples)
    stamps = np.array([sample.stamp_ns for sample in samples])
    forces = np.array([sample.specific_force_body for sample in samples])
    fine = np.arange(0, stamps[-1] + 1, 2_000_000)
    at_fine = np.stack([np.interp(fine, stamps, axis) for axis in forces.T], axis=1)
    core, number, result = InertialVelocity(SETTINGS), 0, []
    for each in raw:
        while number < len(fine) and fine[number] <= each.stamp_ns:
            core.imu(ImuSample(int(fine[number]), np.zeros(3), at_fine[number]))
            number += 1
        result.append(core.add(each))
    assert rms(errors(result) - errors(smoothed)) < 0.1 * rms(errors(smoothed))


def test_samples_that_are_no_numbers_or_old_are_ignored():
    raw, samples = odometry(race(), DRIFT, 1), accelerometer()
    expected, _ = flown(raw, samples)
    core = InertialVelocity(SETTINGS)
    for each, sample, state in zip(raw, samples, expected, strict=True):
        core.imu(sample)
        core.imu(replace(sample, stamp_ns=sample.stamp_ns + 1, specific_force_body=np.array([np.nan, 0.0, 0.0])))
        core.imu(replace(sample, stamp_ns=sample.stamp_ns - 1, specific_force_body=np.full(3, 100.0)))
        assert np.array_equal(core.add(each).v_body, state.v_body)

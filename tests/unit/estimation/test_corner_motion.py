"""Velocity and path by the accelerometer: planted errors of it and of the odometry, and one that is wrong."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from swift_ros import geometry
from swift_ros.estimation.estimator import StateEstimator
from swift_ros.estimation.settings import EstimatorSettings
from swift_ros.types import ImuSample, Odometry
from swift_ros.vehicle import GRAVITY
from tests.support.synthetic_flight import CAMERA, TRACK, Detector, Drift, odometry, poses_seen, race, settings

TICK_NS, STEP_NS = 10_000_000, 1_000_000  # of the race, and of the fastest IMU
SETTINGS = settings("state_estimator", EstimatorSettings)
# Errors like those of the simulated source: slow ones of 1 % of the speed, and hardly any white noise.
DRIFT = Drift(rate_share=0.012, rate_memory_s=0.5, velocity_share=0.001, start_yaw_deg=0.0, yaw_walk_deg=0.0)
SEEDS = pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3))])


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


def flown(raw: list[Odometry], samples: list[ImuSample], after: int = 0) -> tuple[list[Odometry], list[str]]:
    """Return states and warnings of a flight without gates; a sample comes `after` ticks after its odometry."""
    core, by_stamp = StateEstimator(SETTINGS, TRACK, CAMERA, lockstep=True), {each.stamp_ns: each for each in samples}
    states, warnings = [], []
    for i, each in enumerate(raw):
        for stamp_ns in range(raw[i - 1].stamp_ns + STEP_NS if i else 0, each.stamp_ns + STEP_NS, STEP_NS):
            sample = by_stamp.get(stamp_ns - after * TICK_NS)
            if sample is not None:
                core.imu(sample)
        output = core.odometry(each)
        states += output.states
        warnings += output.warnings
    return states, warnings


def errors(states: list[Odometry]) -> np.ndarray:
    """Return the errors (n, 3) of the velocity in the body frame, m/s, while the vehicle flies."""
    truth = race()
    true = geometry.rotate_inverse(truth.q_map_body, truth.v_map)
    return (np.array([state.v_body for state in states]) - true)[np.linalg.norm(true, axis=1) > 1.0]


def rms(values) -> float:
    return float(np.sqrt(np.mean(values**2)))


def difference(states: list[Odometry], others: list[Odometry]) -> float:
    return max(float(np.abs(one.v_body - other.v_body).max()) for one, other in zip(states, others, strict=True))


@SEEDS
def test_the_velocity_is_better_than_that_of_the_odometry(seed):
    """With a bias of the accelerometer and a tilt of the odometry of half a degree, which is 0.3 m/s^2 at 35 m/s^2."""
    raw = odometry(race(), DRIFT, seed)
    states, warnings = flown(raw, accelerometer())
    assert not warnings
    assert rms(errors(states)) < 0.9 * rms(errors(raw))
    changes, raw_changes = (rms(np.diff(errors(each)[::10], axis=0)) for each in (states, raw))
    assert changes < 0.7 * raw_changes  # within 0.1 s: what a pilot feels


@SEEDS
def test_with_gates_velocity_and_position_are_better_than_without_an_accelerometer(seed):
    """Gates observe attitude and bias, with which the integral of the specific force would drift."""
    (with_imu, warnings), without = with_gates(seed, accelerometer()), with_gates_alone(seed)
    assert not warnings
    assert rms(errors(with_imu)) < 0.6 * rms(errors(without))
    assert rms(position_errors(with_imu)) < 0.9 * rms(position_errors(without))


def with_gates(seed: int, samples: list[ImuSample]) -> tuple[list[Odometry], list[str]]:
    """Return states and warnings of a flight with the gates of a good detector."""
    core = StateEstimator(SETTINGS, TRACK, CAMERA, lockstep=True)
    seen, states, warnings = poses_seen(Detector(outliers=0.0), seed), [], []
    for sample in samples:
        core.imu(sample)
    for i, each in enumerate(odometry(race(), DRIFT, seed)):
        outputs = [core.odometry(each)]
        if i in seen:
            outputs.append(core.gates(each.stamp_ns, seen[i]))
        for output in outputs:
            states += output.states
            warnings += output.warnings
    return states, warnings


@cache
def with_gates_alone(seed: int) -> list[Odometry]:
    return with_gates(seed, [])[0]


def position_errors(states: list[Odometry]) -> np.ndarray:
    """Return the errors (n, 3) of the position, m."""
    return np.array([each.p_world for each in states]) - race().p_map


def turned(axis, degrees: float) -> np.ndarray:
    return geometry.rotation_matrix(geometry.quaternion_from_rotation_vector(np.radians(degrees) * np.array(axis)))


@pytest.mark.parametrize(
    "wrong",
    [
        pytest.param(turned([0.0, 0.0, 1.0], 90.0), id="forward is left"),
        pytest.param(-np.eye(3), id="upside down", marks=pytest.mark.slow),
        pytest.param(turned([1.0, 0.0, 0.0], 5.0), id="five degrees of roll", marks=pytest.mark.slow),
        pytest.param(1.05 * np.eye(3), id="a scale of 1.05"),
        pytest.param(np.eye(3) / GRAVITY, id="in units of g"),
    ],
)
def test_a_wrong_accelerometer_is_recognised_and_not_used(wrong):
    samples = [replace(each, specific_force_body=wrong @ each.specific_force_body) for each in accelerometer()]
    states, warnings = with_gates(1, samples)
    without = with_gates_alone(1)
    assert [warning.split(";")[0] for warning in warnings] == [
        "the accelerometer does not agree with the odometry, whose velocity is now used without it"
    ]
    assert rms(errors(states)[-400:]) < 1.1 * rms(errors(without)[-400:])
    # Axes that are 90 degrees off are recognised after 1.6 s of this flight, in which the position goes 0.4 m wrong.
    assert rms(position_errors(states)[-400:]) < 1.2 * rms(position_errors(without)[-400:])


def test_without_an_imu_the_velocity_is_that_of_the_odometry():
    raw = odometry(race(), DRIFT, 1)
    states, warnings = flown(raw, [])
    assert not warnings
    assert difference(states, raw) < 1e-9


def test_an_imu_that_stops_and_comes_back():
    raw, samples = odometry(race(), DRIFT, 1), accelerometer()
    states, warnings = flown(raw, samples[:200] + samples[300:])
    assert not warnings
    everywhere, _ = flown(raw, samples)
    assert difference(states[:200], everywhere[:200]) == 0.0
    assert rms(errors(states)) < rms(errors(raw))


def test_a_blow_of_the_accelerometer_is_forgotten():
    """A touched gate: 16 g in one sample. The odometry's velocity takes over, and the accelerometer comes back."""
    raw, samples = odometry(race(), DRIFT, 1), accelerometer()
    hit = replace(samples[400], specific_force_body=np.array([-157.0, 157.0, 0.0]))
    states, _ = flown(raw, [*samples[:400], hit, *samples[401:]])
    untouched, _ = flown(raw, samples)
    assert max(np.linalg.norm(errors(states), axis=1)) < max(np.linalg.norm(errors(untouched), axis=1)) + 1.0
    assert difference(states[-100:], untouched[-100:]) < 0.15


def test_a_sample_that_is_late_by_a_tick_changes_nothing():
    """The newest sample may come before or after the odometry of its stamp: the velocity does not depend on it."""
    raw, samples = odometry(race(), DRIFT, 1), accelerometer()
    assert difference(flown(raw, samples)[0], flown(raw, samples, after=1)[0]) < 1e-12


def test_a_faster_imu_gives_the_same_velocity():
    raw, samples = odometry(race(), DRIFT, 1), accelerometer(noise=0.0)
    states, _ = flown(raw, samples)
    stamps = np.array([sample.stamp_ns for sample in samples])
    forces = np.array([sample.specific_force_body for sample in samples])
    fine = np.arange(0, stamps[-1] + 1, 2_000_000)
    at_fine = np.stack([np.interp(fine, stamps, axis) for axis in forces.T], axis=1)
    result, _ = flown(raw, [ImuSample(int(t), np.zeros(3), force) for t, force in zip(fine, at_fine, strict=True)])
    assert rms(errors(result) - errors(states)) < 0.1 * rms(errors(states))


def test_samples_that_are_no_numbers_or_old_are_ignored():
    raw, samples = odometry(race(), DRIFT, 1)[:300], accelerometer()[:300]
    expected, _ = flown(raw, samples)
    core, states = StateEstimator(SETTINGS, TRACK, CAMERA, lockstep=True), []
    for each, sample in zip(raw, samples, strict=True):
        core.imu(sample)
        core.imu(replace(sample, stamp_ns=sample.stamp_ns + 1, specific_force_body=np.array([np.nan, 0.0, 0.0])))
        core.imu(replace(sample, stamp_ns=sample.stamp_ns - 1, specific_force_body=np.full(3, 100.0)))
        states += core.odometry(each).states
    assert difference(states, expected) == 0.0

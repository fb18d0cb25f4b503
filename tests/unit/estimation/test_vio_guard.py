"""The check of the odometry: frames are converted, invalid samples are refused with a sentence."""

from dataclasses import replace

import numpy as np
import pytest
from bad_odometry import bad_flight, checked, good_odometry, imu_samples
from synthetic_flight import race, settings

from swift_ros import geometry
from swift_ros.estimation.odometry_check.vio_guard import VioGuard, VioSettings, quaternion_from_rpy
from swift_ros.types import ImuSample, Odometry
from swift_ros.vehicle import GRAVITY

TRUTH = race(laps=1, at_rest_s=0.1)


def guard(**changes) -> VioGuard:
    return VioGuard(settings("vio", VioSettings, **changes))


def flight(first: int = 200, count: int = 200) -> list[Odometry]:
    return [TRUTH.odometry(i) for i in range(first, first + count)]


def moved(sample: Odometry, offset) -> Odometry:
    return replace(sample, p_world=sample.p_world + np.asarray(offset))


def test_a_valid_flight_passes_unchanged():
    core = guard()
    for i in range(len(TRUTH.p_map)):
        checked = core.check(TRUTH.odometry(i))
        assert not checked.warning
        assert np.allclose(checked.odometry.p_world, TRUTH.p_map[i])


@pytest.mark.parametrize("velocity_frame", ["body", "odom"])
@pytest.mark.parametrize("rate_frame", ["body", "odom"])
def test_any_declared_twist_frame_becomes_the_body_frame(velocity_frame, rate_frame):
    truth = flight()[50]
    raw = truth
    if velocity_frame == "odom":
        raw = replace(raw, v_body=geometry.rotate(truth.q_world_body, truth.v_body))
    if rate_frame == "odom":
        raw = replace(raw, omega_body=geometry.rotate(truth.q_world_body, truth.omega_body))
    odometry = guard(velocity_frame=velocity_frame, rate_frame=rate_frame).check(raw).odometry
    assert np.allclose(odometry.v_body, truth.v_body)
    assert np.allclose(odometry.omega_body, truth.omega_body)


def test_the_mount_of_the_sensor_is_compensated():
    """The odometry of a camera 10 cm ahead, pitched and yawed, is converted to that of the vehicle."""
    position, rpy = (0.1, 0.02, 0.05), (5.0, 20.0, -90.0)
    q_base_source = quaternion_from_rpy(np.radians(rpy))
    core = guard(source_position=position, source_rpy_deg=rpy)
    for truth in flight():
        v_source = geometry.rotate_inverse(q_base_source, truth.v_body + np.cross(truth.omega_body, position))
        raw = Odometry(
            truth.stamp_ns,
            truth.p_world + geometry.rotate(truth.q_world_body, np.array(position)),
            geometry.quaternion_multiply(truth.q_world_body, q_base_source),
            v_source,
            geometry.rotate_inverse(q_base_source, truth.omega_body),
        )
        odometry = core.check(raw).odometry
        assert np.allclose(odometry.p_world, truth.p_world)
        assert abs(odometry.q_world_body @ truth.q_world_body) > 1 - 1e-9
        assert np.allclose(odometry.v_body, truth.v_body)
        assert np.allclose(odometry.omega_body, truth.omega_body)


INVALID = {
    "a position that is not a number": (lambda s: moved(s, [np.nan, 0, 0]), "position is not a number"),
    "an infinite velocity": (lambda s: replace(s, v_body=np.array([np.inf, 0, 0])), "velocity is not a number"),
    "a rate that is not a number": (lambda s: replace(s, omega_body=np.full(3, np.nan)), "rate is not a number"),
    "a quaternion of zeros": (lambda s: replace(s, q_world_body=np.zeros(4)), "length 0.000 instead of 1"),
    "a long quaternion": (lambda s: replace(s, q_world_body=1.2 * s.q_world_body), "length 1.200 instead of 1"),
    "an earlier stamp": (lambda s: replace(s, stamp_ns=s.stamp_ns - 50_000_000), "stamps do not increase"),
    "the last stamp again": (lambda s: replace(s, stamp_ns=s.stamp_ns - 10_000_000), "stamps do not increase"),
    "an impossible speed": (lambda s: replace(s, v_body=np.array([80.0, 0, 0])), "reports 80.0 m/s"),
    "a jump": (lambda s: moved(s, [0, 0, 3]), "jumped to"),
    "a small jump": (lambda s: moved(s, [0.4, 0, 0]), "jumped to"),
    "a flip": (lambda s: replace(s, q_world_body=s.q_world_body[[3, 2, 1, 0]] * [1, -1, 1, -1]), "degrees of attitude"),
}


@pytest.mark.parametrize("name", INVALID)
def test_one_invalid_sample_is_refused_with_a_sentence_and_the_next_valid_one_passes(name):
    damage, sentence = INVALID[name]
    core, samples = guard(), flight()
    for i, sample in enumerate(samples):
        checked = core.check(damage(sample) if i == 60 else sample)
        if i == 60:
            assert checked.odometry is None
            assert sentence in checked.warning and checked.warning.count(".") <= 3
        else:
            assert checked.odometry is not None, checked.warning


def results_with_imu(given: list[Odometry]) -> list:
    core = guard()
    results = []
    for sample, imu in zip(given, imu_samples(TRUTH, seed=1), strict=True):
        core.imu(imu)
        results.append(core.check(sample))
    return results


def test_at_racing_speed_a_single_outlier_is_bridged_by_dead_reckoning():
    """Without a state for 50 ms the link fails safe, and in lockstep a tick without a state ends the race."""
    true = good_odometry(TRUTH, seed=1)
    for name in ("a small jump", "a position that is not a number"):
        result = results_with_imu([INVALID[name][0](s) if i == 250 else s for i, s in enumerate(true)])[250]
        assert result.odometry is None and result.bridge.stamp_ns == true[250].stamp_ns
        assert np.linalg.norm(result.bridge.p_world - true[250].p_world) < 0.1  # noise of the odometry, not the 0.4 m
        assert np.linalg.norm(result.bridge.v_body - true[250].v_body) < 0.3


def test_a_lasting_jump_is_bridged_for_three_samples_only():
    results = results_with_imu([moved(s, [3, 0, 0]) if i >= 250 else s for i, s in enumerate(good_odometry(TRUTH, 1))])
    assert [i for i, result in enumerate(results) if result.bridge is not None] == [250, 251, 252]


def test_a_source_after_a_permanent_jump_is_accepted_from_its_last_position():
    """At rest a source jumps by 5 m: it is refused for half a second, then accepted without the jump."""
    core = guard(recover_s=0.5)
    rest = replace(TRUTH.odometry(0), v_body=np.zeros(3), omega_body=np.zeros(3))
    results = []
    for i in range(120):
        sample = replace(rest, stamp_ns=i * 10_000_000)
        results.append(core.check(moved(sample, [3.0, -4.0, 0.0]) if i >= 30 else sample))
    refused = [i for i, result in enumerate(results) if result.odometry is None]
    assert refused == list(range(30, 80))
    assert "by dead reckoning, 5.00 m from its own position" in results[80].warning
    for result in results[80:]:
        assert np.allclose(result.odometry.p_world, rest.p_world)


def test_a_source_with_a_new_heading_continues_in_the_old_frame():
    """When the source restarts with another heading, the path continues from the last accepted pose."""
    core, samples = guard(recover_s=0.1), flight(count=120)
    turn, shift = geometry.quaternion_from_yaw(np.float64(1.2)), np.array([7.0, 1.0, 0.0])
    last = None
    for i, sample in enumerate(samples):
        if i >= 20:
            sample = replace(
                sample,
                p_world=geometry.rotate(turn, sample.p_world) + shift,
                q_world_body=geometry.quaternion_multiply(turn, sample.q_world_body),
            )
        result = core.check(sample).odometry
        if result is not None and i > 40:
            step = geometry.rotate_inverse(samples[i].q_world_body, samples[i].p_world - samples[i - 1].p_world)
            flown = geometry.rotate_inverse(result.q_world_body, result.p_world - last.p_world)
            assert np.allclose(flown, step, atol=1e-6)
        last = result
    assert last is not None


def test_after_a_gap_several_samples_must_agree():
    core, samples = guard(recover_s=0.2), flight()
    accepted = [i for i, sample in enumerate(samples) if not 20 <= i < 60 and core.check(sample).odometry is not None]
    assert accepted == [*range(20), *range(80, 200)]


def test_one_stamp_far_in_the_future_does_not_block_the_source():
    core, samples = guard(), flight()
    for i, sample in enumerate(samples):
        checked = core.check(replace(sample, stamp_ns=sample.stamp_ns + 3_600_000_000_000) if i == 60 else sample)
        assert (checked.odometry is None) == (i == 60)
        if i == 60:
            assert "comes after a gap" in checked.warning
        if i == 61:
            assert "agrees with its earlier samples" in checked.warning


def test_a_clock_set_forward_is_accepted_after_a_time():
    core, samples = guard(recover_s=0.3), flight()
    results = [
        core.check(replace(sample, stamp_ns=sample.stamp_ns + (3_600_000_000_000 if i >= 60 else 0)))
        for i, sample in enumerate(samples)
    ]
    assert [i for i, result in enumerate(results) if result.odometry is None] == list(range(60, 90))
    assert "accepted again after a gap of 3600.0 s" in results[90].warning
    assert np.allclose(results[90].odometry.p_world, samples[90].p_world)


def test_the_error_names_an_unknown_frame():
    with pytest.raises(ValueError, match="'velocity_frame' must be one of body, odom, not 'ned'"):
        guard(velocity_frame="ned")


@pytest.mark.parametrize("seed", [*range(10), *(pytest.param(n, marks=pytest.mark.slow) for n in range(10, 40))])
def test_odometry_that_fails_is_not_believed_and_the_true_one_is_found_again(seed):
    """Noise, jumps, ramps, frozen and replayed samples, in flight and at rest; the guard has the IMU."""
    flown = bad_flight(seed)
    check, lost_s = checked(flown, guard()), 0.01 * (flown.end - flown.begin) + 0.5
    assert not check.refused_good
    assert max(check.off_m.values(), default=0.0) < 0.5, flown.kind
    assert check.rejoined_s <= 0.5, flown.kind
    # where the frame has moved it continues at the position of the dead reckoning
    assert check.after_m < 0.5 + 0.5 * lost_s, flown.kind


def test_at_rest_noise_of_any_amplitude_is_not_believed():
    for seed, size in enumerate((1.0, 2.0, 5.0, 10.0, 20.0)):
        rng, core = np.random.default_rng(seed), guard()
        rest = Odometry(0, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), np.zeros(3))
        for i in range(300):
            sample = replace(rest, stamp_ns=i * 10_000_000)
            odometry = core.check(moved(sample, rng.uniform(-size, size, 3)) if 100 <= i < 200 else sample).odometry
            assert odometry is None or np.linalg.norm(odometry.p_world) < 0.1, (size, i)
        assert odometry is not None


def hard_take_off() -> tuple[list[Odometry], list[ImuSample]]:
    """Return odometry and IMU at 100 Hz: at rest, then in 30 ms to full thrust and 10 rad/s about two axes."""
    step, q, v, p, odometry, imu = 1e-3, np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), np.zeros(3), [], []
    for i in range(600):
        share = np.clip((i * step - 0.3) / 0.03, 0.0, 1.0) * np.cos(8.0 * max(i * step - 0.33, 0.0))
        omega, force = share * np.array([8.0, 6.0, 0.0]), np.array([0.0, 0.0, GRAVITY + 30.0 * abs(share)])
        if i % 10 == 0:
            stamp_ns = round(i * step * 1e9)
            odometry.append(Odometry(stamp_ns, p, q, geometry.rotate_inverse(q, v), omega))
            imu.append(ImuSample(stamp_ns, omega, force))
        acceleration = geometry.rotate(q, force) - [0.0, 0.0, GRAVITY]
        p, v = p + step * v, v + step * acceleration
        q = geometry.normalize(geometry.quaternion_multiply(q, geometry.quaternion_from_rotation_vector(step * omega)))
    return odometry, imu


@pytest.mark.parametrize("late", [0, 1, 2, 3])
def test_a_hard_take_off_is_believed_while_the_imu_is_late_and_a_jump_in_it_is_not(late):
    """A busy machine delivers samples of the IMU after odometry of the same stamp, in lockstep too."""
    odometry, imu = hard_take_off()
    turn = quaternion_from_rpy([0.0, np.radians(9.0), 0.0])
    jumps = {
        "none": lambda s: s,
        "attitude": lambda s: replace(s, q_world_body=geometry.quaternion_multiply(turn, s.q_world_body)),
        "position": lambda s: moved(s, [0.3, 0.0, 0.0]),
        "velocity": lambda s: replace(s, v_body=s.v_body + [0.0, 3.0, 0.0]),
    }
    for name, jump in jumps.items():
        core, refused = guard(), []
        for i, sample in enumerate(odometry):
            if i >= late:
                core.imu(imu[i - late])
            if core.check(jump(sample) if i == 40 else sample).odometry is None:
                refused.append(i)
        assert refused == ([] if name == "none" else [40]), name

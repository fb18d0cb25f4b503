"""The errors of the state estimate in flight: planted ones are recovered, from arrays and from a bag."""

import numpy as np
import pytest
from rclpy.serialization import serialize_message

from swift_ros import geometry
from swift_ros.errors import UsageError
from swift_ros.graph.topic_table import TOPICS, full_name
from swift_ros.messages.motion import to_odometry
from swift_ros.recording.bag_writer import BagWriter
from swift_ros.recording.comparison import STATE, TRUTH
from swift_ros.types import Odometry
from swift_sim_bridge.benchmarks import estimate_errors

DEVIATIONS = np.array([0.05] * 3 + [0.2] * 3 + [0.004] * 2 + [0.01])  # m, m/s, rad
MEMORIES_S = np.array([0.1] * 3 + [0.4] * 3 + [0.2] * 2 + [0.8])


def planted(seed: int, seconds: float) -> np.ndarray:
    """Return errors (n, 9) with DEVIATIONS and MEMORIES_S."""
    rng = np.random.default_rng(seed)
    keep = np.exp(-estimate_errors.TICK_S / MEMORIES_S)
    rows = [DEVIATIONS * rng.standard_normal(9)]
    for _ in range(int(seconds / estimate_errors.TICK_S)):
        rows.append(keep * rows[-1] + np.sqrt(1 - keep**2) * DEVIATIONS * rng.standard_normal(9))
    return np.array(rows)


def assert_recovered(found, rel: float) -> None:
    assert (found.position_m, found.velocity_m_s) == pytest.approx((0.05, 0.2), rel=rel)
    assert (found.tilt_rad, found.yaw_rad) == pytest.approx((0.004, 0.01), rel=rel)
    assert (found.position_s, found.velocity_s) == pytest.approx((0.1, 0.4), rel=2 * rel)
    assert (found.tilt_s, found.yaw_s) == pytest.approx((0.2, 0.8), rel=2 * rel)


def test_deviations_and_memories_are_recovered_from_several_flights():
    assert_recovered(estimate_errors.statistics([planted(seed, 100.0) for seed in range(5)]), rel=0.1)


def record(folder, errors, speed: float) -> None:
    """Write a bag of a vehicle that circles at `speed` m/s, with errors (n, 9) in its estimate."""
    writer = BagWriter(folder)
    for name in (TRUTH, STATE):
        writer.add_topic(full_name(name), TOPICS[name].type)
    for i, error in enumerate(errors):
        angle = speed * i * estimate_errors.TICK_S / 5.0  # radius 5 m
        p = 5.0 * np.array([np.cos(angle), np.sin(angle), 0.4])
        q = geometry.quaternion_from_yaw(np.array(angle + 0.5 * np.pi))
        v = np.array([speed, 0.0, 0.0])
        tilted = geometry.quaternion_multiply(q, geometry.quaternion_from_rotation_vector(np.append(error[6:8], 0.0)))
        turned = geometry.quaternion_multiply(geometry.quaternion_from_yaw(error[8:9])[0], tilted)
        seen = geometry.rotate_inverse(turned, geometry.rotate(q, v + error[3:6]))
        stamp_ns = round(i * estimate_errors.TICK_S * 1e9)
        for name, state in (
            (TRUTH, Odometry(stamp_ns, p, q, v, np.zeros(3))),
            (STATE, Odometry(stamp_ns, p + error[:3], turned, seen, np.zeros(3))),
        ):
            writer.write(full_name(name), serialize_message(to_odometry(state, "map")), stamp_ns)
    writer.close()


def test_errors_are_read_from_a_bag_in_their_frames(tmp_path):
    errors = planted(0, 20.0)
    record(tmp_path / "bag", errors, speed=8.0)
    found = estimate_errors.flight_errors(tmp_path / "bag")
    np.testing.assert_allclose(found, errors[: len(found)], atol=2e-4)


def test_a_bag_in_which_nothing_flies_is_refused(tmp_path):
    record(tmp_path / "bag", planted(0, 3.0), speed=0.0)
    with pytest.raises(UsageError, match="less than 2 s of flight"):
        estimate_errors.measure([tmp_path / "bag"])

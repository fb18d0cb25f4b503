"""The buffer of past odometry: interpolation, length and order."""

import numpy as np
import pytest

from swift_ros import geometry
from swift_ros.timeline import Timeline
from swift_ros.types import Odometry

MILLISECOND = 1_000_000


def circle(stamp_ns: int) -> Odometry:
    """Return the state on a circle of 5 m at 10 m/s, flown forwards."""
    angle = np.float64(2.0 * stamp_ns * 1e-9)
    position = 5.0 * np.array([np.cos(angle), np.sin(angle), 0.2])
    return Odometry(
        stamp_ns,
        position,
        geometry.quaternion_from_yaw(angle + np.pi / 2),
        np.array([10.0, 0.0, 0.0]),
        np.array([0.0, 0.0, 2.0]),
    )


def timeline_of_circle(length_s: float = 1.0, count: int = 50) -> Timeline:
    timeline = Timeline(length_s)
    for i in range(count):
        timeline.add(circle(10 * MILLISECOND * i))
    return timeline


def test_the_state_at_a_sampled_stamp_is_that_sample():
    assert np.array_equal(timeline_of_circle().at(120 * MILLISECOND).p_world, circle(120 * MILLISECOND).p_world)


@pytest.mark.parametrize("stamp_ms", [3, 121, 488])
def test_between_two_samples_the_error_of_the_pose_is_below_a_millimetre(stamp_ms):
    state, truth = timeline_of_circle().at(stamp_ms * MILLISECOND), circle(stamp_ms * MILLISECOND)
    assert state.stamp_ns == stamp_ms * MILLISECOND
    assert np.linalg.norm(state.p_world - truth.p_world) < 1e-3
    assert abs(state.q_world_body @ truth.q_world_body) > 1 - 1e-12


def test_attitudes_are_interpolated_along_the_shorter_arc():
    timeline = Timeline(1.0)
    here = np.zeros(3)
    timeline.add(Odometry(0, here, geometry.quaternion_from_yaw(np.float64(3.0)), here, here))
    timeline.add(Odometry(10, here, -geometry.quaternion_from_yaw(np.float64(-3.0)), here, here))
    assert abs(geometry.yaw_of(timeline.at(5).q_world_body)) == pytest.approx(np.pi, abs=1e-9)


def test_outside_of_the_buffer_there_is_no_state():
    timeline = timeline_of_circle(length_s=0.2)
    assert timeline.at(500 * MILLISECOND) is None, "the future"
    assert timeline.at(100 * MILLISECOND) is None, "older than the buffer"
    assert Timeline(1.0).at(0) is None


def test_stamps_that_do_not_increase_are_an_error():
    timeline = timeline_of_circle()
    with pytest.raises(ValueError, match="follows stamp 490000000"):
        timeline.add(circle(490 * MILLISECOND))

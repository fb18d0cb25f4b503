"""The space that braking takes: gates, floor, the volume's sides, and what lies below the place where it ends."""

import math

import numpy as np
import pytest
from link_story import UPRIGHT, VEHICLE

from swift_ros import geometry
from swift_ros.betaflight.braking_space import BrakingSpace, braking_way
from swift_ros.betaflight.failsafe import DRAG_PER_S, MAX_BRAKE_LEAN
from swift_ros.track import Gate, Track
from swift_ros.types import Odometry
from swift_ros.vehicle import GRAVITY


def track(*gates) -> Track:
    gates = gates or (Gate((100.0, 0.0, 2.0), 0.0),)
    return Track("one gate", gates, 1.5, 2.1, 0.1, (0.0, 0.0, 1.0), 0.0, 1, (-50.0, -50.0, 0.0), (50.0, 50.0, 12.0))


def state(position=(0.0, 0.0, 4.0), velocity=(14.0, 0.0, 0.0), q=UPRIGHT) -> Odometry:
    """A state with its velocity in the map, m/s."""
    v_body = geometry.rotate_inverse(q, np.array(velocity))
    return Odometry(0, np.array(position), q, v_body, np.zeros(3))


def clearance_m(*gates, **changes) -> float:
    return BrakingSpace(track(*gates), VEHICLE).clearance_m(state(**changes))


def test_the_way_is_as_long_as_the_lean_allows_and_holds_the_height():
    way = braking_way(state())
    shortest = 14.0**2 / 2 / (GRAVITY * math.tan(MAX_BRAKE_LEAN) + DRAG_PER_S * 14.0)
    assert shortest < way[-1, 0] < 15.0
    assert np.abs(way[:, 1]).max() < 1e-9 and np.abs(way[:, 2] - 4.0).max() < 0.5
    assert len(braking_way(state(velocity=(0.1, 0.0, 0.0)))) == 1  # slow already
    assert braking_way(state(), math.radians(30.0))[-1, 0] > way[-1, 0] + 2.0


def test_a_vehicle_on_its_side_is_carried_aside_before_it_brakes():
    left = geometry.quaternion_from_rotation_vector(np.array([math.radians(-80.0), 0.0, 0.0]))
    assert braking_way(state(q=left))[-1, 1] > 2.0


@pytest.mark.parametrize(
    ("gate", "expected"),
    [
        (Gate((8.0, 0.0, 4.0), 0.0), -0.2),  # an opening is no way
        (Gate((8.0, 0.9, 4.0), 0.0), -0.2),
        (Gate((8.0, 4.0, 4.0), 0.0), 2.7),  # beside
        (Gate((-3.0, 0.0, 4.0), 0.0), 2.7),  # behind
        (Gate((0.1, 0.0, 4.0), 0.0), -0.2),  # still in the gate of the finish
        (Gate((8.0, 0.0, 1.1), 0.0), 1.6),  # below the way
        (Gate((25.0, 0.0, 4.0), 0.0), 12.9),  # behind the place where it ends
    ],
)
def test_gates_in_the_way(gate, expected):
    assert clearance_m(gate) == pytest.approx(expected, abs=0.15)


def test_a_gate_below_the_end_of_the_way_is_in_the_way_of_the_descent():
    end = braking_way(state())[-1]
    assert clearance_m(Gate((float(end[0]), 0.5, 1.1), 0.0)) < 0.0
    assert clearance_m(Gate((float(end[0]) - 5.0, 0.5, 1.1), 0.0)) > 1.0


def test_floor_and_sides_of_the_flight_volume_are_in_the_way():
    assert clearance_m() > 1.0
    for position, velocity in (
        ((45.0, 0.0, 4.0), (14.0, 0.0, 0.0)),
        ((0.0, 0.0, 0.8), (10.0, 0.0, -4.0)),
        ((0.0, 0.0, 11.0), (10.0, 0.0, 6.0)),
    ):
        assert clearance_m(position=position, velocity=velocity) == -math.inf
    assert clearance_m(position=(0.0, 0.0, 3.0), velocity=(10.0, 0.0, -4.0)) > 1.0


def test_a_slow_vehicle_gains_nothing_by_flying_on():
    assert clearance_m(Gate((0.1, 0.0, 4.0), 0.0), velocity=(1.0, 0.0, 0.0)) == math.inf
    assert clearance_m(position=(0.0, 0.0, 0.05), velocity=(0.0, 0.0, 0.0)) == math.inf  # it lies on the ground

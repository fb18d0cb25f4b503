"""A finding is located at the time, in the flight regime and in the segment between two gates where it was planted."""

from types import SimpleNamespace

import numpy as np
import pytest

from swift_ros.track import Gate, Track
from swift_sim_bridge.gap.validation import flight_regimes

T = np.arange(0.0, 20.0, 0.02)
ANGLE = 0.5 * T  # along a circle of 5 m, counter-clockwise
PATH = np.stack([5.0 * np.cos(ANGLE), 5.0 * np.sin(ANGLE), 2.0 + 0.0 * T], axis=1)


def track() -> Track:
    """Return gates at the four quarters of the circle, in its direction."""
    gates = tuple(
        Gate(tuple(5.0 * np.array([np.cos(a), np.sin(a), 0.4])), yaw_deg=np.degrees(a) + 90.0)
        for a in np.radians([45.0, 135.0, 225.0, 315.0])
    )
    return Track("circle", gates, 1.5, 2.1, 0.1, (5.0, 0.0, 0.0), 90.0, 1, (-9, -9, 0), (9, 9, 9))


def test_a_temporary_finding_has_a_time_span_and_a_permanent_one_the_whole_flight():
    noise = np.random.default_rng(1).standard_normal(len(T))
    bump = np.where((T > 6.0) & (T < 9.0), 40.0, 0.0)
    ((begin, end),) = flight_regimes.spans(T, bump + noise)
    assert begin == pytest.approx(6.0, abs=0.5) and end == pytest.approx(9.0, abs=0.6)
    assert flight_regimes.spans(T, 40.0 + noise) == flight_regimes.spans(T, 0.0 * T) == [[T[0], T[-1]]]


def test_the_flight_regime_is_described_by_the_quantity_on_which_the_gain_depends():
    rng = np.random.default_rng(2)
    speed, height = (rng.permutation(np.linspace(low, high, len(T))) for low, high in ((0.0, 10.0), (1.0, 3.0)))
    known = {"speed": (speed, "m/s"), "height": (height, "m")}
    assert flight_regimes.regime(speed**4, known).startswith("most where the speed is above 8 m/s")
    assert flight_regimes.regime((height < 1.3) + 0.01, known).startswith("most where the height is below 1.4 m")
    assert flight_regimes.regime(1.0 + 0.1 * rng.standard_normal(len(T)), known) == ""


def test_time_spans_are_named_by_the_gates_between_which_they_lie():
    recording = SimpleNamespace(t=T, p_world=PATH, has=lambda name: name == "p_world")
    passed = flight_regimes.passages(recording, track())
    assert [gate for _, gate in passed] == [1, 2, 3, 4, 1, 2][: len(passed)] and len(passed) >= 6
    assert passed[1][0] == pytest.approx(np.radians(135.0) / 0.5, abs=0.03)
    assert flight_regimes.segments(passed, [[passed[1][0] + 0.2, passed[2][0] - 0.2]]) == ["gate 2 to gate 3"]
    assert flight_regimes.segments(passed, [[0.0, 20.0]]) == []
    many = [(float(t), gate) for t, gate in enumerate([1, 8, 9, 10, 11, 1])]
    assert flight_regimes.segments(many, [[1.1, 3.9]]) == [f"gate {gate} to gate {gate + 1}" for gate in (8, 9, 10)]

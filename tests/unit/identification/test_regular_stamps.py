"""Stamps that scatter about regular rows: the motion shows whether the samples were taken at them."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from swift_ros.recording.flight_table import FlightTable, Samples
from swift_sim_bridge.gap import api
from swift_sim_bridge.identification.regular_stamps import with_regular_stamps

ROW_S, SCATTER_S = 0.01, 6e-4
T = np.arange(3000) * ROW_S
MOTION = CubicSpline(T, np.array([4.0, 3.0, 0.5]) * np.sin(np.array([1.3, 1.7, 2.1]) * T[:, None] + [0.0, 1.0, 2.0]))


def scattered(t=T, scatter_s=SCATTER_S):
    """Return stamps that scatter about times (n,) s."""
    return t + scatter_s * np.random.default_rng(5).standard_normal(len(t))


def logged(stamps, taken_at, motion=MOTION) -> FlightTable:
    """Return a flight with a noise of half a millimetre, and a pack's voltage in rows of its own."""
    noise = 5e-4 * np.random.default_rng(6).standard_normal((len(taken_at), 3))
    commands = np.full((len(taken_at), 4), 0.5)
    return FlightTable(
        "flight",
        {
            "p_world": Samples(stamps, motion(taken_at) + noise),
            "motor_command": Samples(stamps, commands),
            "voltage": Samples(T[::10], np.full(len(T[::10]), 15.0)),
        },
    )


def error_s(table: FlightTable, taken_at) -> float:
    return float(np.std(table["p_world"].t - taken_at))


def test_samples_that_were_taken_regularly_get_regular_times():
    lines = []
    found = with_regular_stamps(logged(scattered(), T), lines.append)
    assert error_s(found, T) < 0.15 * SCATTER_S
    assert np.array_equal(found["motor_command"].t, found["p_world"].t)
    assert np.array_equal(found["voltage"].t, T[::10])
    (rejection,) = found.rejections
    assert rejection.channel == "stamps of p_world, motor_command" and "scatter by 0.6 ms" in rejection.reason
    assert len(lines) == 1 and "flight: stamps of p_world" in lines[0]


def test_samples_that_were_taken_at_their_stamps_keep_them():
    stamps = scattered()
    found = with_regular_stamps(logged(stamps, stamps), pytest.fail)
    assert np.array_equal(found["p_world"].t, stamps) and not found.rejections


def test_lost_rows_stay_lost_and_the_clock_may_drift():
    rng = np.random.default_rng(7)
    taken_at = T[(rng.random(len(T)) > 0.05) & ((T < 11.0) | (T > 11.3))]
    stamps = scattered(1.0001 * taken_at + 5e-3 * np.sin(0.2 * taken_at))
    found = with_regular_stamps(logged(stamps, taken_at), lambda _: None)
    clock = 1.0001 * taken_at + 5e-3 * np.sin(0.2 * taken_at)
    assert error_s(found, clock) < 0.3 * SCATTER_S
    assert found["p_world"].t.shape == taken_at.shape


def test_a_vehicle_that_does_not_move_keeps_its_stamps():
    stamps = scattered()
    still = with_regular_stamps(logged(stamps, T, lambda t: np.zeros((len(t), 3))), pytest.fail)
    assert np.array_equal(still["p_world"].t, stamps)


@pytest.mark.parametrize(
    "stamps", [T, scattered(scatter_s=0.002 * ROW_S), np.cumsum(np.random.default_rng(3).exponential(ROW_S, len(T)))]
)
def test_regular_stamps_and_rows_that_cannot_be_counted_stand(stamps):
    found = with_regular_stamps(logged(stamps, stamps, lambda t: MOTION(np.clip(t, T[0], T[-1]))), pytest.fail)
    assert np.array_equal(found["p_world"].t, stamps)


def test_few_rows_stand():
    few = slice(0, 150)
    found = with_regular_stamps(logged(scattered()[few], T[few]), pytest.fail)
    assert np.array_equal(found["p_world"].t, scattered()[few])


def test_the_gap_tool_reads_its_flights_with_regular_times(monkeypatch):
    read = []
    monkeypatch.setattr(api.single_flight, "diagnose", lambda flight, vehicle, options: read.append(flight))
    monkeypatch.setattr(
        api.unseen_flights, "predict", lambda diagnosis, vehicle, flights, progress: read.extend(flights)
    )
    monkeypatch.setattr(api, "without_covariance", lambda vehicle: vehicle)
    monkeypatch.setattr(api, "with_pid_gains", lambda vehicle: vehicle)
    flight = logged(scattered(), T)
    api.diagnose([flight], None, lambda _: None)
    api.predict_unseen(None, None, [flight], lambda _: None)
    assert len(read) == 2 and all(error_s(one, T) < 0.15 * SCATTER_S for one in read)

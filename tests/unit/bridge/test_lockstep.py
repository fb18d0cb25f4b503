"""Simulated time continues when everything that a tick causes has happened, and never waits forever."""

import pytest

from swift_sim_bridge.bridge.lockstep import Lockstep, Pace, has_image

MS = 1_000_000


@pytest.mark.parametrize(
    ("rate_hz", "first", "steps"), [(30.0, [4, 7, 10, 14], {3, 4}), (15.0, [7, 14, 20], {6, 7}), (100.0, [1, 2], {1})]
)
def test_images_are_taken_at_the_rate_of_the_camera_at_whole_ticks(rate_hz, first, steps):
    taken = [tick for tick in range(1001) if has_image(tick, rate_hz)]
    assert len(taken) == 10 * rate_hz and taken[: len(first)] == first
    assert {b - a for a, b in zip(taken, taken[1:], strict=False)} == steps


def test_a_tick_waits_for_its_own_answer_and_for_the_frames_that_the_link_has_written():
    lockstep = Lockstep(None, patience_s=5.0)
    lockstep.publish(10 * MS, 0.0)
    lockstep.take_link_report(0, 1)
    assert "betaflight/link" in lockstep.pending(frames_read=1).reasons[0]
    lockstep.take_link_report(10 * MS, 2)
    pending = lockstep.pending(frames_read=1)
    assert pending and pending.only_frames
    assert not lockstep.pending(frames_read=2)


def test_ticks_run_no_further_ahead_of_the_judge_than_its_announcements_allow():
    lockstep = Lockstep(judge_lead_ns=100 * MS, patience_s=5.0)
    lockstep.publish(100 * MS, 0.0)
    lockstep.take_link_report(100 * MS, 0)
    assert not lockstep.pending(0)
    lockstep.publish(110 * MS, 0.0)
    lockstep.take_link_report(110 * MS, 0)
    assert lockstep.pending(0).reasons == ("race/judged lags behind",)
    lockstep.take_judged_time(10 * MS)
    assert not lockstep.pending(0)


def test_the_patience_counts_from_the_last_tick():
    lockstep = Lockstep(None, patience_s=5.0)
    assert not lockstep.is_stuck(1e6)  # nothing was published yet
    lockstep.publish(0, 100.0)
    assert not lockstep.is_stuck(105.0) and lockstep.is_stuck(105.1)


def test_in_real_time_late_ticks_are_counted_and_caught_up():
    pace = Pace(begun_s=0.0)
    assert pace.wait_s(0.0) == 0.0
    pace.begin(0.0)
    assert pace.wait_s(0.004) == pytest.approx(0.006)
    pace.begin(0.0101)
    assert pace.late == 0
    caught_up = 0
    while pace.wait_s(0.065) <= 0:
        pace.begin(0.065)
        caught_up += 1
    assert caught_up == 5 and pace.late == 4  # due at 20, 30, 40, 50 and 60 ms


def test_frames_that_are_lost_on_the_serial_line_are_waited_for_once():
    lockstep = Lockstep(None, patience_s=5.0)
    lockstep.publish(10 * MS, 0.0)
    lockstep.take_link_report(10 * MS, 5)
    assert lockstep.pending(frames_read=3).only_frames
    assert lockstep.write_off(frames_read=3) == 2
    assert not lockstep.pending(frames_read=3)
    lockstep.publish(20 * MS, 0.1)
    lockstep.take_link_report(20 * MS, 6)
    assert lockstep.pending(frames_read=3).only_frames and not lockstep.pending(frames_read=4)


def test_without_patience_a_tick_waits_for_a_moment_only():
    lockstep = Lockstep(None, patience_s=5.0)
    lockstep.publish(0, 100.0)
    lockstep.lose_patience(7.0)  # of another clock
    assert not lockstep.is_stuck(7.02) and lockstep.is_stuck(7.04)

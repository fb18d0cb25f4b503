"""Simulated time goes on when everything that a tick causes has happened, and never waits for ever."""

import pytest

from swift_sim_bridge.bridge.lockstep import Lockstep, Pace, has_image

MS = 1_000_000


def test_images_come_thirty_times_a_second_at_whole_ticks():
    taken = [tick for tick in range(1001) if has_image(tick)]
    assert len(taken) == 300 and taken[:4] == [4, 7, 10, 14]
    assert {b - a for a, b in zip(taken, taken[1:], strict=False)} == {3, 4}


def test_a_tick_waits_for_its_own_answer_and_for_the_frames_that_the_link_has_written():
    lockstep = Lockstep(None, patience_s=5.0)
    lockstep.publish(10 * MS, 0.0)
    lockstep.hear_link(0, 1)
    assert "betaflight/link" in lockstep.owed(frames_read=1).what[0]
    lockstep.hear_link(10 * MS, 2)
    owed = lockstep.owed(frames_read=1)
    assert owed and owed.frames
    assert not lockstep.owed(frames_read=2)


def test_ticks_run_no_further_ahead_of_the_judge_than_its_announcements_allow():
    lockstep = Lockstep(judge_lead_ns=100 * MS, patience_s=5.0)
    lockstep.publish(100 * MS, 0.0)
    lockstep.hear_link(100 * MS, 0)
    assert not lockstep.owed(0)
    lockstep.publish(110 * MS, 0.0)
    lockstep.hear_link(110 * MS, 0)
    assert lockstep.owed(0).what == ("race/judged lags behind",)
    lockstep.hear_judge(10 * MS)
    assert not lockstep.owed(0)


def test_patience_ends_on_the_steady_clock():
    lockstep = Lockstep(None, patience_s=5.0)
    assert not lockstep.is_stuck(1e6)  # nothing was published yet
    lockstep.publish(0, 100.0)
    assert not lockstep.is_stuck(105.0) and lockstep.is_stuck(105.1)


def test_real_time_makes_up_for_what_was_late_and_counts_it():
    pace = Pace(begun_s=0.0)
    assert pace.wait_s(0.0) == 0.0
    pace.begin(0.0)
    assert pace.wait_s(0.004) == pytest.approx(0.006)
    pace.begin(0.0101)
    assert pace.late == 0
    made_up = 0
    while pace.wait_s(0.065) <= 0:
        pace.begin(0.065)
        made_up += 1
    assert made_up == 5 and pace.late == 4  # due at 20, 30, 40, 50 and 60 ms

"""Patience counts the stalls of the machine: overload does not use it up, a dead partner on an idle machine does."""

import pytest

from swift_ros.betaflight.watchdog import ClockReading, InputWatchdog
from swift_ros.working_time import WorkingTime
from swift_sim_bridge.bridge.lockstep import Lockstep

STEP_S = 0.25


class Machine:
    """A machine with a scripted steady clock and pressure file."""

    def __init__(self, folder):
        self.pressure = folder / "cpu"
        self.steady_s, self._waited_s = 1000.0, 500.0
        self.run(0.0)

    def run(self, seconds, waiting=0.0):
        """Let time pass; in the share `waiting` of it, tasks wait for a CPU."""
        self.steady_s += seconds
        self._waited_s += waiting * seconds
        text = f"some avg10=0.00 avg60=0.00 avg300=0.00 total={round(1e6 * self._waited_s)}\n"
        self.pressure.write_text(text + "full avg10=0.00 avg60=0.00 avg300=0.00 total=0\n")

    def clock(self):
        """Return a new clock of this machine."""
        return WorkingTime(self.pressure, lambda: self.steady_s)


@pytest.fixture
def machine(tmp_path):
    return Machine(tmp_path)


def worked_s(machine, clock, seconds, waiting=0.0):
    """Ask the clock periodically for a time; return by how much it advanced."""
    begun_s = clock.now_s()
    for _ in range(round(seconds / STEP_S)):
        machine.run(STEP_S, waiting)
        clock.now_s()
    return clock.now_s() - begun_s


def test_a_hundred_seconds_of_thirtyfold_overload_do_not_use_up_a_patience_of_eight(machine):
    clock = machine.clock()
    assert worked_s(machine, clock, 100.0, waiting=1.0) == pytest.approx(100 / 30)
    assert worked_s(machine, clock, 8.0) == pytest.approx(8.0)
    assert worked_s(machine, clock, 10.0, waiting=0.5) == pytest.approx(5.0)


def test_a_paused_machine_uses_up_half_a_second_at_most(machine):
    clock = machine.clock()
    machine.run(3600.0)
    assert clock.now_s() == 0.5


def test_without_pressure_stall_information_it_is_the_steady_clock(machine, tmp_path):
    machine.pressure = tmp_path / "none"
    clock = machine.clock()
    machine.run(0.3, waiting=1.0)
    assert clock.now_s() == pytest.approx(0.3)


def test_it_never_goes_backwards_and_reads_the_file_twenty_times_a_second_at_most(machine):
    clock = machine.clock()
    machine.run(0.04)
    assert clock.now_s() == 0.0  # without a reading
    machine.run(0.02)
    assert clock.now_s() == pytest.approx(0.06)
    machine.run(1.0, waiting=1.0)
    later_s = clock.now_s()
    machine.run(0.1, waiting=-3.0)
    assert clock.now_s() == pytest.approx(later_s + 0.1)


def test_the_simulator_waits_for_an_overloaded_graph_and_not_for_a_dead_one(machine):
    clock, lockstep = machine.clock(), Lockstep(None, patience_s=5.0)
    lockstep.publish(0, clock.now_s())
    worked_s(machine, clock, 100.0, waiting=1.0)
    assert not lockstep.is_stuck(clock.now_s())
    worked_s(machine, clock, 5.0)
    assert lockstep.is_stuck(clock.now_s())


def test_in_lockstep_an_overloaded_source_is_not_silent_for_the_watchdog_and_a_dead_one_is(machine):
    clock, watchdog = machine.clock(), InputWatchdog({"state": 0.05}, lockstep_silence_s=8.0)

    def reading():
        now = ClockReading(10**9, machine.steady_s, clock.now_s())
        watchdog.update(now)
        return now

    watchdog.note_message("state", reading())
    worked_s(machine, clock, 100.0, waiting=1.0)
    assert watchdog.fault(reading(), ("state",)) == ""
    assert watchdog.time_s == 0.0
    worked_s(machine, clock, 8.0)
    assert "state is silent for" in watchdog.fault(reading(), ("state",))
    assert watchdog.time_s > 0.0

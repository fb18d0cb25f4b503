"""A soak watches what it claims to watch: memory of a whole tree of processes, late commands, and their cause."""

import os
import subprocess
import sys
import time

import numpy as np
import pytest

from swift_ros import geometry
from swift_ros.types import Odometry
from swift_ros.vehicle import GRAVITY
from swift_sim_bridge.soak import picture, run
from swift_sim_bridge.soak.hover import HEIGHT_M, hover_command
from swift_sim_bridge.soak.late_commands import LateCommand, Stalls, stalled_s
from swift_sim_bridge.soak.processes import memory_mb

CHILD = "import subprocess, sys, time; data = bytearray({mb} * 2**20); {more}; time.sleep(60)"


def test_the_memory_of_a_process_and_of_those_that_it_has_started_is_counted():
    grandchild = CHILD.format(mb=40, more="print('ready', flush=True)")
    more = f"subprocess.Popen([sys.executable, '-c', {grandchild!r}])"
    process = subprocess.Popen([sys.executable, "-c", CHILD.format(mb=60, more=more)], stdout=subprocess.PIPE)
    try:
        assert process.stdout.readline() == b"ready\n"
        deadline_s = time.monotonic() + 10.0
        while sum(memory_mb(process.pid).values()) < 100 and time.monotonic() < deadline_s:
            time.sleep(0.1)
        assert 100 < sum(memory_mb(process.pid).values()) < 140
    finally:
        subprocess.run(["pkill", "-P", str(process.pid)], check=True)
        process.kill()
        process.wait()
    assert memory_mb(process.pid) == {}


class StallingMachine:
    """It stalls from 4.0 to 4.2 s."""

    time_s = 0.0

    def stalls(self) -> Stalls:
        return Stalls(lambda: min(max(self.time_s - 4.0, 0.0), 0.2), lambda: self.time_s)

    def read_until(self, stalls, end_s):
        """Take a reading every 20 ms."""
        while self.time_s < end_s:
            stalls.take()
            self.time_s += 0.02


def test_a_delay_is_explained_by_stalls_of_the_machine_at_that_time_only():
    machine = StallingMachine()
    stalls = machine.stalls()
    machine.read_until(stalls, 10.0)
    assert stalls.between(3.95, 4.15) == pytest.approx(0.16, abs=0.03)
    assert stalls.between(5.0, 5.2) == 0.0
    assert LateCommand(0, 0.15, stalls.between(4.00, 4.15)).is_explained
    assert not LateCommand(0, 0.15, stalls.between(5.0, 5.15)).is_explained


def test_a_stall_since_the_last_reading_explains_a_delay_too():
    machine = StallingMachine()
    stalls = machine.stalls()
    machine.read_until(stalls, 3.99)
    machine.time_s = 4.3
    assert stalls.between(3.9, 4.25) == pytest.approx(0.2)


def test_stalls_are_the_waiting_tasks_and_the_time_that_the_host_took(tmp_path):
    pressure, statistics = tmp_path / "cpu", tmp_path / "stat"
    assert stalled_s(pressure, statistics) == 0.0
    pressure.write_text("some avg10=0.00 avg60=0.00 avg300=0.00 total=2500000\nfull avg10=0.00 total=7\n")
    statistics.write_text("cpu  1 2 3 4 5 6 7 300 0 0\ncpu0 1 2 3 4 5 6 7 8 0 0\n")
    assert stalled_s(pressure, statistics) == 2.5 + 300 / os.sysconf("SC_CLK_TCK")


def minutes_of(sizes_mb) -> list[run.Minute]:
    return [run.Minute(k, {"bridge": float(size), "betaflight": 100.0}, 6000) for k, size in enumerate(sizes_mb)]


def test_growth_is_counted_from_the_fifth_minute_on(tmp_path):
    sizes = [10.0, 50.0, 80.0, 90.0, 99.0, 100.0, 101.0, 102.0, 103.0]
    minutes = minutes_of(sizes)
    assert run.growth(minutes).share == pytest.approx(3.0 / 201.5)
    assert run.growth(minutes[:7]).share == 0.0
    minutes[6].unexplained.append((0.08, 0.0))
    picture.draw(minutes, "title", tmp_path / "soak.png")
    assert (tmp_path / "soak.png").stat().st_size > 10_000


def test_a_leak_is_found_in_memory_that_changes_from_race_to_race_and_none_where_none_is():
    changes = 100.0 * np.random.default_rng(1).random(60)
    steady = run.growth(minutes_of(1100.0 + changes))
    assert steady.low < 0.0 < steady.high and abs(steady.share) < run.MAX_GROWTH
    leak = run.growth(minutes_of(1100.0 + changes + 27.0 * np.arange(60)))  # 0.45 MB/s
    assert leak.low > 0.5
    slow = run.growth(minutes_of(1100.0 + changes + 1.5 * np.arange(60)))
    assert slow.low > run.MAX_GROWTH


def test_the_hovering_pilot_climbs_to_its_height_and_stays_at_its_place_despite_tilt_and_wind():
    p, v, q, dt = np.array([0.4, -0.3, 0.2]), np.zeros(3), geometry.quaternion_from_yaw(np.asarray(0.7)), 0.01
    for tick in range(2000):
        state = Odometry(tick, p, q, geometry.rotate_inverse(q, v), np.zeros(3))
        command = hover_command(state, np.zeros(2))
        assert 0.0 < command.thrust <= 2 * GRAVITY
        turn = geometry.quaternion_from_rotation_vector(dt * (command.omega_body + np.array([0.02, -0.01, 0.0])))
        q = geometry.quaternion_multiply(q, turn)
        force = geometry.rotate(q, np.array([0.0, 0.0, command.thrust]))
        v = v + dt * (force - np.array([0.3, 0.0, GRAVITY]))
        p = p + dt * v
    assert p[2] == pytest.approx(HEIGHT_M, abs=0.1) and np.linalg.norm(v) < 0.2
    assert np.linalg.norm(p[:2]) < 1.5

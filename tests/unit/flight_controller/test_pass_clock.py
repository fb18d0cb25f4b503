"""The clock that is preloaded into a firmware: each state packet advances its time by one pass."""

import os
import subprocess
import sys

import pytest

from swift_ros.errors import UsageError
from swift_sim_bridge.flight_controller.sitl import pass_clock, udp

PACKETS = 80
FIRMWARE = """
import select, socket, sys, time
link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
link.bind(("127.0.0.1", 0))

def passes(count):
    for _ in range(count):
        link.sendto(bytes(int(sys.argv[2])), link.getsockname())
        link.recvfrom(1000)
        select.select([], [], [], 0.0)
    return max(time.monotonic() for _ in range(320 * count))  # each reading adds 0.4 us, up to the end of the pass

first = passes(1)
time.sleep(0.05)
print(passes(int(sys.argv[1])) - first)
"""


def measured_s(library, packet_bytes: int) -> float:
    """Return the time in s that a program with this clock measures for PACKETS packets."""
    answer = subprocess.run(
        [sys.executable, "-c", FIRMWARE, str(PACKETS), str(packet_bytes)],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "LD_PRELOAD": str(library)},
    )
    return float(answer.stdout)


def test_each_state_packet_is_a_pass_and_without_packets_it_is_the_wall_clock(tmp_path):
    library = pass_clock.compiled(tmp_path)
    state = udp.state_packet([0.0] * 3, [0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 9.8])
    assert measured_s(library, len(state)) == pytest.approx(PACKETS / 8000, abs=1e-9)
    assert measured_s(library, len(state) - 1) > 0.05


def test_without_a_compiler_the_error_is_one_sentence(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(UsageError, match="build-essential"):
        pass_clock.compiled(tmp_path)

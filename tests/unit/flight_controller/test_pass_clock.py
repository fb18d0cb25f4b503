"""The clock that is loaded before a firmware: each packet of state lets time go on by a pass."""

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
    return max(time.monotonic() for _ in range(320 * count))  # 0.4 us a look, as long as it may go on

first = passes(1)
time.sleep(0.05)
print(passes(int(sys.argv[1])) - first)
"""


def told(library, packet_bytes: int) -> float:
    """Return how long a program says that packets took it, s."""
    answer = subprocess.run(
        [sys.executable, "-c", FIRMWARE, str(PACKETS), str(packet_bytes)],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "LD_PRELOAD": str(library)},
    )
    return float(answer.stdout)


def test_each_packet_of_state_is_a_pass_and_without_any_it_is_the_wall_s_time(tmp_path):
    library = pass_clock.compiled(tmp_path)
    state = udp.state_packet([0.0] * 3, [0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 9.8])
    assert told(library, len(state)) == pytest.approx(PACKETS / 8000, abs=1e-9)
    assert told(library, len(state) - 1) > 0.05


def test_without_a_compiler_there_is_one_sentence(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(UsageError, match="build-essential"):
        pass_clock.compiled(tmp_path)

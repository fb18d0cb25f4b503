"""The clocks of a slowed command agree with each other, and each of its waits is stretched as much."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SLOW_CLOCK = Path(__file__).resolve().parents[2] / "scripts" / "slow_clock.py"
FACTOR, WAIT_S = 3.0, 0.1
# Prints for each way to wait: seconds of the slow clocks, and of the kernel's own count, which nothing slows.
WAITS = f"""
import json, queue, select, socket, subprocess, sys, threading, time
def true_s(): return float(open("/proc/uptime").read().split()[0])
def of_queue():
    try: queue.Queue().get(timeout={WAIT_S})
    except queue.Empty: pass
def of_socket():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        udp.bind(("127.0.0.1", 0)); udp.settimeout({WAIT_S})
        try: udp.recv(1)
        except TimeoutError: pass
waits = dict(
    sleep=lambda: time.sleep({WAIT_S}), event=lambda: threading.Event().wait({WAIT_S}), queue=of_queue,
    socket=of_socket, select=lambda: select.select([], [], [], {WAIT_S}), epoll=lambda: select.epoll().poll({WAIT_S}),
    poll=lambda: select.poll().poll({1000 * WAIT_S}), process=lambda: subprocess.run(["sleep", "{WAIT_S}"]))
found = dict()
for name, wait in waits.items():
    true_begun, begun = true_s(), (time.monotonic(), time.time())
    wait()
    found[name] = [time.monotonic() - begun[0], time.time() - begun[1], true_s() - true_begun]
before = time.monotonic(), time.time()
child = json.loads(subprocess.run(
    [sys.executable, "-c", "import json, time; print(json.dumps([time.monotonic(), time.time()]))"],
    capture_output=True, text=True).stdout)
print(json.dumps([found, list(zip(before, child, (time.monotonic(), time.time())))]))
"""


def slowed(*words: str) -> subprocess.CompletedProcess:
    return subprocess.run([sys.executable, SLOW_CLOCK, *words], capture_output=True, text=True, timeout=120)


@pytest.mark.skipif(not shutil.which("cc"), reason="needs a C compiler")
def test_every_wait_is_stretched_and_all_processes_see_the_same_slow_clock():
    result = slowed(str(FACTOR), sys.executable, "-c", WAITS)
    assert result.returncode == 0, result.stderr
    waits, clocks = json.loads(result.stdout)
    for name, (steady_s, system_s, true_s) in waits.items():
        assert min(steady_s, system_s) > 0.99 * WAIT_S, name
        assert true_s > FACTOR * max(steady_s, system_s) - 0.02, name  # /proc/uptime has steps of 0.01 s
    for before, of_child, after in clocks:
        assert before < of_child < after


@pytest.mark.parametrize("words", [(), ("fast", "true"), ("0.5", "true"), ("2",), ("2", "no-such-command")])
def test_a_wrong_call_is_one_sentence(words):
    result = slowed(*words)
    assert result.returncode == 1 and len(result.stderr.splitlines()) == 1 and "slow_clock" in result.stderr

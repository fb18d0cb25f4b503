"""Loading a network opens no connection: ONNX Runtime would send usage data, the package forbids it."""

import os
import subprocess
import sys
from pathlib import Path

MODEL = Path(__file__).parents[3] / "config" / "models" / "pilot.onnx"
# Where no name server answers no socket is seen in either case; the setting is therefore read too.
SCRIPT = """
import os, sys, time
from swift_ros.policy.actor import Actor

actor = Actor(sys.argv[1])
sockets, end = set(), time.monotonic() + 3.0
while time.monotonic() < end:
    for number in os.listdir("/proc/self/fd"):
        try:
            target = os.readlink(f"/proc/self/fd/{number}")
        except OSError:
            continue
        sockets |= {target} if target.startswith("socket:") else set()
    time.sleep(0.01)
print(len(sockets), os.environ["ORT_DISABLE_TELEMETRY"])
"""


def test_a_process_that_runs_the_pilot_opens_no_socket():
    environment = {name: value for name, value in os.environ.items() if name != "ORT_DISABLE_TELEMETRY"}
    result = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(MODEL)], env=environment, capture_output=True, text=True, check=True
    )
    assert result.stdout.strip() == "0 1"

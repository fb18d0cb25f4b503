"""One sequence of gyro and sticks through the real firmware, its motors out: what the simulated one is held against.

Type `set runaway_takeoff_prevention = OFF` too: a gyro that does not follow the motors looks like a runaway to it.
"""

import struct
import time

import numpy as np

from swift_ros.betaflight.msp_messages import ARM_SWITCH, arming_blocks
from swift_ros.errors import UsageError
from swift_sim_bridge.flight_controller.sitl.sitl import AT_REST, Sitl

FRAME_PASSES = 80  # 100 frames of sticks a second, as the link sends them
ARM_PATIENCE_S = 20.0
LOOK_FRAMES = 20
FRAME_TIMES = "set debug_mode = RX_TIMING"  # a line of the CLI, with which it tells the time between frames
DEBUG, UNIT_S = 254, 1e-5
ASK_PASS = 60  # of a frame's, when it has been taken and its interval measured


class FrameTimes:
    """Watches a replay: the time between frames of sticks that a firmware set up by FRAME_TIMES measures."""

    def __init__(self, sitl: Sitl):
        self._sitl, self._asked = sitl, 0

    def ask(self) -> None:
        """Ask for the interval of the frame that was taken last; it is not waited for."""
        self._sitl.send(DEBUG)
        self._asked += 1

    def intervals_s(self) -> np.ndarray:
        """Return (n,) s from the frame before to each, one for each time that was asked; call it after the last.

        Raises UsageError when the firmware has not answered all.
        """
        deadline, heard = time.monotonic() + ARM_PATIENCE_S, self._sitl.heard(DEBUG)
        while len(heard) < self._asked and time.monotonic() < deadline:
            for _ in range(FRAME_PASSES):
                self._sitl.step(*AT_REST)
            heard += self._sitl.heard(DEBUG)
        if len(heard) != self._asked:
            raise UsageError(f"Betaflight SITL told the time of {len(heard)} of {self._asked} frames; fly it again")
        return UNIT_S * (np.array([struct.unpack_from("<H", payload)[0] for payload in heard]) + 0.5)


def arm(sitl: Sitl, safe_us, armed_us) -> None:
    """Arm the firmware at rest: channels `safe_us` until nothing forbids it, then `armed_us` (throttle closed in both).

    Raises UsageError that names what forbids it.
    """
    deadline = time.monotonic() + ARM_PATIENCE_S
    channels, blocks = safe_us, ["nothing was asked yet"]
    while time.monotonic() < deadline:
        for _ in range(LOOK_FRAMES):
            motors = _frame(sitl, channels, np.zeros((FRAME_PASSES, 3)))
        if np.all(motors > 0.0):
            return
        blocks = [name for name in arming_blocks(sitl.status()) if name != ARM_SWITCH]
        channels = safe_us if blocks else armed_us
    raise UsageError(f"Betaflight SITL does not arm ({', '.join(blocks)}); look at its settings in {sitl.log.parent}")


def replay(sitl: Sitl, gyro_omega_body, frames_us, watch: FrameTimes | None = None, settle_s: float = 0.0):
    """Return the motor outputs (N, 4) in 0..1 of N passes of the loop, one a row of gyro_omega_body (N, 3) rad/s.

    frames_us: (ceil(N / FRAME_PASSES), channels) in the channel map's order; each is sent before the first of its
    passes and takes effect when the serial task has read it, within a few ms of the wall clock, for which passes wait
    `settle_s` (15 ms will do): the setpoint then changes with the first pass, but gyro filters, which run on meanwhile,
    forget their lag.
    Attitude and accelerometer stay at rest. Raises UsageError for a binary without gyro sync.
    """
    if not sitl.stepped:
        raise UsageError("passes count with gyro sync alone; give a binary with its option SIMULATOR_GYROPID_SYNC")
    gyro_omega_body = np.asarray(gyro_omega_body, dtype=float)
    parts = np.split(gyro_omega_body, range(FRAME_PASSES, len(gyro_omega_body), FRAME_PASSES))
    if len(frames_us) != len(parts):
        raise ValueError(f"{len(parts)} frames of sticks go with {len(gyro_omega_body)} passes, not {len(frames_us)}")
    pairs = zip(frames_us, parts, strict=True)
    return np.concatenate([_frame(sitl, frame, part, watch, settle_s) for frame, part in pairs])


def _frame(sitl: Sitl, channels_us, gyro_omega_body, watch: FrameTimes | None = None, settle_s: float = 0.0):
    sitl.send_sticks([int(us) for us in channels_us])
    if settle_s > 0:
        time.sleep(settle_s)
    motors = []
    for number, omega_body in enumerate(gyro_omega_body):
        if watch is not None and number == ASK_PASS:
            watch.ask()
        motors.append(sitl.step(omega_body, *AT_REST[1:]))
    return np.array(motors)

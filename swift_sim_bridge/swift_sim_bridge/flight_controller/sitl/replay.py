"""Replay of gyro and stick sequences through the real firmware, as a reference for the simulated one.

Configure `set runaway_takeoff_prevention = OFF` as well: a gyro that does not follow the motors trips it.
"""

import struct
import time

import numpy as np

from swift_ros.betaflight.arming_flags import ARM_SWITCH, arming_blocks
from swift_ros.errors import UsageError
from swift_sim_bridge.flight_controller.sitl.sitl import AT_REST, Sitl

FRAME_PASSES = 80  # passes between two stick frames: 100 frames a second at 8 kHz, as the link sends them
ARM_TIMEOUT_S = 20.0  # longest time until the firmware arms or has answered
STATUS_FRAMES = 20  # frames between two requests of the status while arming
FRAME_TIMES = "set debug_mode = RX_TIMING"  # CLI line with which the firmware reports the time between frames
DEBUG, DEBUG_UNIT_S = 254, 1e-5  # MSP code and unit of that report
ASK_PASS = 60  # pass of a frame in which its interval is requested: by then the firmware has read the frame


class FrameTimes:
    """Reads the time between stick frames that a firmware configured by FRAME_TIMES measures during a replay."""

    def __init__(self, sitl: Sitl):
        self._sitl, self._requests = sitl, 0

    def ask(self) -> None:
        """Request the interval of the frame that was read last, without waiting for the answer."""
        self._sitl.send(DEBUG)
        self._requests += 1

    def intervals_s(self) -> np.ndarray:
        """Return (n,) s from the previous frame to each frame, one for each request. Call it after the last request.

        Raises UsageError when the firmware has not answered all requests.
        """
        deadline, answers = time.monotonic() + ARM_TIMEOUT_S, self._sitl.answers(DEBUG)
        while len(answers) < self._requests and time.monotonic() < deadline:
            for _ in range(FRAME_PASSES):
                self._sitl.step(*AT_REST)
            answers += self._sitl.answers(DEBUG)
        if len(answers) != self._requests:
            count = f"{len(answers)} of {self._requests}"
            raise UsageError(f"Betaflight SITL reported the time of {count} frames; repeat the replay")
        return DEBUG_UNIT_S * (np.array([struct.unpack_from("<H", payload)[0] for payload in answers]) + 0.5)


def arm(sitl: Sitl, safe_us, armed_us) -> None:
    """Arm the firmware at rest.

    Args:
        sitl: the firmware.
        safe_us: channels until nothing blocks arming; throttle closed.
        armed_us: channels from then on; throttle closed.

    Raises:
        UsageError: the firmware does not arm; names its arming-disable flags.
    """
    deadline = time.monotonic() + ARM_TIMEOUT_S
    channels, blocks = safe_us, ["its status was never read"]
    while time.monotonic() < deadline:
        for _ in range(STATUS_FRAMES):
            motors = _frame(sitl, channels, np.zeros((FRAME_PASSES, 3)))
        if np.all(motors > 0.0):
            return
        blocks = [name for name in arming_blocks(sitl.status()) if name != ARM_SWITCH]
        channels = safe_us if blocks else armed_us
    raise UsageError(f"Betaflight SITL does not arm ({', '.join(blocks)}); look at its settings in {sitl.log.parent}")


def replay(sitl: Sitl, gyro_omega_body, frames_us, frame_times: FrameTimes | None = None, settle_s: float = 0.0):
    """Replay gyro and stick frames, with attitude and accelerometer at rest.

    A frame is sent before the first of its passes and acts when the serial task has read it, within a few ms of the
    wall clock. With `settle_s` the first pass waits for that: the setpoint then changes with the first pass, but the
    gyro filters, which run meanwhile, lose their lag.

    Args:
        sitl: the firmware.
        gyro_omega_body: (N, 3) rad/s, a row for each pass.
        frames_us: (ceil(N / FRAME_PASSES), channels) us in the channel map's order.
        frame_times: requests the interval of each frame; None for no requests.
        settle_s: s of the wall clock to wait after each frame; 0.015 is enough.

    Returns:
        Motor outputs (N, 4) in 0..1.

    Raises:
        UsageError: the binary has no gyro sync.
    """
    if not sitl.stepped:
        raise UsageError("a replay needs gyro sync; give a binary with its option SIMULATOR_GYROPID_SYNC")
    gyro_omega_body = np.asarray(gyro_omega_body, dtype=float)
    parts = np.split(gyro_omega_body, range(FRAME_PASSES, len(gyro_omega_body), FRAME_PASSES))
    if len(frames_us) != len(parts):
        raise ValueError(f"{len(gyro_omega_body)} passes need {len(parts)} stick frames, not {len(frames_us)}")
    pairs = zip(frames_us, parts, strict=True)
    return np.concatenate([_frame(sitl, frame, part, frame_times, settle_s) for frame, part in pairs])


def _frame(sitl: Sitl, channels_us, gyro_omega_body, frame_times: FrameTimes | None = None, settle_s: float = 0.0):
    """Return the motor outputs (passes, 4) of one stick frame."""
    sitl.send_sticks([int(us) for us in channels_us])
    if settle_s > 0:
        time.sleep(settle_s)
    motors = []
    for number, omega_body in enumerate(gyro_omega_body):
        if frame_times is not None and number == ASK_PASS:
            frame_times.ask()
        motors.append(sitl.step(omega_body, *AT_REST[1:]))
    return np.array(motors)

"""Detects a vehicle that tumbles: body rates that no command asks for, and that do not fall. No ROS.

Two motors that are connected in the wrong order, or propellers on the wrong motors, turn the corrections of the rate
loop around: the vehicle rotates faster and faster, within tenths of a second after its take-off.
"""

import numpy as np

# Body rate over the largest commanded one of its axis. In five simulated races the rate loop overshoots by 4 % at most.
EXCESS = 1.5
TUMBLE_S = 0.15  # s, shortest tumble: a touch that the vehicle survives turns it for some 0.05 s


class TumbleWatch:
    """Compares the measured body rates with those that may be commanded.

    Args:
        max_rates: (3,) rad/s, the vehicle file's `rates.max`.
    """

    def __init__(self, max_rates):
        self._limits = EXCESS * np.asarray(max_rates)
        self._since_s: float | None = None
        self._text = ""

    def update(self, omega_body, omega_command, time_s: float) -> None:
        """Take measured and commanded body rates (3,) rad/s at `time_s` (s of a clock that never stops)."""
        excess = np.abs(omega_body) / self._limits
        if np.max(excess) < 1.0:
            self._since_s = None
            return
        axis = int(np.argmax(excess))
        self._since_s = time_s if self._since_s is None else self._since_s
        self._text = (
            f"the vehicle tumbles: its body rate about {'xyz'[axis]} is {omega_body[axis]:.0f} rad/s, commanded "
            f"{omega_command[axis]:.0f}; check the order of the motors and the propellers"
        )

    def fault(self, time_s: float) -> str:
        """Return a sentence when the vehicle tumbles, "" otherwise."""
        return self._text if self._since_s is not None and time_s - self._since_s >= TUMBLE_S else ""

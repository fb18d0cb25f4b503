"""Arming-disable flags of the firmware (Betaflight 4.5 and 2025.12, `runtime_config.h`)."""

from swift_ros.betaflight.msp_messages import Status

# In the firmware's order; the last flag is always ARM_SWITCH, for any number of flags.
ARMING_FLAGS = (
    "NO_GYRO",
    "FAILSAFE",
    "RX_FAILSAFE",
    "NOT_DISARMED",
    "BOXFAILSAFE",
    "RUNAWAY_TAKEOFF",
    "CRASH_DETECTED",
    "THROTTLE",
    "ANGLE",
    "BOOT_GRACE_TIME",
    "NOPREARM",
    "LOAD",
    "CALIBRATING",
    "CLI",
    "CMS_MENU",
    "BST",
    "MSP",
    "PARALYZE",
    "GPS",
    "RESC",
    "DSHOT_TELEM",
    "REBOOT_REQUIRED",
    "DSHOT_BITBANG",
    "ACC_CALIBRATION",
    "MOTOR_PROTOCOL",
    "CRASHFLIP",
    "ALTHOLD",
    "POSHOLD",
)
ARM_SWITCH = "ARM_SWITCH"


def arming_blocks(status: Status) -> tuple[str, ...]:
    """Return the names of the arming-disable flags that are set."""
    names = [*ARMING_FLAGS[: max(status.arming_flags - 1, 0)]]
    names += [f"FLAG_{i}" for i in range(len(names), status.arming_flags - 1)] + [ARM_SWITCH]
    return tuple(name for i, name in enumerate(names) if status.arming_disable >> i & 1)

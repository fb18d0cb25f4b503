"""Arming and the firmware's arming-disable flags (Betaflight 4.5, core.c, runtime_config.h)."""

import enum

from swift_sim_bridge.flight_controller.firmware_settings import FirmwareSettings


class Block(enum.IntFlag):
    """Arming-disable flags, with the bits that MSP_STATUS_EX sends."""

    NO_GYRO = 1 << 0
    FAILSAFE = 1 << 1
    RX_FAILSAFE = 1 << 2
    NOT_DISARMED = 1 << 3
    BOXFAILSAFE = 1 << 4
    RUNAWAY_TAKEOFF = 1 << 5
    CRASH_DETECTED = 1 << 6
    THROTTLE = 1 << 7
    ANGLE = 1 << 8
    BOOT_GRACE_TIME = 1 << 9
    NOPREARM = 1 << 10
    LOAD = 1 << 11
    CALIBRATING = 1 << 12
    CLI = 1 << 13
    CMS_MENU = 1 << 14
    BST = 1 << 15
    MSP = 1 << 16
    PARALYZE = 1 << 17
    GPS = 1 << 18
    RESC = 1 << 19
    DSHOT_TELEM = 1 << 20
    REBOOT_REQUIRED = 1 << 21
    DSHOT_BITBANG = 1 << 22
    ACC_CALIBRATION = 1 << 23
    MOTOR_PROTOCOL = 1 << 24
    ARM_SWITCH = 1 << 25


BLOCK_COUNT = len(Block)
DISARM_FRAMES = 3  # frames with the ARM switch off that are ignored, so that one bad frame does not disarm


class Arming:
    """The arming state of the firmware.

    Attributes:
        armed: whether the vehicle is armed.
        blocks: arming-disable flags that are set.
    """

    def __init__(self, settings: FirmwareSettings):
        self._settings = settings
        self._had_signal = False
        self._off_frames = 0
        self.armed = False
        self.blocks = Block.BOOT_GRACE_TIME | Block.CALIBRATING

    def mark(self, block: Block, is_set: bool) -> None:
        """Set or clear a flag."""
        self.blocks = self.blocks | block if is_set else self.blocks & ~block

    def disarm(self) -> None:
        """Disarm the vehicle."""
        self.armed = False

    def follow_switch(self, switched_on: bool, link_up: bool) -> None:
        """Follow the ARM switch of one receiver frame; the switch can disarm only while the link is up."""
        if switched_on:
            self._off_frames = 0
            self.armed = self.armed or not self.blocks
        elif self.armed and link_up:
            self._off_frames += 1
            if self._off_frames > DISARM_FRAMES:
                self.disarm()

    def review(self, now_ms: int, signal: bool, boxes: frozenset[str], throttle_low: bool, tilt_deg: float) -> None:
        """Set and clear the flags of a disarmed vehicle, once for each receiver frame (`updateArmingStatus`).

        Args:
            now_ms: ms since power-on.
            signal: whether receiver frames arrive.
            boxes: names of the active modes.
            throttle_low: whether the throttle is below `min_check_us`.
            tilt_deg: tilt of the vehicle, degrees.
        """
        if self.armed:
            return
        switched_on = "ARM" in boxes
        if now_ms >= 1000 * self._settings.grace_s:
            self.mark(Block.BOOT_GRACE_TIME, False)
        self.mark(Block.CALIBRATING, now_ms < 1000 * self._settings.calibration_s)
        if signal and not self._had_signal and switched_on:
            self.mark(Block.NOT_DISARMED, True)
        elif signal and not switched_on:
            self.mark(Block.NOT_DISARMED, False)
        self._had_signal = signal
        self.mark(Block.BOXFAILSAFE, "FAILSAFE" in boxes)
        self.mark(Block.THROTTLE, not throttle_low)
        self.mark(Block.ANGLE, tilt_deg >= self._settings.small_angle_deg)
        if not switched_on:
            self.mark(Block.RUNAWAY_TAKEOFF, False)
            self.mark(Block.ARM_SWITCH, False)
        elif self.blocks:
            self.mark(Block.ARM_SWITCH, True)  # until the switch is off again

"""Flight modes ("boxes") switched by AUX channels, with their MSP names and numbers.

Source: Betaflight 4.5, rc_modes.c, msp_box.c.
"""

from swift_sim_bridge.flight_controller.firmware_settings import PERMANENT_IDS, FirmwareSettings, ModeSwitch

RANGE_SLOTS = 20  # MSP_MODE_RANGES also sends the empty slots
STICK_CHANNELS = 4
RANGE_MIN_US, RANGE_MAX_US, STEP_US = 900, 2100, 25  # of a mode range


def available(settings: FirmwareSettings) -> tuple[str, ...]:
    """Return the available boxes in the order of MSP_BOXIDS."""
    return tuple(name for name in PERMANENT_IDS if name != "MSP OVERRIDE" or settings.override_mask)


def active(settings: FirmwareSettings, channels_us) -> frozenset[str]:
    """Return the names of the boxes that the receiver channels, in the firmware's order, switch on."""
    on = (name for name, switch in settings.modes.items() if _within(switch, channels_us))
    return frozenset(on) & frozenset(available(settings))


def _within(switch: ModeSwitch, channels_us) -> bool:
    channel_us = int(channels_us[STICK_CHANNELS + switch.aux - 1])
    channel_us = max(RANGE_MIN_US, min(RANGE_MAX_US - 1, channel_us))
    return switch.low_us <= channel_us < switch.high_us


def off_value_us(switch: ModeSwitch) -> int:
    """Return a channel value in us at which the switch is off."""
    return switch.low_us - STEP_US if switch.low_us > RANGE_MIN_US else switch.high_us + STEP_US

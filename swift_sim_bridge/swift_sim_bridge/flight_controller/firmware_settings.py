"""Settings of the simulated firmware: section `flight_controller` of `config/simulation.yaml`.

These are receiver, switches, failsafe and meters. Gains and rates are in the vehicle file
(`configuration.controller_section`), from which the arrays of the rate loop are made (`rate_loop.profile`).
"""

from dataclasses import dataclass
from functools import cached_property

from swift_ros.configuration import refuse_outside, setting, within
from swift_ros.text import described

RECEIVERS = ("msp", "msp_override")
PROCEDURES = ("land", "drop")  # in the order of their numbers in MSP_FAILSAFE_CONFIG
# The simulated modes ("boxes") in the firmware's order, with their permanent numbers (msp_box.c).
PERMANENT_IDS = {"ARM": 0, "ANGLE": 1, "FAILSAFE": 27, "MSP OVERRIDE": 50}
FAILSAFE = "FAILSAFE"  # the mode that ends a flight, whatever the others are
STICKS = "AERT"  # the firmware's order: roll, pitch, yaw, throttle
MAPPABLE = STICKS + "1234"


@dataclass(frozen=True)
class ModeSwitch:
    """A mode is on while an AUX channel is within a range.

    Attributes:
        aux: AUX channel, 1 to 14.
        low_us: lower end of the range, us.
        high_us: upper end of the range, us.
    """

    aux: int
    low_us: int
    high_us: int

    def __post_init__(self):
        if not 1 <= self.aux <= 14:
            raise ValueError("'aux' must be an AUX channel from 1 to 14")
        if not 900 <= self.low_us < self.high_us <= 2100 or self.low_us % 25 or self.high_us % 25:
            raise ValueError(
                f"'low_us' {described(self.low_us)} and 'high_us' {described(self.high_us)} must be multiples of 25 "
                "from 900 to 2100, the lower one first"
            )

    def overlaps(self, other: "ModeSwitch") -> bool:
        """Return whether some value of one channel turns on both modes."""
        return self.aux == other.aux and self.low_us < other.high_us and other.low_us < self.high_us


@dataclass(frozen=True)
class FailsafeSettings:
    """Settings of the failsafe.

    Attributes:
        delay_s: s from the last valid frame to the procedure.
        procedure: "drop" or "land".
        landing_s: s that "land" lasts.
        landing_throttle_us: throttle during "land", us.
        throttle_low_delay_s: s of closed throttle after which the failsafe disarms at once.
        recovery_delay_s: s of valid frames until the link is up again.
    """

    delay_s: float = within(0.0, 20.0)
    procedure: str
    landing_s: float = within(0.0, 25.5)
    landing_throttle_us: int = within(750, 2250)
    throttle_low_delay_s: float = within(0.0, 30.0)
    recovery_delay_s: float = within(0.0, 20.0)

    def __post_init__(self):
        refuse_outside(PROCEDURES, procedure=self.procedure)


@dataclass(frozen=True)
class FirmwareSettings:
    """Settings of the simulated firmware.

    Attributes:
        receiver: "msp", or "msp_override": the pilot's radio flies and MSP can take over `override_channels`.
        channel_map: letter i names the content of channel i of a frame.
        override_channels: letters of the channel map.
        min_check_us: throttle below is closed, us.
        mid_us: centre of the sticks, us.
        max_check_us: upper stick threshold, us.
        modes: switches by the name of the mode.
        failsafe: settings of the failsafe.
        grace_s: s after power-on without arming.
        calibration_s: s of the gyro calibration after power-on.
        small_angle_deg: largest tilt that can arm, degrees.
        angle_limit_deg: tilt at full stick in angle mode, degrees.
        level_gain: gain of angle mode, P of PID_LEVEL.
        voltage_filter_hz: cutoff of the voltmeter's low-pass, Hz.
        current_filter_hz: cutoff of the ammeter's low-pass, Hz.
        motor_poles: number of poles of a motor.
    """

    receiver: str
    channel_map: str
    override_channels: str
    min_check_us: int = within(900, 2100)
    mid_us: int = within(900, 2100)
    max_check_us: int = within(900, 2100)
    modes: dict[str, ModeSwitch]
    failsafe: FailsafeSettings
    grace_s: float = within(0.0, 60.0)
    calibration_s: float = within(0.0, 60.0)
    small_angle_deg: float = setting("deg of tilt from which on arming is refused, 25 by default", 1.0, 180.0)
    angle_limit_deg: float = within(10.0, 90.0)
    level_gain: int = within(0, 200)
    voltage_filter_hz: float = within(0.001, 1000.0)
    current_filter_hz: float = within(0.001, 1000.0)
    motor_poles: int = within(2, 254)

    def __post_init__(self):
        refuse_outside(RECEIVERS, receiver=self.receiver)
        if sorted(self.channel_map) != sorted(MAPPABLE):
            raise ValueError("'channel_map' must contain each of A, E, R, T, 1, 2, 3, 4 once, such as AETR1234")
        if not set(self.override_channels) <= set(self.channel_map):
            raise ValueError("'override_channels' must be letters of 'channel_map', such as AETR2")
        if not self.min_check_us < self.mid_us < self.max_check_us:
            raise ValueError("'min_check_us', 'mid_us' and 'max_check_us' must rise in this order")
        if self.motor_poles % 2:
            raise ValueError("'motor_poles' must be even: poles come in pairs")
        for name, switch in self.modes.items():
            refuse_outside(PERMANENT_IDS, modes=name)
            if name != FAILSAFE and FAILSAFE in self.modes and switch.overlaps(self.modes[FAILSAFE]):
                raise ValueError(
                    f"the ranges of {name} and {FAILSAFE} overlap on AUX{switch.aux} under 'modes', so the failsafe "
                    f"ends each flight with {name}; give each its own 'aux', or ranges apart"
                )

    @cached_property
    def rx_map(self) -> tuple[int, ...]:
        """Positions in a frame of roll, pitch, yaw, throttle and AUX1..AUX4, as MSP_RX_MAP sends them."""
        return tuple(self.channel_map.index(letter) for letter in MAPPABLE)

    @cached_property
    def override_mask(self) -> int:
        """Bit mask of the frame positions that MSP OVERRIDE takes from MSP; 0 unless the receiver is msp_override."""
        if self.receiver != "msp_override":
            return 0
        return sum(1 << self.channel_map.index(letter) for letter in self.override_channels)

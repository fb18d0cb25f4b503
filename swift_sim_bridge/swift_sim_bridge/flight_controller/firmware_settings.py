"""Settings of the simulated firmware: section `flight_controller` of `config/simulation.yaml`.

These are receiver, switches, failsafe and meters. Gains and rates are in the vehicle file
(`configuration.controller_section`), from which the arrays of the rate loop are made (`rate_loop.profile`).
"""

from dataclasses import dataclass
from functools import cached_property

RECEIVERS = ("msp", "msp_override")
PROCEDURES = ("land", "drop")  # in the order of their numbers in MSP_FAILSAFE_CONFIG
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
            raise ValueError("'low_us' and 'high_us' must be multiples of 25 from 900 to 2100, the lower one first")


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

    delay_s: float
    procedure: str
    landing_s: float
    landing_throttle_us: int
    throttle_low_delay_s: float
    recovery_delay_s: float

    def __post_init__(self):
        if self.procedure not in PROCEDURES:
            raise ValueError(f"'procedure' must be one of {', '.join(PROCEDURES)}")


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
    min_check_us: int
    mid_us: int
    max_check_us: int
    modes: dict[str, ModeSwitch]
    failsafe: FailsafeSettings
    grace_s: float
    calibration_s: float
    small_angle_deg: float
    angle_limit_deg: float
    level_gain: int
    voltage_filter_hz: float
    current_filter_hz: float
    motor_poles: int

    def __post_init__(self):
        if self.receiver not in RECEIVERS:
            raise ValueError(f"'receiver' must be one of {', '.join(RECEIVERS)}")
        if sorted(self.channel_map) != sorted(MAPPABLE):
            raise ValueError("'channel_map' must be an order of AERT1234, such as AETR1234")

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

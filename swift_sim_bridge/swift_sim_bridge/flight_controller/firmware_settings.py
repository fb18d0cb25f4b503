"""Section `flight_controller` of `config/simulation.yaml`: how the simulated firmware is set up, beside its vehicle."""

from dataclasses import dataclass
from functools import cached_property

RECEIVERS = ("msp", "msp_override")
PROCEDURES = ("land", "drop")  # as MSP_FAILSAFE_CONFIG numbers them
STICKS = "AERT"  # the firmware's order: roll, pitch, yaw, throttle
MAPPABLE = STICKS + "1234"


@dataclass(frozen=True)
class ModeSwitch:
    """A box is on while AUX channel `aux` (1 = AUX1) lies in low_us..high_us."""

    aux: int
    low_us: int
    high_us: int

    def __post_init__(self):
        if not 1 <= self.aux <= 14:
            raise ValueError("'aux' must be an AUX channel from 1 to 14")
        if not 900 <= self.low_us < self.high_us <= 2100 or self.low_us % 25 or self.high_us % 25:
            raise ValueError("'low_us' and 'high_us' must be multiples of 25 from 900 to 2100, the lower one first")


@dataclass(frozen=True)
class Failsafe:
    """delay_s: from the last good frame to the procedure ("drop" or "land"); landing_s, landing_throttle_us: of "land";
    throttle_low_delay_s: a throttle closed for this long makes it disarm at once; recovery_delay_s: of good frames
    before the link counts as up."""

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
    """receiver: "msp", or "msp_override" where the pilot's radio flies and MSP may take `override_channels` (letters of
    the channel map); channel_map: letter i says what channel i of a frame carries; modes: switches by box name;
    grace_s: no arming after power-on; calibration_s: of the gyro; small_angle_deg: largest tilt that arms;
    angle_limit_deg, level_gain: angle mode; voltage_filter_hz, current_filter_hz: of the battery meters; motor_poles.
    """

    receiver: str
    channel_map: str
    override_channels: str
    min_check_us: int
    mid_us: int
    max_check_us: int
    modes: dict[str, ModeSwitch]
    failsafe: Failsafe
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
        """MSP_RX_MAP: the place in a frame of roll, pitch, yaw, throttle, AUX1..AUX4."""
        return tuple(self.channel_map.index(letter) for letter in MAPPABLE)

    @cached_property
    def override_mask(self) -> int:
        """Bits of the places in a frame that MSP OVERRIDE takes from MSP; none unless the receiver is msp_override."""
        if self.receiver != "msp_override":
            return 0
        return sum(1 << self.channel_map.index(letter) for letter in self.override_channels)

"""The receiver: frames by MSP or from the pilot's radio, and the firmware's reaction to a lost signal.

After 100 ms without a frame the signal is lost. The last values are held until 300 ms; then the sticks go to the
centre and the throttle down, and the switches keep their positions. Source: Betaflight 4.5, rx.c, rx/msp.c,
rx/msp_override.c.
"""

from swift_sim_bridge.flight_controller import modes
from swift_sim_bridge.flight_controller.firmware_settings import FirmwareSettings

CHANNELS = 18  # that the firmware handles
THROTTLE = 3  # index of its channel
STICKS = 4  # number of the first channels: roll, pitch, yaw, throttle
PULSE_MIN_US, PULSE_MAX_US = 885, 2115  # range of a valid channel
CLIP_MIN_US, CLIP_MAX_US = 750, 2250  # range of the output channels
SIGNAL_MS = 100  # without a frame until the signal is lost
HOLD_MS = 300  # for which an invalid channel keeps its last value


class Receiver:
    """The receiver of the firmware.

    Attributes:
        channels: us that the firmware uses, in its order: roll, pitch, yaw, throttle, AUX1..AUX14.
        signal: whether frames arrive.
        valid: whether the flight channels are valid.
        radio: us that the pilot's radio sends repeatedly, in the channel map's order; None while it is off. A test or
            a simulated pilot sets it.
    """

    def __init__(self, settings: FirmwareSettings):
        self._settings = settings
        self._map = (*settings.rx_map, *range(len(settings.rx_map), CHANNELS))
        self._msp = [0] * CHANNELS
        self._msp_fresh = False
        self._signal_until_ms = 0
        self._hold_until_ms = [HOLD_MS] * CHANNELS
        self.radio: list[int] | None = None
        self.signal = self.valid = False
        self.channels = [float(settings.mid_us)] * CHANNELS
        self.channels[THROTTLE] = PULSE_MIN_US
        if "ARM" in settings.modes:
            switch = settings.modes["ARM"]
            self.channels[STICKS + switch.aux - 1] = modes.off_value_us(switch)

    def take_msp(self, frame) -> None:
        """Take one MSP_SET_RAW_RC frame of at most CHANNELS values in us; missing channels are 0."""
        self._msp = [*frame, *[0] * (CHANNELS - len(frame))]
        self._msp_fresh = True

    def update(self, now_ms: int, boxes: frozenset[str], failsafe_active: bool) -> bool:
        """Process a new frame or a lost signal.

        The firmware checks continuously, this function every 10 ms: "later than 100 ms" in the firmware is the tick
        at 100 ms here.

        Args:
            now_ms: ms since power-on.
            boxes: modes switched on so far.
            failsafe_active: whether stage 2 of the failsafe is active.

        Returns:
            Whether `channels` were updated.
        """
        fresh = self._msp_fresh if self._settings.receiver == "msp" else self.radio is not None
        self._msp_fresh = False
        if not fresh and now_ms < self._signal_until_ms:
            return False
        self.signal = fresh
        self._signal_until_ms = now_ms + SIGNAL_MS
        self._update_channels(
            [self._raw(channel, boxes) for channel in range(CHANNELS)], now_ms, boxes, failsafe_active
        )
        return True

    def _raw(self, channel: int, boxes) -> float:
        position = self._map[channel]
        if self._settings.receiver == "msp":
            return self._msp[position]
        if "MSP OVERRIDE" in boxes and self._settings.override_mask >> position & 1:
            # Betaflight 4.5 does not check the age of the MSP frame: the last one acts as long as the radio sends.
            return max(PULSE_MIN_US, min(PULSE_MAX_US, self._msp[position]))
        return self.radio[position] if self.radio and position < len(self.radio) else 0

    def _update_channels(self, raw, now_ms: int, boxes, failsafe_active: bool) -> None:
        """Compute `channels` from raw values: valid ones pass, invalid ones are held, then replaced."""
        by_switch = "FAILSAFE" in boxes
        self.valid = self.signal and not by_switch
        for channel, sample in enumerate(raw):
            good = self.valid and PULSE_MIN_US <= sample <= PULSE_MAX_US
            if good:
                self._hold_until_ms[channel] = now_ms + HOLD_MS
            if failsafe_active and channel < STICKS:
                sample = sample if good else self._landing(channel)
            elif failsafe_active or by_switch:
                sample = self._lost(channel, sample if by_switch else self.channels[channel])
            elif not good and now_ms < self._hold_until_ms[channel]:
                sample = self.channels[channel]
            elif not good:
                self.valid = self.valid and channel >= STICKS
                sample = self._lost(channel, self.channels[channel])
            self.channels[channel] = float(max(CLIP_MIN_US, min(CLIP_MAX_US, sample)))

    def _lost(self, channel: int, held: float) -> float:
        if channel == THROTTLE:
            return PULSE_MIN_US
        return self._settings.mid_us if channel < STICKS else held

    def _landing(self, channel: int) -> float:
        throttle = channel == THROTTLE
        return self._settings.failsafe.landing_throttle_us if throttle else self._settings.mid_us

"""The receiver: frames by MSP or from the pilot's radio, and what the firmware makes of a link that falls silent.

Betaflight 4.5, rx.c, rx/msp.c, rx/msp_override.c: 100 ms without a frame and the signal counts as lost; the last values
are held until 300 ms; then the sticks go to the centre and the throttle down, switches keep their place.
"""

from swift_sim_bridge.flight_controller import modes
from swift_sim_bridge.flight_controller.firmware_settings import FirmwareSettings

CHANNELS = 18
THROTTLE = 3
STICKS = 4
PULSE_MIN_US, PULSE_MAX_US = 885, 2115  # beyond these a channel is invalid
CLIP_MIN_US, CLIP_MAX_US = 750, 2250
SIGNAL_MS = 100
HOLD_MS = 300


class Receiver:
    """channels: what the firmware flies by, us, in its own order: roll, pitch, yaw, throttle, AUX1..AUX14.

    signal: frames come; valid: the flight channels are good; radio: None while the pilot's radio is off, else what it
    sends again and again (us, in the channel map's order): a test or a simulated pilot sets it.
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
        """Take one MSP_SET_RAW_RC frame of at most CHANNELS values in us; channels that it lacks read as 0."""
        self._msp = [*frame, *[0] * (CHANNELS - len(frame))]
        self._msp_fresh = True

    def update(self, now_ms: int, boxes: frozenset[str], failsafe_active: bool) -> bool:
        """Look for a frame at the time `now_ms`; return whether `channels` were worked out anew.

        boxes: modes switched on so far. A signal is looked for every 10 ms here and all the time in the firmware, so
        what it calls later than 100 ms is the tick of 100 ms.
        """
        fresh = self._msp_fresh if self._settings.receiver == "msp" else self.radio is not None
        self._msp_fresh = False
        if not fresh and now_ms < self._signal_until_ms:
            return False
        self.signal = fresh
        self._signal_until_ms = now_ms + SIGNAL_MS
        self._judge([self._raw(channel, boxes) for channel in range(CHANNELS)], now_ms, boxes, failsafe_active)
        return True

    def _raw(self, channel: int, boxes) -> float:
        place = self._map[channel]
        if self._settings.receiver == "msp":
            return self._msp[place]
        if "MSP OVERRIDE" in boxes and self._settings.override_mask >> place & 1:
            # Nothing here looks at the age of the MSP frame: 4.5 flies the last one for as long as the radio lives.
            return max(PULSE_MIN_US, min(PULSE_MAX_US, self._msp[place]))
        return self.radio[place] if self.radio and place < len(self.radio) else 0

    def _judge(self, raw, now_ms: int, boxes, failsafe_active: bool) -> None:
        """Turn raw values into `channels`: good ones pass, bad ones are held, then replaced."""
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

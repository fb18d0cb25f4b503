"""The firmware's failsafe when no valid receiver frames arrive (Betaflight 4.5, failsafe.c).

Stage 1 is part of the receiver: it holds and then centres the sticks. Stage 2 drops or lands the vehicle, `delay_s`
after the last valid frame.
"""

import enum

from swift_sim_bridge.flight_controller.arming import Arming, Block
from swift_sim_bridge.flight_controller.firmware_settings import FailsafeSettings

POWER_ON_DELAY_MS = 5000  # the failsafe does nothing in the first 5 s after power-on
SHORTEST_PERIOD_MS = 100  # lower bound of the configurable delays


class Phase(enum.Enum):
    """Phases of the state machine, with the firmware's names."""

    IDLE = enum.auto()
    LOSS_DETECTED = enum.auto()
    LANDING = enum.auto()
    LANDED = enum.auto()
    MONITORING = enum.auto()
    RECOVERED = enum.auto()


class Failsafe:
    """State machine of the failsafe.

    Attributes:
        phase: phase of the state machine.
        active: whether stage 2 has begun.
        link_up: whether valid frames have arrived for long enough.
    """

    def __init__(self, settings: FailsafeSettings, arming: Arming):
        self._settings = settings
        self._arming = arming
        self._failure_ms = max(SHORTEST_PERIOD_MS, round(1000 * settings.delay_s))
        self._recovery_ms = max(SHORTEST_PERIOD_MS, round(1000 * settings.recovery_delay_s))
        self._received_ms = 0
        self._failed_ms: int | None = None
        self._throttle_low_from_ms = 0
        self._landed_by_ms = 0
        self._trusted_from_ms = 0
        self.phase = Phase.IDLE
        self.active = False
        self.link_up = False

    def take_frame(self, now_ms: int, valid: bool) -> None:
        """Note a receiver frame, or with `valid` false that the signal is still lost."""
        if not valid:
            self._failed_ms = now_ms
            self._arming.mark(Block.RX_FAILSAFE, True)
            self._check_period(now_ms)
            return
        self._received_ms = now_ms
        if self._failed_ms is None:
            self._failed_ms = now_ms
            self._arming.mark(Block.RX_FAILSAFE, True)
        if now_ms - self._failed_ms > self._recovery_ms:
            self.link_up = True
            self._arming.mark(Block.RX_FAILSAFE, False)

    def _check_period(self, now_ms: int) -> None:
        if now_ms - self._received_ms > self._failure_ms:
            self.link_up = False
            self._arming.mark(Block.RX_FAILSAFE, True)

    def update(self, now_ms: int, throttle_low: bool) -> None:
        """Run the state machine; call it every 10 ms."""
        self._check_period(now_ms)
        if now_ms <= POWER_ON_DELAY_MS:
            return
        before = None
        while before != self.phase:
            before = self.phase
            _STEPS[self.phase](self, now_ms, throttle_low)

    def _idle(self, now_ms: int, throttle_low: bool) -> None:
        if not self._arming.armed:
            self._throttle_low_from_ms = 0
            return
        if not throttle_low:
            self._throttle_low_from_ms = now_ms + round(1000 * self._settings.throttle_low_delay_s)
        if self.link_up:
            return
        self.active = now_ms > self._throttle_low_from_ms
        self.phase = Phase.LANDED if self.active else Phase.LOSS_DETECTED

    def _loss_detected(self, now_ms: int, _) -> None:
        if self.link_up:
            self.phase = Phase.RECOVERED
            return
        self.active = True
        self._landed_by_ms = now_ms + round(1000 * self._settings.landing_s)
        self.phase = Phase.LANDING if self._settings.procedure == "land" else Phase.LANDED

    def _landing(self, now_ms: int, _) -> None:
        if self.link_up:
            self.phase = Phase.RECOVERED
        elif now_ms > self._landed_by_ms or not self._arming.armed:
            self.phase = Phase.LANDED

    def _landed(self, now_ms: int, _) -> None:
        self._arming.disarm()
        self._arming.mark(Block.FAILSAFE, True)
        self._trusted_from_ms = now_ms + self._recovery_ms
        self.phase = Phase.MONITORING

    def _monitoring(self, now_ms: int, _) -> None:
        if not self.link_up:
            self._trusted_from_ms = now_ms + self._recovery_ms
        elif now_ms > self._trusted_from_ms:
            self.phase = Phase.RECOVERED

    def _recovered(self, now_ms: int, _) -> None:
        self._throttle_low_from_ms = now_ms + round(1000 * self._settings.throttle_low_delay_s)
        self.active = False
        self._arming.mark(Block.FAILSAFE, False)
        self.phase = Phase.IDLE


_STEPS = {
    Phase.IDLE: Failsafe._idle,
    Phase.LOSS_DETECTED: Failsafe._loss_detected,
    Phase.LANDING: Failsafe._landing,
    Phase.LANDED: Failsafe._landed,
    Phase.MONITORING: Failsafe._monitoring,
    Phase.RECOVERED: Failsafe._recovered,
}

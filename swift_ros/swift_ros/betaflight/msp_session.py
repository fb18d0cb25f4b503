"""MSP session with the flight controller: stick frames, requests for measurements, and their answers."""

import math
from collections import deque

from swift_ros.betaflight import msp
from swift_ros.betaflight import msp_messages as wire
from swift_ros.betaflight.msp_messages import Code

# The firmware handles one frame or request in each run of its serial task, 100 runs per second unless
# `serial_update_rate_hz` sets more, and stick frames must not queue. In real time, with more than CROWDED unanswered
# frames and requests (60 ms of stick frames), only one request is sent at a time. With more than OVERLOADED (0.25 s of
# stick frames) the firmware does not keep up.
CROWDED, OVERLOADED = 6, 25
LOST_S = 0.5  # s; an unanswered request older than this counts as lost
# Requests by decreasing importance.
REQUESTS = (Code.STATUS_EX, Code.ATTITUDE, Code.BATTERY_STATE, Code.MOTOR_TELEMETRY, Code.MOTOR)
KNOWN = {Code.SET_RAW_RC, *REQUESTS}


class MspSession:
    """Unanswered frames and requests, and the newest answers.

    Attributes:
        status: MSP_STATUS_EX; None before the first answer, as the following ones.
        battery: MSP_BATTERY_STATE.
        attitude: MSP_ATTITUDE.
        motors: MSP_MOTOR, us.
        rotors: MSP_MOTOR_TELEMETRY.
        attitude_s: s of the flight's clock when `attitude` was received.
        replied_s: s of the steady clock when the last answer was received.
        answered_s: s of the flight's clock at that time.
        round_trip_ms: ms from request to answer of the last answer.
    """

    def __init__(self, status_ticks: int, battery_ticks: int, rotor_ticks: int, bounded: bool):
        """Start without answers.

        Args:
            status_ticks: number of frames between two requests of status and attitude.
            battery_ticks: number of frames between two requests of the battery.
            rotor_ticks: number of frames between two requests of rotors and motors.
            bounded: whether requests wait for slow answers, as in real time.
        """
        self.status: wire.Status | None = None
        self.battery: wire.BatteryState | None = None
        self.attitude: wire.Attitude | None = None
        self.motors: tuple[int, ...] | None = None
        self.rotors: tuple[wire.MotorTelemetry, ...] | None = None
        self.attitude_s = -math.inf
        self.replied_s = self.answered_s = -math.inf
        self.round_trip_ms = math.nan
        ticks = (status_ticks, status_ticks, battery_ticks, rotor_ticks, rotor_ticks)
        self._ticks = dict(zip(REQUESTS, ticks, strict=True))
        self._due: list[Code] = []
        self._bounded = bounded
        self._parser = msp.Parser()
        self._unsupported = 0
        self._unanswered: deque[tuple[int, float]] = deque()

    @property
    def frames_bad(self) -> int:
        """Number of received frames that were incomplete, corrupt or unknown."""
        return self._parser.bad + self._unsupported

    @property
    def has_open_request(self) -> bool:
        """Whether a request other than a stick frame is unanswered."""
        return any(code != Code.SET_RAW_RC for code, _ in self._unanswered)

    def frame(self, channels, steady_s: float) -> bytes:
        """Return the stick frame of these channels, us."""
        self._unanswered.append((Code.SET_RAW_RC, steady_s))
        return msp.encode(msp.Message(Code.SET_RAW_RC, wire.encode_channels(channels), msp.REQUEST))

    @property
    def overloaded(self) -> bool:
        """Whether the flight controller does not keep up with the frames."""
        return self._bounded and len(self._unanswered) > OVERLOADED

    def requests(self, frames_sent: int, urgent: bool, steady_s: float) -> bytes:
        """Return the requests that are due.

        Args:
            frames_sent: number of stick frames sent so far.
            urgent: whether to request status and attitude in any case.
            steady_s: s of the steady clock.
        """
        new = [code for code, ticks in self._ticks.items() if frames_sent % ticks == 0]
        new += [Code.STATUS_EX, Code.ATTITUDE] * urgent
        self._due = [code for code in REQUESTS if code in new or code in self._due]
        sent, self._due = self._due, []
        if self._bounded:
            while self._unanswered and steady_s - self._unanswered[0][1] > LOST_S:
                self._unanswered.popleft()
            if len(self._unanswered) > CROWDED:
                count = 0 if self.has_open_request else 1
                sent, self._due = sent[:count], sent[count:]
        self._unanswered.extend((code, steady_s) for code in sent)
        return b"".join(msp.encode(msp.Message(code, kind=msp.REQUEST)) for code in sent)

    def receive(self, chunk: bytes, arrived_s: float, time_s: float) -> set[Code]:
        """Take received bytes.

        Args:
            chunk: bytes, split anywhere.
            arrived_s: s of the steady clock when they arrived.
            time_s: s of the flight's clock.

        Returns:
            Codes of the new answers.
        """
        news = set()
        for message in self._parser.feed(chunk):
            if message.kind == msp.REQUEST or message.code not in KNOWN:
                self._unsupported += 1
                continue
            requested_s = self._match(message.code)
            if requested_s is None:  # the request was given up
                continue
            self.round_trip_ms, self.replied_s, self.answered_s = 1e3 * (arrived_s - requested_s), arrived_s, time_s
            if message.kind == msp.REPLY and message.code != Code.SET_RAW_RC:
                try:
                    self._store(message, time_s)
                    news.add(Code(message.code))
                except wire.PayloadError:
                    self._unsupported += 1
        return news

    def drop_requests(self) -> None:
        """Stop waiting for the answers to all requests so far."""
        self._unanswered.clear()

    def _match(self, code: int) -> float | None:
        """Return when `code` was requested. Answers arrive in order: earlier requests will not be answered."""
        if all(requested != code for requested, _ in self._unanswered):
            return None
        while True:
            requested, requested_s = self._unanswered.popleft()
            if requested == code:
                return requested_s

    def _store(self, message: msp.Message, time_s: float) -> None:
        payload = message.payload
        match message.code:
            case Code.STATUS_EX:
                self.status = wire.decode_status(payload)
            case Code.ATTITUDE:
                self.attitude, self.attitude_s = wire.decode(wire.Attitude, payload), time_s
            case Code.BATTERY_STATE:
                self.battery = wire.decode(wire.BatteryState, payload)
            case Code.MOTOR:
                self.motors = wire.decode_channels(payload)
            case Code.MOTOR_TELEMETRY:
                self.rotors = wire.decode_motor_telemetry(payload)

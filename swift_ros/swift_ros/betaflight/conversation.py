"""Questions to the flight controller and its answers, while frames flow: what it measures, and how it keeps up."""

import math
from collections import deque

from swift_ros.betaflight import msp
from swift_ros.betaflight import msp_messages as wire
from swift_ros.betaflight.msp_messages import Code

# The firmware handles one frame or question a pass of its serial task, 100 passes a second unless
# `serial_update_rate_hz` says more, and sticks must not queue: in real time, with more than CROWDED of them unanswered,
# there is only one question at a time, and with more than BEHIND it does not keep up.
CROWDED, BEHIND = 6, 25
LOST_S = 0.5  # an answer that took longer will not come
QUESTIONS = (Code.STATUS_EX, Code.ATTITUDE, Code.BATTERY_STATE, Code.MOTOR_TELEMETRY, Code.MOTOR)  # by importance
KNOWN = {Code.SET_RAW_RC, *QUESTIONS}


class Conversation:
    """What was asked, and the newest answers (None before the first).

    status, battery, attitude, motors (us), rotors; attitude_s: when the attitude came; round_trip_ms: of the last
    answer; replied_s: when it came, steady clock. Questions are due every `status_ticks`, `battery_ticks` and
    `rotor_ticks` frames; `bounded`: in real time they wait for slow answers.
    """

    def __init__(self, status_ticks: int, battery_ticks: int, rotor_ticks: int, bounded: bool):
        self.status: wire.Status | None = None
        self.battery: wire.BatteryState | None = None
        self.attitude: wire.Attitude | None = None
        self.motors: tuple[int, ...] | None = None
        self.rotors: tuple[wire.MotorTelemetry, ...] | None = None
        self.attitude_s = -math.inf
        self.replied_s = -math.inf
        self.round_trip_ms = math.nan
        ticks = (status_ticks, status_ticks, battery_ticks, rotor_ticks, rotor_ticks)
        self._ticks = dict(zip(QUESTIONS, ticks, strict=True))
        self._due: list[Code] = []
        self._bounded = bounded
        self._parser = msp.Parser()
        self._unknown = 0
        self._asked: deque[tuple[int, float]] = deque()

    @property
    def frames_bad(self) -> int:
        """Frames received torn, corrupt or unknown, and skipped."""
        return self._parser.bad + self._unknown

    @property
    def waits(self) -> bool:
        """Whether a question (not a mere RC frame) is unanswered."""
        return any(code != Code.SET_RAW_RC for code, _ in self._asked)

    def frame(self, channels, steady_s: float) -> bytes:
        """Return the RC frame of these channels (us)."""
        self._asked.append((Code.SET_RAW_RC, steady_s))
        return msp.encode(msp.Message(Code.SET_RAW_RC, wire.encode_channels(channels), msp.REQUEST))

    @property
    def behind(self) -> bool:
        """Whether the flight controller does not keep up with the frames."""
        return self._bounded and len(self._asked) > BEHIND

    def questions(self, frames_sent: int, urgent: bool, steady_s: float) -> bytes:
        """Return what to ask after this many frames; urgent: status and attitude in any case."""
        new = [code for code, ticks in self._ticks.items() if frames_sent % ticks == 0]
        new += [Code.STATUS_EX, Code.ATTITUDE] * urgent
        self._due = [code for code in QUESTIONS if code in new or code in self._due]
        asking, self._due = self._due, []
        if self._bounded:
            while self._asked and steady_s - self._asked[0][1] > LOST_S:
                self._asked.popleft()
            if len(self._asked) > CROWDED:
                one = 0 if self.waits else 1
                asking, self._due = asking[:one], asking[one:]
        self._asked.extend((code, steady_s) for code in asking)
        return b"".join(msp.encode(msp.Message(code, kind=msp.REQUEST)) for code in asking)

    def receive(self, chunk: bytes, arrived_s: float, time_s: float) -> set[Code]:
        """Take bytes that arrived at `arrived_s` on the steady clock, `time_s` on the flight's; return what is new."""
        news = set()
        for message in self._parser.feed(chunk):
            if message.kind == msp.REQUEST or message.code not in KNOWN:
                self._unknown += 1
                continue
            asked_s = self._take(message.code)
            if asked_s is None:  # given up long ago
                continue
            self.round_trip_ms, self.replied_s = 1e3 * (arrived_s - asked_s), arrived_s
            if message.kind == msp.REPLY and message.code != Code.SET_RAW_RC:
                try:
                    self._understand(message, time_s)
                    news.add(Code(message.code))
                except wire.PayloadError:
                    self._unknown += 1
        return news

    def give_up(self) -> None:
        """Expect no answer any more to what was asked so far."""
        self._asked.clear()

    def _take(self, code: int) -> float | None:
        """Return when `code` was asked for. Answers come in order: what was asked before it will get none."""
        if all(asked != code for asked, _ in self._asked):
            return None
        while True:
            asked, asked_s = self._asked.popleft()
            if asked == code:
                return asked_s

    def _understand(self, message: msp.Message, time_s: float) -> None:
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

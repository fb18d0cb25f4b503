"""A scripted flight controller for tests: answers MSP, takes stick frames, arms as the firmware does. No physics."""

from dataclasses import replace

from swift_ros.betaflight import msp
from swift_ros.betaflight import msp_messages as wire
from swift_ros.betaflight.arming_flags import ARMING_FLAGS
from swift_ros.betaflight.msp_messages import Code

ARM_AUX, ANGLE_AUX, OVERRIDE_AUX = 0, 1, 2
THROTTLE_FLAG = 1 << ARMING_FLAGS.index("THROTTLE")
BOOT_GRACE_FLAG = 1 << ARMING_FLAGS.index("BOOT_GRACE_TIME")


class FakeFirmware:
    """A flight controller whose attributes a test sets before or during a flight.

    Attributes:
        flags: arming-disable bits.
        frames: logical channels (roll, pitch, yaw, throttle, AUX...) of every stick frame.
        angle_answers: whether angle mode follows its switch.
        mute: whether it stops answering.
        refuses_arming: whether it ignores the ARM switch.
        override: the pilot's MSP OVERRIDE switch.
        pilot_arms: the pilot's ARM switch.
    """

    def __init__(self):
        self.boxes, self.names = [0, 1, 27, 50], "ARM;ANGLE;FAILSAFE;MSP OVERRIDE;"
        self.ranges = [wire.ModeRange(box, aux, 1700, 2100) for aux, box in enumerate((0, 1, 50))]
        self.rates = wire.RcTuning(120, 0, (60, 60, 30), 50, 0, 0, 100, 120, 0, 0, 100, (1998, 1998, 1998), 0)
        self.receiver = wire.RxConfig(1900, 1500, 1050, 0, 30, 1)
        self.failsafe = wire.FailsafeConfig(1.5, 1.0, 1000, 0, 10.0, 1)
        self.pid = wire.PidAdvanced(60, 5, 100, 0, 0)
        self.features = wire.FEATURE_RX_MSP | wire.FEATURE_AIRMODE
        self.channel_map = bytes([0, 1, 3, 2, 4, 5, 6, 7])  # AETR1234
        self.api, self.variant = wire.ApiVersion(0, 1, 46), b"BTFL"
        self.attitude = wire.Attitude(0.0, 0.0, 0.0)
        self.battery = wire.BatteryState(4, 1.55, 0.0, 5.0, 0, 16.4)
        self.flags, self.angle_answers, self.mute, self.refuses_arming = 0, True, False, False
        self.armed, self.override, self.pilot_arms = False, False, False
        self.frames: list[list[int]] = []
        self._parser = msp.Parser()

    def ask(self, code, payload=b""):
        """Return the answer to a request, None for a refusal, as `read_back` needs it."""
        answers = {
            Code.API_VERSION: lambda: wire.encode(self.api),
            Code.FC_VARIANT: lambda: self.variant,
            Code.FC_VERSION: lambda: bytes([4, 5, 6]),
            Code.FEATURE_CONFIG: lambda: wire.encode(wire.FeatureConfig(self.features)),
            Code.BOXIDS: lambda: bytes(self.boxes),
            Code.BOXNAMES: lambda: self.names.encode(),
            Code.MODE_RANGES: lambda: wire.encode_mode_ranges(self.ranges) + bytes(8),
            Code.RX_MAP: lambda: self.channel_map,
            Code.RX_CONFIG: lambda: wire.encode(self.receiver),
            Code.RC_DEADBAND: lambda: wire.encode(wire.RcDeadband(0, 0)),
            Code.RC_TUNING: lambda: wire.encode(self.rates),
            Code.FAILSAFE_CONFIG: lambda: wire.encode(self.failsafe),
            Code.ADVANCED_CONFIG: lambda: wire.encode(wire.AdvancedConfig(6, 0.055)),
            Code.MOTOR_CONFIG: lambda: wire.encode(wire.MotorConfig(1070, 4, 14, 1)),
            Code.PID_ADVANCED: lambda: None if self.pid is None else wire.encode(self.pid),
            Code.STATUS_EX: self._status,
            Code.ATTITUDE: lambda: wire.encode(self.attitude),
            Code.BATTERY_STATE: lambda: wire.encode(self.battery),
            Code.MOTOR: lambda: wire.encode_channels([1055] * 4 + [0] * 4),
            Code.MOTOR_TELEMETRY: lambda: wire.encode_motor_telemetry([wire.MotorTelemetry(3000, 0.0)] * 4),
        }
        return answers[code]() if code in answers else None

    def feed(self, data: bytes) -> bytes:
        """Return the answers to received bytes."""
        replies = b""
        for message in self._parser.feed(data):
            payload = self._take(message.payload) if message.code == Code.SET_RAW_RC else self.ask(message.code)
            kind = msp.REFUSAL if payload is None else msp.REPLY
            replies += msp.encode(replace(message, payload=payload or b"", kind=kind))
        return b"" if self.mute else replies

    def aux(self, number: int) -> int:
        return self.frames[-1][4 + number]

    def _take(self, payload: bytes) -> bytes:
        raw = wire.decode_channels(payload)
        self.frames.append([raw[self.channel_map[i]] if i < 8 else raw[i] for i in range(len(raw))])
        switch = self.aux(ARM_AUX) > 1700 if self.features & wire.FEATURE_RX_MSP else self.pilot_arms
        throttle_low = self.frames[-1][3] < self.receiver.min_check_us
        self.armed = switch and not self.refuses_arming and (self.armed or (throttle_low and not self.flags))
        return b""

    def _status(self) -> bytes:
        angle = bool(self.frames) and self.aux(ANGLE_AUX) > 1700 and self.angle_answers
        bits = [self.armed, angle, False, self.override]
        modes = sum(1 << i for i, on in enumerate(bits[: len(self.boxes)]) if on)
        return wire.Status(modes, self.flags, 26).encode()

"""Payloads of MSP messages, encoded and decoded, as in Betaflight 4.5 and 2025.12.

Most payloads are a fixed sequence of little-endian numbers, declared by the fields of a dataclass. Newer firmware
appends fields: without them, the fields have their defaults. Source: the firmware's `msp.c`.
"""

import dataclasses
import enum
import struct
from dataclasses import MISSING, dataclass, field
from typing import Any


class Code(enum.IntEnum):
    """Message codes with the firmware's names, without MSP_."""

    API_VERSION = 1
    FC_VARIANT = 2
    FC_VERSION = 3
    MODE_RANGES = 34
    FEATURE_CONFIG = 36
    RX_CONFIG = 44
    RX_MAP = 64
    FAILSAFE_CONFIG = 75
    ADVANCED_CONFIG = 90
    PID_ADVANCED = 94
    MOTOR = 104
    RC = 105
    ATTITUDE = 108
    ANALOG = 110
    RC_TUNING = 111
    BOXNAMES = 116
    BOXIDS = 119
    RC_DEADBAND = 125
    BATTERY_STATE = 130
    MOTOR_CONFIG = 131
    MOTOR_TELEMETRY = 139
    STATUS_EX = 150
    SET_RAW_RC = 200


class PayloadError(Exception):
    """A payload is too short or invalid; the text names the message."""


def _number(kind: str, count: int = 1, scale: float | None = None, skip: int = 0, default: Any = MISSING) -> Any:
    """Declare a field of a payload.

    Args:
        kind: format character of `struct`.
        count: how many numbers.
        scale: factor to SI units; None for the raw number.
        skip: bytes between the previous field and this one.
        default: value where the payload ends before the field.
    """
    metadata = {"layout": struct.Struct(f"<{skip}x{count}{kind}"), "count": count, "scale": scale}
    return field(metadata=metadata, default=default)


def decode(record_type, payload: bytes):
    """Return a record of a payload. Raises PayloadError when the payload is too short."""
    values, offset = {}, 0
    for spec in dataclasses.fields(record_type):
        layout, scale = spec.metadata["layout"], spec.metadata["scale"]
        if offset + layout.size > len(payload):
            if spec.default is not MISSING:
                break
            raise PayloadError(f"{record_type.__name__} with {len(payload)} bytes lacks its '{spec.name}'")
        numbers = layout.unpack_from(payload, offset)
        numbers = numbers if scale is None else tuple(n * scale for n in numbers)
        values[spec.name] = numbers if spec.metadata["count"] > 1 else numbers[0]
        offset += layout.size
    return record_type(**values)


def encode(record) -> bytes:
    """Return the payload of a record; bytes without a field are zero."""
    parts = []
    for spec in dataclasses.fields(record):
        value, scale = getattr(record, spec.name), spec.metadata["scale"]
        numbers = value if spec.metadata["count"] > 1 else (value,)
        parts.append(spec.metadata["layout"].pack(*(n if scale is None else round(n / scale) for n in numbers)))
    return b"".join(parts)


@dataclass(frozen=True)
class ApiVersion:
    """MSP_API_VERSION."""

    protocol: int = _number("B")
    major: int = _number("B")
    minor: int = _number("B")


@dataclass(frozen=True)
class FcVersion:
    """MSP_FC_VERSION; `major` is 4, or the year minus 2000 from 2025.12 on."""

    major: int = _number("B")
    minor: int = _number("B")
    patch: int = _number("B")


@dataclass(frozen=True)
class FeatureConfig:
    """MSP_FEATURE_CONFIG; `enabled` has the bits FEATURE_*."""

    enabled: int = _number("I")


# bits of MSP_FEATURE_CONFIG
FEATURE_MOTOR_STOP, FEATURE_3D, FEATURE_RX_MSP, FEATURE_AIRMODE = 1 << 4, 1 << 12, 1 << 14, 1 << 22


@dataclass(frozen=True)
class RxConfig:
    """MSP_RX_CONFIG.

    Attributes:
        max_check_us, centre_us, min_check_us: us.
        rc_smoothing_hz: Hz, cutoff of the setpoints; 0 when the firmware chooses it.
        rc_smoothing_auto_factor: factor by which the firmware chooses it.
        rc_smoothing: 1 when smoothing is on.
    """

    max_check_us: int = _number("H", skip=1)
    centre_us: int = _number("H")
    min_check_us: int = _number("H")
    rc_smoothing_hz: int = _number("B", skip=18)
    rc_smoothing_auto_factor: int = _number("B", skip=4, default=0)
    rc_smoothing: int = _number("B", default=0)


@dataclass(frozen=True)
class FailsafeConfig:
    """MSP_FAILSAFE_CONFIG.

    Attributes:
        delay_s: s from the last frame to the procedure.
        landing_s: s that a landing lasts.
        throttle_us: us, throttle while landing.
        switch_mode: effect of the failsafe switch.
        throttle_low_delay_s: s of closed throttle after which the failsafe disarms at once.
        procedure: index of FAILSAFE_PROCEDURES.
    """

    delay_s: float = _number("B", scale=0.1)
    landing_s: float = _number("B", scale=0.1)
    throttle_us: int = _number("H")
    switch_mode: int = _number("B")
    throttle_low_delay_s: float = _number("H", scale=0.1)
    procedure: int = _number("B")


FAILSAFE_PROCEDURES = ("landing", "drop", "GPS rescue")


@dataclass(frozen=True)
class AdvancedConfig:
    """MSP_ADVANCED_CONFIG.

    Attributes:
        motor_protocol: 5 (DSHOT150) and above are digital.
        motor_idle: share of the motors' range of an armed digital motor at zero throttle.
    """

    motor_protocol: int = _number("B", skip=3)
    motor_idle: float = _number("H", scale=1e-4, skip=2)


@dataclass(frozen=True)
class PidAdvanced:
    """MSP_PID_ADVANCED: angle mode, and settings that modify the throttle.

    Attributes:
        angle_limit_deg: degrees of tilt at full stick in angle mode.
        throttle_boost: gain of throttle boost.
        motor_output_limit_percent: percent of the motors' range.
        sag_compensation: percent of sag compensation.
        thrust_linearisation: percent of thrust linearisation.
    """

    angle_limit_deg: int = _number("B", skip=17)
    throttle_boost: int = _number("B", skip=12)
    motor_output_limit_percent: int = _number("B", skip=16, default=100)
    sag_compensation: int = _number("B", skip=7, default=0)
    thrust_linearisation: int = _number("B", default=0)


@dataclass(frozen=True)
class RcTuning:
    """MSP_RC_TUNING: the rate profile in the firmware's whole numbers; triples are roll, pitch, yaw."""

    rc_rate_roll: int = _number("B")
    expo_roll: int = _number("B")
    super_rate: tuple[int, int, int] = _number("B", 3)
    throttle_mid: int = _number("B", skip=1)
    throttle_expo: int = _number("B")
    expo_yaw: int = _number("B", skip=2)
    rc_rate_yaw: int = _number("B")
    rc_rate_pitch: int = _number("B")
    expo_pitch: int = _number("B")
    throttle_limit_type: int = _number("B")
    throttle_limit_percent: int = _number("B")
    limit_deg_s: tuple[int, int, int] = _number("H", 3)
    rates_type: int = _number("B")
    throttle_hover: int = _number("B", default=50)


@dataclass(frozen=True)
class RcDeadband:
    """MSP_RC_DEADBAND: us around the centre; roll and pitch have the same."""

    deadband_us: int = _number("B")
    yaw_deadband_us: int = _number("B")


@dataclass(frozen=True)
class Analog:
    """MSP_ANALOG.

    Attributes:
        drawn_ah: A h.
        rssi: signal strength, 0 to 1023.
        current: A.
        voltage: V.
    """

    drawn_ah: float = _number("H", scale=1e-3, skip=1)
    rssi: int = _number("H")
    current: float = _number("h", scale=0.01)
    voltage: float = _number("H", scale=0.01)


@dataclass(frozen=True)
class BatteryState:
    """MSP_BATTERY_STATE.

    Attributes:
        cells: number of cells; 0 without a battery.
        capacity_ah: A h.
        drawn_ah: A h.
        current: A.
        alert: alert state of the battery.
        voltage: V.
    """

    cells: int = _number("B")
    capacity_ah: float = _number("H", scale=1e-3)
    drawn_ah: float = _number("H", scale=1e-3, skip=1)
    current: float = _number("h", scale=0.01)
    alert: int = _number("B")
    voltage: float = _number("H", scale=0.01)


@dataclass(frozen=True)
class Attitude:
    """MSP_ATTITUDE: roll and pitch in rad with the firmware's signs, heading in rad, clockwise."""

    roll: float = _number("h", scale=0.1 * 3.141592653589793 / 180)
    pitch: float = _number("h", scale=0.1 * 3.141592653589793 / 180)
    heading: float = _number("h", scale=3.141592653589793 / 180)


@dataclass(frozen=True)
class MotorConfig:
    """MSP_MOTOR_CONFIG.

    Attributes:
        min_throttle_us: us, idle of analogue motors up to 4.5.
        motors: number of motors.
        poles: number of poles of a motor.
        dshot_telemetry: 1 when rotor speeds come from bidirectional DShot.
        esc_sensor: 1 when rotor speeds come from ESC telemetry.
    """

    min_throttle_us: int = _number("H")
    motors: int = _number("B", skip=4)
    poles: int = _number("B")
    dshot_telemetry: int = _number("B")
    esc_sensor: int = _number("B", default=0)


@dataclass(frozen=True)
class Status:
    """MSP_STATUS_EX.

    Attributes:
        modes: bits of the active modes, in the order of MSP_BOXIDS.
        arming_disable: bits of the arming-disable flags.
        arming_flags: number of arming-disable flags.
    """

    modes: int
    arming_disable: int
    arming_flags: int

    def encode(self) -> bytes:
        """Return the payload of MSP_STATUS_EX (no load, sensors or errors)."""
        more = (self.modes >> 32).to_bytes(4, "little")
        head = struct.pack("<HHHIBHBBB", 125, 0, 0, self.modes & 0xFFFFFFFF, 0, 0, 1, 0, len(more))
        return head + more + struct.pack("<BIBH", self.arming_flags, self.arming_disable, 0, 0)


def decode_status(payload: bytes) -> Status:
    """Return MSP_STATUS_EX. Raises PayloadError when it is too short."""
    if len(payload) < 16 or len(payload) < 21 + (payload[15] & 0xF):
        raise PayloadError(f"STATUS_EX has only {len(payload)} bytes")
    count = payload[15] & 0xF
    modes = int.from_bytes(payload[6:10] + payload[16 : 16 + count], "little")
    flags, disable = struct.unpack_from("<BI", payload, 16 + count)
    return Status(modes, disable, flags)


@dataclass(frozen=True)
class ModeRange:
    """The mode with permanent id `box` is on while AUX channel `aux` (0 = AUX1) is in low_us..high_us."""

    box: int
    aux: int
    low_us: int
    high_us: int


def decode_mode_ranges(payload: bytes) -> tuple[ModeRange, ...]:
    """Return the mode ranges without the empty slots, which the firmware also sends."""
    rows = (payload[i : i + 4] for i in range(0, len(payload) - 3, 4))
    return tuple(ModeRange(row[0], row[1], 900 + 25 * row[2], 900 + 25 * row[3]) for row in rows if row[2] < row[3])


def encode_mode_ranges(ranges) -> bytes:
    """Return the payload of MSP_MODE_RANGES."""
    return bytes(n for r in ranges for n in (r.box, r.aux, (r.low_us - 900) // 25, (r.high_us - 900) // 25))


def decode_names(payload: bytes) -> tuple[str, ...]:
    """Return the box names of MSP_BOXNAMES."""
    return tuple(name for name in payload.decode("ascii", "replace").split(";") if name)


def decode_channels(payload: bytes) -> tuple[int, ...]:
    """Return the values of MSP_RC or MSP_MOTOR, us."""
    return struct.unpack(f"<{len(payload) // 2}H", payload[: len(payload) // 2 * 2])


def encode_channels(values) -> bytes:
    """Return the payload of MSP_SET_RAW_RC."""
    return struct.pack(f"<{len(values)}H", *values)


@dataclass(frozen=True)
class MotorTelemetry:
    """Telemetry of one motor: speed in rpm, percentage of lost telemetry frames."""

    rpm: int
    invalid_percent: float


_MOTOR_ROW = struct.Struct("<IHBHHH")


def decode_motor_telemetry(payload: bytes) -> tuple[MotorTelemetry, ...]:
    """Return a record for each motor. Raises PayloadError when the payload is too short."""
    count = payload[0] if payload else 0
    if len(payload) < 1 + count * _MOTOR_ROW.size:
        raise PayloadError(f"MOTOR_TELEMETRY of {count} motors has only {len(payload)} bytes")
    rows = (_MOTOR_ROW.unpack_from(payload, 1 + i * _MOTOR_ROW.size) for i in range(count))
    return tuple(MotorTelemetry(row[0], row[1] * 0.01) for row in rows)


def encode_motor_telemetry(motors) -> bytes:
    """Return the payload of MSP_MOTOR_TELEMETRY."""
    rows = (_MOTOR_ROW.pack(m.rpm, round(m.invalid_percent * 100), 0, 0, 0, 0) for m in motors)
    return bytes([len(motors)]) + b"".join(rows)

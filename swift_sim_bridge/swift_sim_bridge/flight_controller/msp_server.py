"""Answers of the simulated firmware over MSP, with payloads as in Betaflight 4.5 (msp.c).

Each answer is a function of the flight controller and the request's payload. An unknown command or an invalid payload
is refused, as the firmware does.
"""

import struct
from functools import partial

from swift_sim_bridge.flight_controller import modes
from swift_sim_bridge.flight_controller.arming import BLOCK_COUNT, Block
from swift_sim_bridge.flight_controller.configuration import cli_settings
from swift_sim_bridge.flight_controller.configuration.controller_section import DumpedController
from swift_sim_bridge.flight_controller.firmware_settings import PERMANENT_IDS, PROCEDURES
from swift_sim_bridge.flight_controller.msp_framing import RequestReader, encode_answer
from swift_sim_bridge.flight_controller.receiver import CHANNELS, PULSE_MAX_US, PULSE_MIN_US

API_VERSION = (0, 1, 46)  # protocol, major, minor
FIRMWARE_VERSION = (4, 5, 2)  # major, minor, patch
FEATURE_RX_SERIAL, FEATURE_RX_MSP = 1 << 3, 1 << 14  # bits of MSP_FEATURE_CONFIG
MOTOR_PROTOCOL_DSHOT300 = 6
SENSOR_ACC, SENSOR_GYRO = 1 << 0, 1 << 5  # bits of MSP_STATUS
LOOP_US = 2000  # us, period of the rate loop that MSP_STATUS reports
AIRMODE_START_PERCENT = 25  # the firmware's default
BOXES_PER_PAGE = 32  # of MSP_BOXIDS and MSP_BOXNAMES
SET_RAW_RC, MULTIPLE = 200, 230  # MSP commands


class Refused(Exception):
    """The firmware refuses a request: it answers with `!`."""


class MspServer:
    """One MSP port of a flight controller."""

    def __init__(self, controller):
        self._controller = controller
        self._reader = RequestReader()

    def feed(self, data: bytes) -> bytes:
        """Return the answers to the requests that `data`, split anywhere, completes."""
        answers = []
        for request in self._reader.feed(data):
            if request.command == SET_RAW_RC:
                self._controller.record_command(request.raw)
            if self._controller.is_booting:
                continue
            try:
                answers.append(encode_answer(request, _answer(self._controller, request.command, request.payload)))
            except Refused:
                answers.append(encode_answer(request, b"", refused=True))
        return b"".join(answers)


def _answer(controller, command: int, payload: bytes) -> bytes:
    if command not in ANSWERS:
        raise Refused
    return ANSWERS[command](controller, payload)


def _text(text: str) -> bytes:
    return bytes([len(text)]) + text.encode("ascii")


def _board_info(controller, _) -> bytes:
    board, name = b"SIMU", "SWIFT_SIMULATOR"
    identity = board + struct.pack("<HBB", 0, 0, 0) + _text(name) + _text(name) + _text("")
    return identity + bytes(32) + struct.pack("<BBHIBB", 0, 2, 500, 0, 0, 0)


def _feature_config(controller, _) -> bytes:
    by_msp = controller.settings.receiver == "msp"
    return struct.pack("<I", FEATURE_RX_MSP if by_msp else FEATURE_RX_SERIAL)


def _mode_ranges(controller, _) -> bytes:
    rows = []
    for name, switch in controller.settings.modes.items():
        steps = ((us - modes.RANGE_MIN_US) // modes.STEP_US for us in (switch.low_us, switch.high_us))
        rows.append(bytes([PERMANENT_IDS[name], switch.aux - 1, *steps]))
    return b"".join(rows) + bytes(4 * (modes.RANGE_SLOTS - len(rows)))


def _setting(controller, name: str, default: int = 0) -> int:
    """Return a setting of the CLI dump by its name, a choice as its number; `default` without a dump."""
    if not isinstance(controller.profile, DumpedController):
        return default
    value = controller.profile.settings[name]
    return cli_settings.number_of(name, value) if isinstance(value, str) else value


def _rx_config(controller, _) -> bytes:
    s, setting = controller.settings, partial(_setting, controller)
    checks = struct.pack("<BHHHBHH", 9, s.max_check_us, s.mid_us, s.min_check_us, 0, PULSE_MIN_US, PULSE_MAX_US)
    start_us = 1000 + 10 * setting("airmode_start_throttle_percent", AIRMODE_START_PERCENT)
    airmode = struct.pack("<BBH", 0, 0, start_us)
    cutoffs_hz = (setting("rc_smoothing_setpoint_cutoff"), setting("rc_smoothing_throttle_cutoff"))
    smoothing = bytes(6 + 1 + 2) + bytes(cutoffs_hz) + bytes(2 + 1)
    return (
        checks
        + airmode
        + smoothing
        + bytes([setting("rc_smoothing_auto_factor", 30), setting("rc_smoothing")])
        + bytes(6)
    )


def _failsafe_config(controller, _) -> bytes:
    f = controller.settings.failsafe
    tenths = [round(10 * seconds) for seconds in (f.delay_s, f.landing_s, f.throttle_low_delay_s)]
    procedure = PROCEDURES.index(f.procedure)
    return struct.pack("<BBHBHB", tenths[0], tenths[1], f.landing_throttle_us, 0, tenths[2], procedure)


def _advanced_config(controller, _) -> bytes:
    idle = round(100 * controller.profile.motor_idle)
    head = struct.pack("<BBBBHH", 1, 1, 0, MOTOR_PROTOCOL_DSHOT300, 480, idle)
    return head + struct.pack("<BBBBBHHBBB", 0, 0, 0, 0, 48, 125, 0, 1, 0, 0)


def _pid_advanced(controller, _) -> bytes:
    """Return MSP_PID_ADVANCED; without a dump, feed-forward, boost and compensation are off."""
    setting = partial(_setting, controller)
    per_axis = lambda name: (setting(f"{name}_{axis}") for axis in cli_settings.AXES)  # noqa: E731
    angle_deg = round(controller.settings.angle_limit_deg)
    head = struct.pack(
        "<8xB4xHHB", setting("feedforward_transition"), setting("acc_limit"), setting("acc_limit_yaw"), angle_deg
    )
    anti_gravity = struct.pack("<3xH2x", setting("anti_gravity_gain"))
    relax = bytes([setting("iterm_rotation"), 0, setting("iterm_relax", 2), setting("iterm_relax_type", 1)])
    feedforward = struct.pack("<xBx3Hx", setting("throttle_boost"), *per_axis("f"))
    d_min = bytes([*per_axis("d_min"), setting("d_max_gain"), setting("d_max_advance")])
    limits = bytes([round(controller.profile.iterm_relax_cutoff), setting("motor_output_limit", 100), 255, 0])
    factors = ("averaging", "smooth_factor", "boost", "max_rate_limit", "jitter_factor")
    shaping = bytes(setting(f"feedforward_{name}") for name in factors)
    thrust = bytes([setting("vbat_sag_compensation"), setting("thrust_linear")])
    tpa = struct.pack("<BBH", setting("tpa_mode"), setting("tpa_rate"), setting("tpa_breakpoint", 1350))
    return head + anti_gravity + relax + feedforward + d_min + bytes(2) + limits + shaping + thrust + tpa


def _status(controller, ex: bool) -> bytes:
    states = controller.flight_modes()
    bits = sum(1 << i for i, name in enumerate(modes.available(controller.settings)) if name in states)
    head = struct.pack("<HHHIBH", LOOP_US, 0, SENSOR_ACC | SENSOR_GYRO, bits, 0, 10)
    middle = struct.pack("<BB", 4, 0) if ex else struct.pack("<H", 0)
    return head + middle + struct.pack("<BBIBH", 0, BLOCK_COUNT, int(controller.arming.blocks), 0, 40)


def _raw_imu(controller, _) -> bytes:
    rates = (round(rate) for rate in controller.gyro_deg_s)
    return struct.pack("<3h3h3h", 0, 0, 512, *rates, 0, 0, 0)


def _motor(controller, _) -> bytes:
    commands = controller.readings.motor_command
    outputs = [1000 if u <= 0 else 1001 + round(999 * float(u)) for u in commands]
    return struct.pack("<8H", *outputs, *[0] * (8 - len(outputs)))


def _motor_telemetry(controller, _) -> bytes:
    per_minute = [round(float(speed) * 60 / 6.283185307179586) for speed in controller.readings.rotor_speed]
    centivolts, celsius = round(100 * controller.voltage), 30
    rows = (struct.pack("<IHBHHH", rpm, 0, celsius, centivolts, 0, 0) for rpm in per_minute)
    return bytes([len(per_minute)]) + b"".join(rows)


def _rc(controller, _) -> bytes:
    return struct.pack(f"<{CHANNELS}H", *(int(value) for value in controller.receiver.channels))


def _attitude(controller, _) -> bytes:
    roll, pitch, heading = controller.attitude_deg
    return struct.pack("<hhh", round(10 * roll), round(10 * pitch), int(heading))


def _drawn(controller) -> tuple[int, int]:
    """Return (mAh, hundredths of an ampere)."""
    return min(65535, round(controller.readings.drawn / 3.6)), max(-32768, min(32767, round(100 * controller.current)))


def _analog(controller, _) -> bytes:
    mah, centiamps = _drawn(controller)
    volts = controller.voltage
    return struct.pack("<BHHhH", min(255, round(10 * volts)), mah, 0, centiamps, round(100 * volts))


def _battery_state(controller, _) -> bytes:
    mah, centiamps = _drawn(controller)
    battery, volts = controller.vehicle.battery, controller.voltage
    capacity = round(battery.capacity / 3.6)
    return struct.pack(
        "<BHBHhBH", battery.cells, capacity, min(255, round(10 * volts)), mah, centiamps, 0, round(100 * volts)
    )


def _battery_config(controller, _) -> bytes:
    capacity = round(controller.vehicle.battery.capacity / 3.6)
    return struct.pack("<BBBHBBHHH", 33, 43, 35, capacity, 1, 1, 330, 430, 350)


def _rc_tuning(controller, _) -> bytes:
    r, setting = controller.rates, partial(_setting, controller)
    head = struct.pack("<BB3BBBBH", r.rc_rate[0], r.expo[0], *r.super_rate, 0, r.throttle_mid, r.throttle_expo, 0)
    others = struct.pack("<BBBB", r.expo[2], r.rc_rate[2], r.rc_rate[1], r.expo[1])
    limit = (setting("throttle_limit_type"), setting("throttle_limit_percent", 100))
    return head + others + struct.pack("<BB3HB", *limit, *r.limit, r.type)


def _pid(controller, _) -> bytes:
    pid = controller.profile.pid
    rows = [*pid.roll, *pid.pitch, *pid.yaw, controller.settings.level_gain, 75, 75, 40, 0, 0]
    return bytes(round(value) for value in rows)


def _page(payload: bytes) -> slice:
    first = BOXES_PER_PAGE * (payload[0] if payload else 0)
    return slice(first, first + BOXES_PER_PAGE)


def _box_names(controller, payload: bytes) -> bytes:
    return "".join(f"{name};" for name in modes.available(controller.settings)[_page(payload)]).encode("ascii")


def _box_ids(controller, payload: bytes) -> bytes:
    return bytes(PERMANENT_IDS[name] for name in modes.available(controller.settings)[_page(payload)])


def _motor_config(controller, _) -> bytes:
    poles = controller.settings.motor_poles
    return struct.pack("<HHHBBBB", 1070, 2000, 1000, len(controller.vehicle.rotors), poles, 1, 0)


def _set_raw_rc(controller, payload: bytes) -> bytes:
    count = len(payload) // 2
    if count > CHANNELS:
        raise Refused
    controller.receiver.take_msp(struct.unpack_from(f"<{count}H", payload))
    return b""


def _set_arming_disabled(controller, payload: bytes) -> bytes:
    if not payload:
        raise Refused
    controller.arming.mark(Block.MSP, bool(payload[0]))
    if payload[0]:
        controller.arming.disarm()
    return b""


def _multiple(controller, payload: bytes) -> bytes:
    if not payload:
        raise Refused
    parts = []
    for command in payload:
        try:
            part = _answer(controller, command, b"") if command != MULTIPLE else b""
        except Refused:
            part = b""  # the firmware also sends an empty part
        parts.append(bytes([len(part)]) + part)
    return b"".join(parts)


ANSWERS = {
    1: lambda controller, _: bytes(API_VERSION),
    2: lambda controller, _: b"BTFL",
    3: lambda controller, _: bytes(FIRMWARE_VERSION),
    4: _board_info,
    5: lambda controller, _: b"Jan  1 202500:00:000000000",
    10: lambda controller, _: controller.vehicle.name.encode("ascii", "replace")[:16],
    32: _battery_config,
    34: _mode_ranges,
    36: _feature_config,
    42: lambda controller, _: bytes([3, controller.profile.yaw_motors_reversed]),
    44: _rx_config,
    61: lambda controller, _: bytes([5, 0, round(controller.settings.small_angle_deg)]),
    64: lambda controller, _: bytes(controller.settings.rx_map),
    75: _failsafe_config,
    90: _advanced_config,
    94: _pid_advanced,
    99: _set_arming_disabled,
    101: lambda controller, _: _status(controller, ex=False),
    102: _raw_imu,
    104: _motor,
    105: _rc,
    108: _attitude,
    110: _analog,
    111: _rc_tuning,
    112: _pid,
    116: _box_names,
    117: lambda controller, _: b"ROLL;PITCH;YAW;LEVEL;MAG;",
    119: _box_ids,
    125: lambda controller, _: struct.pack("<BBBH", *controller.rates.deadband_us[1:], 40, 50),
    130: _battery_state,
    131: _motor_config,
    139: _motor_telemetry,
    150: lambda controller, _: _status(controller, ex=True),
    160: lambda controller, _: bytes(12),
    SET_RAW_RC: _set_raw_rc,
    MULTIPLE: _multiple,
}

"""Configuration of the flight controller, read back over MSP before a flight: read it, check it, describe it.

`FrameComposer` then composes stick frames for this configuration.
"""

import math
from dataclasses import dataclass

from swift_ros.betaflight import msp_messages as wire
from swift_ros.betaflight import sticks
from swift_ros.betaflight.msp_messages import Code
from swift_ros.errors import UsageError
from swift_ros.text import excerpt
from swift_ros.vehicle import Vehicle

ARM, ANGLE, OVERRIDE = 0, 1, 50  # permanent ids of the boxes (`msp_box.c`)
BOX_NAMES = {ARM: "ARM", ANGLE: "ANGLE", OVERRIDE: "MSP OVERRIDE"}
FIRST_AUX = 4  # index of AUX1 in a frame, after roll, pitch, yaw and throttle
MIN_CHANNELS, MAX_CHANNELS = 8, 18  # channels of a stick frame; the firmware has 18
BOXES_PER_PAGE = 32  # of MSP_BOXIDS and MSP_BOXNAMES; a full page means that there is another one
MAX_PAGES = 8  # of MSP_BOXIDS: permanent ids are bytes
OLDEST_API = (1, 43)  # the first that reports the family of the rate curves
FIRST_DIGITAL_PROTOCOL = 5  # DSHOT150
ONE_IDLE_API = (1, 47)  # from 2025.12 on, one idle setting applies to all motor protocols
DEFAULT_ANGLE_LIMIT_DEG = 60  # deg, the firmware's default, for firmware that does not report its limit
MIN_FAILSAFE_DELAY_S = 0.1  # s, the firmware's lower bound
OVERRIDE_TIMES_OUT_API = (1, 48)  # Betaflight 2026.6 returns the sticks to the pilot after 300 ms without MSP


@dataclass(frozen=True)
class ReadBack:
    """Configuration of the flight controller.

    Attributes:
        variant: firmware, "BTFL" for Betaflight.
        version: (major, minor, patch) of the firmware.
        api: (major, minor) of MSP.
        features: feature bits.
        boxes: permanent ids of the modes, in the order of the status bits.
        box_names: names of the modes, in the same order.
        mode_ranges: ranges of AUX channels that switch modes.
        channel_map: channel_map[i] is the position in a frame of logical channel i (roll, pitch, yaw, throttle,
            AUX1..4).
        receiver, deadband, rates, failsafe, advanced, motor: answers of these messages.
        pid: MSP_PID_ADVANCED; None when the firmware refuses it.
    """

    variant: str
    version: tuple[int, int, int]
    api: tuple[int, int]
    features: int
    boxes: tuple[int, ...]
    box_names: tuple[str, ...]
    mode_ranges: tuple[wire.ModeRange, ...]
    channel_map: tuple[int, ...]
    receiver: wire.RxConfig
    deadband: wire.RcDeadband
    rates: wire.RcTuning
    failsafe: wire.FailsafeConfig
    advanced: wire.AdvancedConfig
    motor: wire.MotorConfig
    pid: wire.PidAdvanced | None

    @property
    def curves(self) -> sticks.RateCurves:
        """The rate profile. Raises UsageError for an unknown curve family."""
        r = self.rates
        if r.rates_type >= len(sticks.FAMILIES):
            raise UsageError(f"the flight controller's rates_type {r.rates_type} is unknown; choose ACTUAL")
        yaw = self.deadband.yaw_deadband_us
        return sticks.RateCurves(
            family=sticks.FAMILIES[r.rates_type],
            rc_rate=(r.rc_rate_roll, r.rc_rate_pitch, r.rc_rate_yaw),
            super_rate=r.super_rate,
            expo=(r.expo_roll, r.expo_pitch, r.expo_yaw),
            limit_deg_s=r.limit_deg_s,
            centre_us=self.receiver.centre_us,
            deadband_us=(self.deadband.deadband_us, self.deadband.deadband_us, yaw),
        )

    @property
    def motor_idle(self) -> float:
        """Motor command, 0 to 1, of an armed motor at zero throttle."""
        if self.api >= ONE_IDLE_API or self.advanced.motor_protocol >= FIRST_DIGITAL_PROTOCOL:
            return self.advanced.motor_idle
        return max(self.motor.min_throttle_us - 1000, 0) / 1000

    @property
    def angle_limit(self) -> float:
        """Largest roll and pitch of angle mode, rad."""
        return math.radians(self.pid.angle_limit_deg if self.pid else DEFAULT_ANGLE_LIMIT_DEG)

    @property
    def reports_rotors(self) -> bool:
        """Whether MSP_MOTOR_TELEMETRY contains rotor speeds."""
        return bool(self.motor.dshot_telemetry or self.motor.esc_sensor)

    def modes(self, bits: int) -> tuple[str, ...]:
        """Return the names of the active modes for the mode bits of a status."""
        return tuple(name for i, name in enumerate(self.box_names) if bits >> i & 1)

    def is_on(self, box: int, bits: int) -> bool:
        """Return whether a box is active for the mode bits of a status."""
        return box in self.boxes and bool(bits >> self.boxes.index(box) & 1)


def read_back(ask) -> ReadBack:
    """Read the configuration of the flight controller.

    Args:
        ask: function (code, payload=b"") that returns the payload of the answer, or None for a refusal.

    Raises:
        UsageError: the firmware is not Betaflight or too old, or an answer is invalid.
    """
    try:
        api = wire.decode(wire.ApiVersion, _required(ask, Code.API_VERSION))
        variant = _required(ask, Code.FC_VARIANT).decode("ascii", "replace")
        if variant != "BTFL" or (api.major, api.minor) < OLDEST_API:
            what = f"runs {excerpt(variant)} with MSP {api.major}.{api.minor}"
            raise UsageError(f"the flight controller {what}; Betaflight 4.5 or newer is needed")
        version = wire.decode(wire.FcVersion, _required(ask, Code.FC_VERSION))
        boxes = _boxes(ask)
        names = wire.decode_names(b"".join(_required(ask, Code.BOXNAMES, bytes([page])) for page in _pages(boxes)))
        pid = ask(Code.PID_ADVANCED)
        return ReadBack(
            variant=variant,
            version=(version.major, version.minor, version.patch),
            api=(api.major, api.minor),
            features=wire.decode(wire.FeatureConfig, _required(ask, Code.FEATURE_CONFIG)).enabled,
            boxes=boxes,
            box_names=names if len(names) == len(boxes) else tuple(BOX_NAMES.get(b, f"BOX {b}") for b in boxes),
            mode_ranges=wire.decode_mode_ranges(_required(ask, Code.MODE_RANGES)),
            channel_map=_channel_map(_required(ask, Code.RX_MAP)),
            receiver=wire.decode(wire.RxConfig, _required(ask, Code.RX_CONFIG)),
            deadband=wire.decode(wire.RcDeadband, _required(ask, Code.RC_DEADBAND)),
            rates=wire.decode(wire.RcTuning, _required(ask, Code.RC_TUNING)),
            failsafe=wire.decode(wire.FailsafeConfig, _required(ask, Code.FAILSAFE_CONFIG)),
            advanced=wire.decode(wire.AdvancedConfig, _required(ask, Code.ADVANCED_CONFIG)),
            motor=wire.decode(wire.MotorConfig, _required(ask, Code.MOTOR_CONFIG)),
            pid=None if pid is None else wire.decode(wire.PidAdvanced, pid),
        )
    except wire.PayloadError as error:
        raise UsageError(f"the flight controller's answer is invalid: {error}; update its firmware") from error


def _required(ask, code: Code, payload: bytes = b"") -> bytes:
    """Return the answer to a request. Raises UsageError for a refusal."""
    answer = ask(code, payload)
    if answer is None:
        raise UsageError(f"the flight controller refuses MSP_{code.name}; update its firmware")
    return answer


def _boxes(ask) -> tuple[int, ...]:
    boxes = b""
    for page in range(MAX_PAGES):
        more = _required(ask, Code.BOXIDS, bytes([page]))
        boxes += more
        if len(more) < BOXES_PER_PAGE:
            return tuple(boxes)
    raise UsageError(f"the flight controller lists more than {len(boxes)} boxes; update its firmware")


def _pages(boxes) -> range:
    return range(len(boxes) // BOXES_PER_PAGE + 1)


def _channel_map(payload: bytes) -> tuple[int, ...]:
    channels = tuple(payload)
    if sorted(channels) != list(range(len(channels))) or not FIRST_AUX <= len(channels) <= MIN_CHANNELS:
        raise UsageError(f"the flight controller's channel map {list(channels)} is no permutation; set map AETR1234")
    return channels


def check(found: ReadBack, vehicle: Vehicle, receiver: str, longest_failsafe_s: float) -> list[str]:
    """Return the permanent reasons not to arm, each as "NAME: sentence"; empty without any.

    Args:
        found: configuration of the flight controller.
        vehicle: vehicle file.
        receiver: of `LinkSettings`.
        longest_failsafe_s: longest allowed time until the firmware's failsafe stops the motors, s.

    Raises:
        UsageError: a mode has no switch, or the rates do not cover the vehicle's.
    """
    override = receiver == "msp_override"
    for box in (ARM, ANGLE, OVERRIDE) if override else (ARM, ANGLE):
        _require_box(found, box)
    sticks.check_coverage(found.curves, vehicle.rates.max)
    blocks = [*_receiver_blocks(found, override), *_throttle_blocks(found)]
    if found.features & wire.FEATURE_3D:
        blocks.append("FEATURE_3D: reversible motors are on; disable feature 3D")
    end_s = failsafe_end_s(found.failsafe)
    if end_s is None or end_s > longest_failsafe_s:
        when = "does not end" if end_s is None else f"ends only after {end_s:.1f} s"
        fix = f"choose failsafe_procedure DROP with failsafe_delay up to {longest_failsafe_s * 10:.0f}"
        blocks.append(f"FAILSAFE_SETUP: the firmware's own failsafe {when}; {fix}")
    return blocks


def _require_box(found: ReadBack, box: int) -> None:
    name = BOX_NAMES[box]
    if box not in found.boxes:
        why = {ANGLE: "enable its accelerometer", OVERRIDE: "set msp_override_channels_mask"}.get(box, "update it")
        raise UsageError(f"the flight controller has no {name} box; {why}")
    aux = [r.aux for r in found.mode_ranges if r.box == box]
    if not aux:
        raise UsageError(f"no switch turns {name} on; give it a range of its own AUX channel in the flight controller")
    if aux[0] >= MAX_CHANNELS - FIRST_AUX:
        raise UsageError(f"the switch of {name} is on AUX{aux[0] + 1}; choose one up to AUX{MAX_CHANNELS - FIRST_AUX}")
    sharing = {BOX_NAMES[r.box] for r in found.mode_ranges if r.box in BOX_NAMES and r.box != box and r.aux == aux[0]}
    if sharing:
        raise UsageError(f"{name} and {', '.join(sorted(sharing))} share AUX{aux[0] + 1}; give each its own channel")


def _receiver_blocks(found: ReadBack, override: bool):
    by_msp = bool(found.features & wire.FEATURE_RX_MSP)
    if not override and not by_msp:
        yield "RECEIVER: the receiver is not MSP; enable feature RX_MSP or fly with receiver msp_override"
    if override and by_msp:
        yield "RECEIVER: no pilot's radio: the receiver is MSP; select the radio's or use receiver msp"


def _throttle_blocks(found: ReadBack):
    """Yield the settings by which the throttle is not linear, as `sticks` assumes."""
    rates, pid = found.rates, found.pid
    curved = rates.throttle_expo or found.api >= ONE_IDLE_API and rates.throttle_mid != rates.throttle_hover
    if curved:
        yield "THROTTLE_CURVE: the throttle curve is not linear; set thr_expo 0 and thr_hover equal to thr_mid"
    if rates.throttle_limit_type and rates.throttle_limit_percent != 100:
        yield "THROTTLE_LIMIT: the firmware limits the throttle; set throttle_limit_type OFF"
    if pid is None:
        return
    if pid.motor_output_limit_percent != 100:
        yield f"MOTOR_LIMIT: the motors are limited to {pid.motor_output_limit_percent} %; set motor_output_limit 100"
    if pid.sag_compensation or pid.thrust_linearisation:
        yield "THRUST_MAP: the firmware modifies the thrust too; set vbat_sag_compensation and thrust_linear 0"


def failsafe_end_s(failsafe: wire.FailsafeConfig) -> float | None:
    """Return the time in s from the last frame until the firmware's failsafe stops the motors; None for never."""
    procedure = wire.FAILSAFE_PROCEDURES[failsafe.procedure] if failsafe.procedure < 3 else "unknown"
    delay_s = max(failsafe.delay_s, MIN_FAILSAFE_DELAY_S)
    return {"landing": delay_s + failsafe.landing_s, "drop": delay_s}.get(procedure)


def describe(found: ReadBack, receiver: str) -> list[str]:
    """Return the facts that a pilot should know before a flight, one sentence each."""
    major, minor, patch = found.version
    rates = zip(sticks.AXES, sticks.max_rates(found.curves), strict=True)
    reached = ", ".join(f"{name} {rate:.1f}" for name, rate in rates)
    air_mode = "on" if found.features & wire.FEATURE_AIRMODE else "off"
    rx, end_s = found.receiver, failsafe_end_s(found.failsafe)
    cutoff = f"{rx.rc_smoothing_hz} Hz" if rx.rc_smoothing_hz else f"auto, factor {rx.rc_smoothing_auto_factor}"
    smoothing = f"RC smoothing on ({cutoff}), which delays every command" if rx.rc_smoothing else "RC smoothing off"
    loss = "never stops the motors" if end_s is None else f"stops the motors {end_s:.1f} s after the last frame"
    procedure = (*wire.FAILSAFE_PROCEDURES, "unknown")[min(found.failsafe.procedure, 3)]
    sentences = [
        f"Betaflight {major if major < 20 else 2000 + major}.{minor}.{patch}, MSP {found.api[0]}.{found.api[1]}",
        f"rates ({found.curves.family}) reach {reached} rad/s; motor idle {100 * found.motor_idle:.1f} %",
        smoothing,
        f"air mode {air_mode}; runaway-takeoff prevention, which MSP does not report, disarms a vehicle that rotates "
        "without a command in its first seconds",
    ]
    if found.pid and found.pid.throttle_boost:
        sentences.append(f"throttle boost {found.pid.throttle_boost} distorts changes of thrust; set throttle_boost 0")
    if receiver == "msp_override" and found.api < OVERRIDE_TIMES_OUT_API:
        sentences.append(
            "under MSP override this firmware holds the last sticks as long as the pilot's radio sends: "
            "if this computer fails, only the pilot's switch ends the flight"
        )
    return [*sentences, f"firmware failsafe: {procedure}, {loss}"]


class FrameComposer:
    """Composes stick frames for this flight controller: all channels, at least eight, in its order."""

    def __init__(self, found: ReadBack, receiver: str):
        self._map = found.channel_map
        self._may_arm = receiver == "msp"
        used = [r.aux for r in found.mode_ranges]
        self._count = min(max([MIN_CHANNELS, *(FIRST_AUX + aux + 1 for aux in used)]), MAX_CHANNELS)
        self._off_us = [_off_us(found.mode_ranges, aux) for aux in range(self._count - FIRST_AUX)]
        self._on_us = {}
        for box in (ARM, ANGLE):
            chosen = next(r for r in found.mode_ranges if r.box == box)
            self._on_us[box] = (chosen.aux, min(max((chosen.low_us + chosen.high_us) // 2, 1000), 2000))

    def channels(self, sticks_us, throttle_us: int, arm: bool, angle: bool) -> list[int]:
        """Return the channels of a frame, us.

        Args:
            sticks_us: (3,) us of roll, pitch and yaw.
            throttle_us: us.
            arm: whether to switch ARM on. Under MSP override only the pilot's radio arms, and ARM stays off.
            angle: whether to switch angle mode on.
        """
        logical = [*(int(s) for s in sticks_us), int(throttle_us), *self._off_us]
        for box, wanted in ((ARM, arm and self._may_arm), (ANGLE, angle)):
            aux, on_us = self._on_us[box]
            if wanted:
                logical[FIRST_AUX + aux] = on_us
        frame = list(logical)
        for channel, position in enumerate(self._map[: self._count]):
            frame[position] = logical[channel]
        return frame


def _off_us(ranges, aux: int) -> int:
    """Return the lowest value of an AUX channel that switches no mode on; 1000 when there is none."""
    own = [r for r in ranges if r.aux == aux]
    free = (us for us in range(1000, 2001, 25) if not any(r.low_us <= us < r.high_us for r in own))
    return next(free, 1000)

"""The simulated flight controller: the part of the firmware between MSP bytes and the setpoints of the rate loop.

`FlightController` has no socket and no clock: `feed` takes bytes and returns the answers, `update` runs one tick of
10 ms. The rate loop runs with the physics (`rate_loop`). The firmware's axes are FLU.
"""

import hashlib
import math
from dataclasses import dataclass, replace

import numpy as np

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.flight_controller import modes
from swift_sim_bridge.flight_controller.arming import Arming, Block
from swift_sim_bridge.flight_controller.configuration import rates
from swift_sim_bridge.flight_controller.configuration.controller_section import (
    DumpedController,
    controller_from_vehicle,
)
from swift_sim_bridge.flight_controller.failsafe import Failsafe
from swift_sim_bridge.flight_controller.firmware_settings import FirmwareSettings
from swift_sim_bridge.flight_controller.msp_server import MspServer
from swift_sim_bridge.flight_controller.rate_loop.runaway import RunawayPrevention
from swift_sim_bridge.flight_controller.receiver import STICKS, THROTTLE, Receiver

TICK_S = 0.01  # of `FlightController.update`
BOOT_S = 1.0  # s from power-on to the first answer on MSP; ours, of the order of a flight controller of class F7


@dataclass(frozen=True)
class Readings:
    """Measurements of one tick.

    Attributes:
        q_world_body: (4,) x y z w, attitude as the firmware estimates it.
        omega_body: (3,) rad/s, gyro.
        voltage: V of the pack.
        current: A from the pack.
        drawn: A s drawn so far.
        motor_command: (n,), 0 to 1, in motor order.
        rotor_speed: (n,) rad/s, in motor order.
        pid_sum: (3,) PID units; None without runaway-takeoff prevention.
        runaway: whether the rate loop has detected a runaway takeoff.
    """

    q_world_body: np.ndarray
    omega_body: np.ndarray
    voltage: float
    current: float
    drawn: float
    motor_command: np.ndarray
    rotor_speed: np.ndarray
    pid_sum: np.ndarray | None = None
    runaway: bool = False


@dataclass(frozen=True)
class Setpoint:
    """Setpoint of the rate loop for one tick.

    Attributes:
        omega_body: (3,) rad/s, FLU.
        throttle: 0 (closed) to 1.
        armed: whether the motors run.
        deflection: (3,), -1 to 1, FLU, of the sticks.
        levelled: whether angle mode is on.
    """

    omega_body: np.ndarray
    throttle: float
    armed: bool
    deflection: np.ndarray
    levelled: bool


class FlightController:
    """A flight controller with Betaflight 4.5.

    Attributes:
        settings: settings of the firmware.
        vehicle: vehicle file.
        readings: last measurements.
        profile: the vehicle file's `controller` section.
        rates: rate profile, in the firmware's whole numbers.
        receiver: receiver.
        arming: arming state.
        failsafe: failsafe.
        boxes: names of the modes that are switched on.
        voltage: V, by the voltmeter with its low-pass.
        current: A, by the ammeter with its low-pass.
        frames: number of MSP_SET_RAW_RC frames received.
    """

    def __init__(self, settings: FirmwareSettings, vehicle: Vehicle, readings: Readings):
        """Power on. Raises UsageError when settings or vehicle need a function that is not simulated."""
        self.settings, self.vehicle, self.readings = settings, vehicle, readings
        self.profile = controller_from_vehicle(vehicle)
        self.rates = rates.rate_profile(self.profile)
        modes.available(settings)
        self.frames = 0
        self._now_ns = 0
        self._power_on(0)
        self._commands = hashlib.sha256()
        self._server = MspServer(self)

    def _power_on(self, booted_ns: int) -> None:
        """Begin anew, with everything that was switched on forgotten; MSP answers from `booted_ns` on."""
        self._booted_ns = booted_ns
        self.receiver = Receiver(self.settings)
        self.arming = Arming(self.settings)
        self.failsafe = Failsafe(self.settings.failsafe, self.arming)
        self.boxes: frozenset[str] = frozenset()
        self.voltage, self.current = self.readings.voltage, self.readings.current
        self._angle_mode = False
        prevention = self.profile.runaway if isinstance(self.profile, DumpedController) else None
        self._runaway = RunawayPrevention(prevention) if prevention else None
        self._sticks = ([0.0, 0.0, 0.0], 0.0)

    def brown_out(self) -> None:
        """Restart for lack of voltage: the motors stop, and MSP is silent for BOOT_S."""
        self._power_on(self._now_ns + round(1e9 * BOOT_S))

    @property
    def is_booting(self) -> bool:
        """Whether MSP is silent after a brown-out."""
        return self._now_ns < self._booted_ns

    def feed(self, data: bytes) -> bytes:
        """Return the answers to the MSP requests in `data`, split anywhere. Each other port needs its own MspServer."""
        return self._server.feed(data)

    def record_command(self, raw: bytes) -> None:
        """Count and hash a stick frame (called by the MSP server)."""
        self.frames += 1
        self._commands.update(raw)

    @property
    def commands_sha256(self) -> str:
        """Hash of all MSP_SET_RAW_RC frames received, byte for byte."""
        return self._commands.hexdigest()

    @property
    def gyro_deg_s(self) -> np.ndarray:
        """Measured body rates (3,) deg/s, FLU."""
        return np.degrees(self.readings.omega_body)

    @property
    def attitude_deg(self) -> tuple[float, float, float]:
        """Roll (right positive), pitch (nose down positive), heading (clockwise, 0..360) of MSP_ATTITUDE, degrees."""
        x, y, z, w = (float(value) for value in self.readings.q_world_body)
        roll = math.atan2(2 * (y * z + w * x), 1 - 2 * (x * x + y * y))
        pitch = math.asin(max(-1.0, min(1.0, 2 * (w * y - x * z))))
        heading = -math.atan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))
        return math.degrees(roll), math.degrees(pitch), math.degrees(heading) % 360.0

    @property
    def tilt_deg(self) -> float:
        """Angle between the body's z axis and the vertical, degrees."""
        x, y = (float(value) for value in self.readings.q_world_body[:2])
        return math.degrees(math.acos(max(-1.0, min(1.0, 1 - 2 * (x * x + y * y)))))

    @property
    def throttle_low(self) -> bool:
        """Whether the throttle is below `min_check_us`."""
        return self.receiver.channels[THROTTLE] < self.settings.min_check_us

    def flight_modes(self) -> frozenset[str]:
        """Return the boxes that MSP_STATUS reports as active: modes in effect, not positions of switches."""
        states = {"MSP OVERRIDE"} & self.boxes
        states |= {"ARM"} if self.arming.armed else set()
        states |= {"ANGLE"} if self._angle_mode else set()
        in_failsafe = self.failsafe.active or (not self.arming.armed and "FAILSAFE" in self.boxes)
        return frozenset(states | ({"FAILSAFE"} if in_failsafe else set()))

    def update(self, now_ns: int, readings: Readings) -> Setpoint:
        """Run one tick at `now_ns` since the first power-on and return the setpoint until the next tick."""
        self._now_ns, self.readings = now_ns, readings
        if self.is_booting:
            return Setpoint(np.zeros(3), 0.0, False, np.zeros(STICKS - 1), False)
        now_ms = (now_ns - self._booted_ns) // 1_000_000
        self._meter()
        if self.receiver.update(now_ms, self.boxes, self.failsafe.active):
            self._process_frame(now_ms)
        if self._runaway and not self._runaway.finished and readings.runaway and self.arming.armed:
            self.arming.mark(Block.RUNAWAY_TAKEOFF, True)
            self.arming.disarm()
        self.failsafe.update(now_ms, self.throttle_low)
        deflections, throttle = self._sticks
        setpoint = [rates.rate_deg_s(self.rates, axis, deflections[axis]) for axis in range(3)]
        if self._angle_mode:
            setpoint = self._level(setpoint)
        return Setpoint(
            np.radians(setpoint), throttle, self.arming.armed, np.array(deflections), bool(self._angle_mode)
        )

    def take_motor_state(self, motor_command, rotor_speed) -> None:
        """Take motor commands and rotor speeds at the end of a tick: MSP can request them before the next tick."""
        self.readings = replace(self.readings, motor_command=motor_command, rotor_speed=rotor_speed)

    def _meter(self) -> None:
        s = self.settings
        self.voltage += _pt1_gain(s.voltage_filter_hz) * (self.readings.voltage - self.voltage)
        self.current += _pt1_gain(s.current_filter_hz) * (self.readings.current - self.current)

    def _process_frame(self, now_ms: int) -> None:
        """Process a receiver frame in the firmware's order: the ARM switch acts by the modes of the previous frame."""
        self.failsafe.take_frame(now_ms, self.receiver.valid)
        self.arming.follow_switch("ARM" in self.boxes, self.failsafe.link_up or "FAILSAFE" in self.boxes)
        channels = self.receiver.channels
        self.boxes = modes.active(self.settings, channels)
        self._angle_mode = "ANGLE" in self.boxes or self.failsafe.active
        mid, low = self.settings.mid_us, self.settings.min_check_us
        deadbands_us = self.rates.deadband_us
        deflections = [rates.deflection_of(channels[i], i, mid, deadbands_us[i]) for i in range(STICKS - 1)]
        self._sticks = (deflections, rates.throttle_share(channels[THROTTLE], low, self.rates))
        if self._runaway and self.arming.armed and self.readings.pid_sum is not None:
            self._runaway.take_frame(now_ms, self._sticks[1], deflections, self.readings.pid_sum)
        self.arming.review(now_ms, self.receiver.signal, self.boxes, self.throttle_low, self.tilt_deg)

    def _level(self, setpoint: list[float]) -> list[float]:
        """Return the rates (3,) deg/s of angle mode: sticks command angles, yaw is about the earth's vertical.

        As `pidLevel` of pid.c, without its 50 Hz smoothing and feed-forward, which a tick of 10 ms cannot resolve.
        """
        targets = [
            self.settings.angle_limit_deg * setpoint[axis] / rates.rate_deg_s(self.rates, axis, 1.0) for axis in (0, 1)
        ]
        gain = self.settings.level_gain / 10.0
        errors = [target - angle for target, angle in zip(targets, self.attitude_deg[:2], strict=True)]
        yaw = setpoint[rates.YAW]
        roll_rate = gain * errors[0] - yaw * math.sin(math.radians(targets[1]))
        pitch_rate = gain * errors[1] + yaw * math.sin(math.radians(targets[0]))
        return [roll_rate, pitch_rate, yaw * math.cos(math.radians(max(abs(target) for target in targets)))]


def _pt1_gain(cutoff_hz: float) -> float:
    """Return the gain of a first-order low-pass at the rate of the ticks."""
    return TICK_S / (TICK_S + 1.0 / (2.0 * math.pi * cutoff_hz))

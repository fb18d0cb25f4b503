"""The simulated flight controller: everything of the firmware between MSP bytes and the rate loop's setpoints.

`FlightController` owns no socket and no clock: `feed` takes bytes and returns the answers, `update` is one tick of
10 ms. The rate loop itself runs with the physics (`rate_loop`). Axes are the firmware's, which are FLU.
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
from swift_sim_bridge.flight_controller.rate_loop.runaway import RunawayWatch
from swift_sim_bridge.flight_controller.receiver import STICKS, THROTTLE, Receiver

TICK_S = 0.01


@dataclass(frozen=True)
class Readings:
    """What the firmware's sensors say: attitude as it estimates it, (4,) x y z w; gyro (3,) rad/s, FLU; battery V, A,
    and A s drawn so far; motor commands 0..1 and rotor speeds rad/s, in motor order; pid_sum (3,) PID units and
    whether the rate loop has seen a runaway takeoff, where it watches for one."""

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
    """What the rate loop shall fly for one tick: body rates (3,) rad/s, FLU; throttle 0..1, 0 = closed; armed.

    deflection: (3,) -1..1, FLU, of the sticks that asked for it; levelled: in angle mode.
    """

    omega_body: np.ndarray
    throttle: float
    armed: bool
    deflection: np.ndarray
    levelled: bool


class FlightController:
    """A flight controller with Betaflight 4.5, set up by `settings`, on a vehicle.

    receiver, arming, failsafe: its parts; rates, profile: what its configurator would show; readings: the last ones;
    voltage, current: as its meters show them (V, A); frames: MSP_SET_RAW_RC frames received; boxes: modes switched on.
    Raises UsageError when settings or vehicle ask for what this firmware lacks.
    """

    def __init__(self, settings: FirmwareSettings, vehicle: Vehicle, readings: Readings):
        self.settings, self.vehicle, self.readings = settings, vehicle, readings
        self.profile = controller_from_vehicle(vehicle)
        self.rates = rates.rate_profile(self.profile)
        modes.available(settings)
        self.receiver = Receiver(settings)
        self.arming = Arming(settings)
        self.failsafe = Failsafe(settings.failsafe, self.arming)
        self.boxes: frozenset[str] = frozenset()
        self.voltage, self.current = readings.voltage, readings.current
        self.frames = 0
        self._angle_mode = False
        watched = self.profile.runaway if isinstance(self.profile, DumpedController) else None
        self._runaway = RunawayWatch(watched) if watched else None
        self._sticks = ([0.0, 0.0, 0.0], 0.0)
        self._commands = hashlib.sha256()
        self._port = MspServer(self)

    def feed(self, data: bytes) -> bytes:
        """Return the answers to the MSP requests in `data`, cut anywhere. Further ports have an MspServer each."""
        return self._port.feed(data)

    def record_command(self, raw: bytes) -> None:
        """Count and hash a frame that carries sticks (called by the MSP server)."""
        self.frames += 1
        self._commands.update(raw)

    @property
    def commands_sha256(self) -> str:
        """Hash of all MSP_SET_RAW_RC frames received, byte for byte."""
        return self._commands.hexdigest()

    @property
    def gyro_deg_s(self) -> np.ndarray:
        return np.degrees(self.readings.omega_body)

    @property
    def attitude_deg(self) -> tuple[float, float, float]:
        """Roll and pitch (right and nose down positive) and heading (clockwise, 0..360), as in MSP_ATTITUDE."""
        x, y, z, w = (float(value) for value in self.readings.q_world_body)
        roll = math.atan2(2 * (y * z + w * x), 1 - 2 * (x * x + y * y))
        pitch = math.asin(max(-1.0, min(1.0, 2 * (w * y - x * z))))
        heading = -math.atan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))
        return math.degrees(roll), math.degrees(pitch), math.degrees(heading) % 360.0

    @property
    def tilt_deg(self) -> float:
        x, y = (float(value) for value in self.readings.q_world_body[:2])
        return math.degrees(math.acos(max(-1.0, min(1.0, 1 - 2 * (x * x + y * y)))))

    @property
    def throttle_low(self) -> bool:
        return self.receiver.channels[THROTTLE] < self.settings.min_check_us

    def flight_modes(self) -> frozenset[str]:
        """Return the boxes that MSP_STATUS reports as active: what the vehicle does, not where the switches are."""
        states = {"MSP OVERRIDE"} & self.boxes
        states |= {"ARM"} if self.arming.armed else set()
        states |= {"ANGLE"} if self._angle_mode else set()
        in_failsafe = self.failsafe.active or (not self.arming.armed and "FAILSAFE" in self.boxes)
        return frozenset(states | ({"FAILSAFE"} if in_failsafe else set()))

    def update(self, now_ns: int, readings: Readings) -> Setpoint:
        """Run one tick at `now_ns` since power-on and return what the rate loop flies until the next."""
        now_ms = now_ns // 1_000_000
        self.readings = readings
        self._meter()
        if self.receiver.update(now_ms, self.boxes, self.failsafe.active):
            self._process_frame(now_ms)
        if self._runaway and not self._runaway.over and readings.runaway and self.arming.armed:
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
        """Take what the motors do at the end of a tick: MSP asks for it before the next begins."""
        self.readings = replace(self.readings, motor_command=motor_command, rotor_speed=rotor_speed)

    def _meter(self) -> None:
        s = self.settings
        self.voltage += _pt1_gain(s.voltage_filter_hz) * (self.readings.voltage - self.voltage)
        self.current += _pt1_gain(s.current_filter_hz) * (self.readings.current - self.current)

    def _process_frame(self, now_ms: int) -> None:
        """Do what the firmware does once a receiver frame, in its order: switches act by the modes of the last one."""
        self.failsafe.saw_frame(now_ms, self.receiver.valid)
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
        """Return the rates (3,) deg/s of angle mode: sticks ask for angles, yaw turns about the earth's vertical.

        As pid.c, `pidLevel`, without its 50 Hz smoothing and feedforward, which a tick of 10 ms cannot resolve.
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
    return TICK_S / (TICK_S + 1.0 / (2.0 * math.pi * cutoff_hz))

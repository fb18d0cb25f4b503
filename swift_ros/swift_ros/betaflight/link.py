"""The link to the flight controller as a state machine without sockets: commands in, bytes out.

idle ── race/arm ──▶ arming ── it says armed ──▶ podium ── race/start ──▶ racing ── end or fault ──▶ ending ──▶ over
Feed it what arrives and write what it returns: one RC frame for every command, at once, and frames of its own only
when commands stay away. All times are told by the caller.
"""

import enum
import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from swift_ros import geometry
from swift_ros.betaflight import msp_messages as wire
from swift_ros.betaflight import read_back, sticks
from swift_ros.betaflight.conversation import Conversation
from swift_ros.betaflight.failsafe import (
    Descent,
    DescentLimits,
    InputWatchdog,
    Motion,
    Now,
    SafeSticks,
    Stage,
    motion_of,
)
from swift_ros.betaflight.msp_messages import Code
from swift_ros.betaflight.pack import Pack
from swift_ros.betaflight.read_back import ReadBack
from swift_ros.configuration import setting
from swift_ros.race import judge
from swift_ros.types import BodyRateThrust, Odometry
from swift_ros.vehicle import Vehicle

COMMAND, STATE, JUDGE = "command/body_rate_thrust", "state/odometry", "race/judged"
FILL_S = 0.025  # without a command for so long a frame is sent without one; the firmware misses frames after 0.1 s
FRESH_S = 0.5  # an answer of the flight controller, or a speed, older than this is none
CLOSED_US = 1000  # below min_check: the firmware's "throttle low"
CENTRED = np.zeros(3)
BEHIND = "the flight controller does not keep up with 100 frames a second; set serial_update_rate_hz 1000 in its CLI"


@dataclass(frozen=True)
class LinkSettings:
    """Section `betaflight` of nodes.yaml."""

    port: str = setting("tcp://HOST:PORT, or a serial device or pseudo-terminal")
    baud: int = setting("bits/s of a serial device; USB ignores it", 9600, 4_000_000)
    connect_timeout_s: float = setting("s to keep trying to connect before giving up", 0, 600)
    receiver: str = setting("msp: this node arms; msp_override: the pilot's radio does")
    state_required: bool = setting("false: by hand, without state/odometry and race/judged; a fault stops the motors")
    silence_s: float = setting("s without a sound command or state until the failsafe", 0.02, 1)
    stale_s: float = setting("s by which the stamp of a command or state may lie behind the clock to count", 0.02, 5)
    judge_silence_s: float = setting("s without a word of the race monitor until the failsafe", 0.02, 5)
    lockstep_silence_s: float = setting("lockstep: all these on the steady clock, longer than the bridge waits", 5, 60)
    failsafe_level_tilt_deg: float = setting("the throttle stays closed until the tilt is below", 5, 90)
    failsafe_level_max_speed: float = setting("m/s above which the motors stop at once", 0, 50)
    failsafe_descent_s: float = setting("s from hover thrust to none", 0.1, 10)
    firmware_failsafe_s: float = setting("refuse to arm when the firmware's own failsafe takes longer, s", 0.1, 30)
    level_limit_deg: float = setting("refuse to arm when tilted more", 1, 45)
    min_cell_v: float = setting("refuse to arm below this voltage a cell", 0, 4.4)
    assumed_voltage: float = setting("V of the pack where nothing measures it (bench, SITL); 0: as measured", 0, 100)
    voltmeter_s: float = setting("s, time constant of the firmware's voltmeter (vbat_display_lpf_period)", 0, 10)
    status_ticks: int = setting("frames between two looks at status and attitude", 1, 1000)
    battery_ticks: int = setting("frames between two looks at the battery", 1, 1000)
    rotor_ticks: int = setting("frames between two looks at the rotors", 1, 1000)


class Phase(enum.Enum):
    IDLE = "idle"
    ARMING = "arming"
    PODIUM = "podium"
    RACING = "racing"
    ENDING = "ending"
    OVER = "over"


FLYING = (Phase.RACING, Phase.ENDING)


class MspLink:
    """found: what was read back; blocks: what forbids to arm for good (`read_back.check`).

    To publish: phase, frames_sent, command_stamp_ns, failsafe, talk (the answers), and events, pairs of level and
    sentence that the caller drains.
    """

    def __init__(self, found: ReadBack, vehicle: Vehicle, settings: LinkSettings, lockstep: bool, blocks=()):
        self.phase = Phase.IDLE
        self.frames_sent = 0
        self.command_stamp_ns = 0
        self.failsafe = False
        self.events: deque[tuple[str, str]] = deque()
        ticks = (settings.status_ticks, settings.battery_ticks, settings.rotor_ticks)
        self.talk = Conversation(*ticks, bounded=not lockstep)
        self._pack = Pack(vehicle, settings.voltmeter_s)
        self._found, self._vehicle, self._settings = found, vehicle, settings
        self._blocks, self._lockstep = tuple(blocks), lockstep
        self._override = settings.receiver == "msp_override"
        self._channels = read_back.Channels(found, settings.receiver)
        self._curves = found.curves
        silences_s = {COMMAND: settings.silence_s, STATE: settings.silence_s, JUDGE: settings.judge_silence_s}
        self._sources = (COMMAND, STATE, JUDGE) if settings.state_required else (COMMAND,)
        self._watchdog = InputWatchdog(silences_s, settings.lockstep_silence_s if lockstep else None)
        tilt = math.radians(settings.failsafe_level_tilt_deg)
        self._limits = DescentLimits(tilt, settings.failsafe_level_max_speed, settings.failsafe_descent_s)
        self._descent: Descent | None = None
        self._command: BodyRateThrust | None = None
        self._waiting: BodyRateThrust | None = None
        self._state: Odometry | None = None
        self._state_s = self._frame_s = -math.inf
        self._state_stamp_ns = -1
        self._race: deque[tuple[str, int]] = deque()
        self._word = ""
        self._raised = False  # the ARM switch

    def hear_race(self, word: str, stamp_ns: int) -> None:
        """Take a word of race/status (passages repeat it); it acts at the first command with that stamp or later.

        A race that was armed before this node came is not joined: the word was meant for another.
        """
        first, repeated, self._word = not self._word, word == self._word, word
        if first and word in (judge.ARMED, judge.RACING):
            self.events.append(("error", f"the race is {word} already; call race/stop and race/arm again"))
        elif not repeated:
            self._race.append((word, stamp_ns))

    def hear_command(self, command: BodyRateThrust, now: Now) -> None:
        """Take a command; `answer` writes it. One with NaN, or too old, leaves the sticks and counts as missing."""
        self._watchdog.look(now)
        self._waiting = command
        sound = math.isfinite(command.thrust) and np.all(np.isfinite(command.omega_body))
        if self._counts(COMMAND, sound, command.stamp_ns, now):
            self._command = command

    def hear_state(self, state: Odometry, now: Now) -> None:
        """Take the estimated state. One with NaN, without a rotation, or too old, counts as missing."""
        self._watchdog.look(now)
        self._state_stamp_ns = max(self._state_stamp_ns, state.stamp_ns)
        numbers = np.concatenate([state.p_world, state.q_world_body, state.v_body, state.omega_body])
        sound = np.all(np.isfinite(numbers)) and abs(np.linalg.norm(state.q_world_body) - 1.0) < 0.1
        if self._counts(STATE, sound, state.stamp_ns, now):
            self._state, self._state_s = state, self._watchdog.time_s

    def _counts(self, source: str, sound: bool, stamp_ns: int, now: Now) -> bool:
        """Return whether a message is one, and let the watchdog know."""
        age_s = 1e-9 * (now.ros_ns - stamp_ns)
        if not sound:
            self.events.append(("warn", f"{source} holds NaN or no rotation; it counts as missing"))
        elif self._settings.state_required and age_s > self._settings.stale_s:
            self.events.append(("warn", f"{source} is {age_s:.2f} s old; it counts as missing"))
        else:
            self._watchdog.hear(source, now)
            return True
        return False

    def hear_judge(self, now: Now) -> None:
        """Note a sign of life of the race monitor."""
        self._watchdog.look(now)
        self._watchdog.hear(JUDGE, now)

    def receive(self, chunk: bytes, arrived_s: float) -> set:
        """Take bytes of the flight controller, arrived at `arrived_s` on the steady clock; return the codes of news."""
        news = self.talk.receive(chunk, arrived_s, self._watchdog.time_s)
        if Code.BATTERY_STATE in news:
            self._pack.measure(self.talk.battery.voltage, self._watchdog.time_s)
        return news

    def answer(self, now: Now) -> bytes | None:
        """Return the frame for the command that waits, or None.

        In lockstep it waits until the state that caused it is here, so that the same bytes follow whatever came first.
        """
        command = self._waiting
        ordered = self._lockstep and self._settings.state_required
        if command is None or ordered and self._state_stamp_ns < command.stamp_ns:
            return None
        self._waiting = None
        self.command_stamp_ns = command.stamp_ns
        self._watchdog.look(now)
        self._proceed(now, command.stamp_ns if self._lockstep else now.ros_ns)
        return self._frame(now)

    def tick(self, now: Now) -> bytes | None:
        """Watch the clocks, at 100 Hz or faster. Return a frame when trouble begins, or when commands stay away."""
        if self._watchdog.look(now):
            return None
        before, quiet_s = self.phase, self._watchdog.time_s - self._frame_s
        if not self._lockstep or quiet_s > self._settings.silence_s:  # while commands come, they alone decide
            self._proceed(now, now.ros_ns)
        # In lockstep nobody is to know how long the graph took to come up: the first frame answers the first command.
        begun = not self._lockstep or self._command is not None
        fills = begun and self.phase is not Phase.RACING and quiet_s > FILL_S
        return self._frame(now) if fills or self.phase is not before else None

    def questions(self, now: Now) -> bytes:
        """Return the requests that are due after the frame just sent."""
        if self.talk.behind:
            self.events.append(("warn", BEHIND))
        return self.talk.questions(self.frames_sent, self.phase is Phase.ENDING, now.steady_s)

    def farewell(self, now: Now) -> bytes:
        """Return a last frame for an orderly end: disarmed, throttle closed."""
        self._end()
        return self._frame(now)

    @property
    def armed(self) -> bool:
        """Whether the flight controller says that it is armed."""
        return self._is_on(read_back.ARM)

    @property
    def modes(self) -> tuple[str, ...]:
        """The flight controller's active modes."""
        return () if self.talk.status is None else self._found.modes(self.talk.status.modes)

    def arming_blocks(self, now: Now) -> list[str]:
        """Return what keeps the vehicle from arming: the firmware's flags by name, ours in a sentence; armed: none."""
        if self.phase in (Phase.PODIUM, *FLYING):
            return []
        blocks, status = list(self._blocks), self.talk.status
        if status is None or not self._lockstep and now.steady_s - self.talk.replied_s > FRESH_S:
            return [*blocks, "LINK: the flight controller does not answer"]
        if self.talk.behind:
            blocks.append(f"LINK: {BEHIND}")
        blocks += [name for name in wire.arming_blocks(status) if name != wire.ARM_SWITCH]
        for box in (read_back.ARM, read_back.OVERRIDE) if self._override else ():
            if not self._is_on(box):
                blocks.append(f"PILOT: {read_back.BOX_NAMES[box]} is off on the pilot's radio")
        if not self._is_on(read_back.ANGLE):
            mask = "; does msp_override_channels_mask hold its AUX channel?" if self._override else ""
            blocks.append(f"ANGLE_MODE: the flight controller does not take up angle mode when told to{mask}")
        fault = self._watchdog.fault(now, self._sources)
        return [*blocks, *([f"INPUT: {fault}"] if fault else []), *self._level_blocks(), *self._battery_blocks()]

    def _level_blocks(self):
        if self._state is not None:
            tilt_deg = math.degrees(float(geometry.tilt_of(self._state.q_world_body)))
            if tilt_deg > self._settings.level_limit_deg:
                yield f"LEVEL: tilted by {tilt_deg:.0f} deg, more than {self._settings.level_limit_deg:.0f}"

    def _battery_blocks(self):
        battery, least_v = self.talk.battery, self._settings.min_cell_v
        if self._settings.assumed_voltage:
            return
        if battery is None or self._pack.source is None:
            yield "BATTERY: the flight controller measures no battery"
            return
        cell_v = battery.voltage / (battery.cells or self._vehicle.battery.cells or 1)
        if cell_v < least_v:
            yield f"BATTERY: {cell_v:.2f} V a cell, less than {least_v:.2f}"

    def _is_on(self, box: int) -> bool:
        return self.talk.status is not None and self._found.is_on(box, self.talk.status.modes)

    # From phase to phase.

    def _proceed(self, now: Now, reached_ns: int) -> None:
        """Act on the words of the race up to `reached_ns`, then on what is wrong."""
        if self.phase is Phase.ARMING and self._raised and self.armed:
            self.phase = Phase.PODIUM
        while self._race and self._race[0][1] <= reached_ns:
            self._obey(self._race.popleft()[0], now)
        if self.phase in (Phase.IDLE, Phase.OVER):
            self._watchdog.forget_jump()  # a clock may be set while nothing turns
        elif self.phase is Phase.ARMING:
            self._raised = not self.arming_blocks(now)
        elif self.phase in (Phase.PODIUM, *FLYING):
            self._look_for_trouble(now)
        if self._descent and self._descent.stage is Stage.OVER and self.phase is Phase.ENDING:
            self._end()

    def _obey(self, word: str, now: Now) -> None:
        if word == judge.ARMED and self.phase in (Phase.IDLE, Phase.OVER):
            self.phase, self.failsafe = Phase.ARMING, False
        elif word == judge.RACING and self.phase is Phase.PODIUM:
            self.phase = Phase.RACING
        elif word == judge.RACING and self.phase is not Phase.RACING:
            self.events.append(("error", "race/start came while the flight controller was not armed"))
        elif word == judge.FINISHED and self.phase is Phase.RACING:
            self._begin_descent(now, brake=True)
        elif word == judge.LOST and self.phase is Phase.RACING:
            self._fail("the race monitor lost a node", now)
        elif word in judge.ENDS and not (word == judge.LOST and self.phase is Phase.ENDING):
            self._end()
        elif word == judge.IDLE and self.phase is not Phase.IDLE:
            self._end()
            self.phase = Phase.IDLE

    def _look_for_trouble(self, now: Now) -> None:
        if not self.armed:
            flags = ", ".join(wire.arming_blocks(self.talk.status)) or "it gives no reason"
            self._fall("the flight controller disarmed itself: " + flags)
        elif self._override and not self._is_on(read_back.OVERRIDE):
            self._fall("the pilot took the sticks; only a new race/arm gives them back")
        elif fault := self._watchdog.fault(now, self._sources):
            if self.phase is Phase.PODIUM:
                self._fall(f"on the podium {fault}")
            elif self.phase is Phase.RACING or self._descent.stage is Stage.BRAKING:
                self._fail(fault, now)

    def _fail(self, fault: str, now: Now) -> None:
        """The failsafe takes the sticks."""
        self.failsafe = True
        self._begin_descent(now, brake=False)
        stop = "the throttle closes" if self._override else "the motors stop"
        end = f"{stop} at once" if self._descent.stage is Stage.OVER else "levelling and sinking in angle mode"
        self.events.append(("error", f"failsafe: {fault}; {end}"))

    def _fall(self, why: str) -> None:
        self.events.append(("error", why))
        self._end()

    def _begin_descent(self, now: Now, brake: bool) -> None:
        self.phase = Phase.ENDING
        self._descent = Descent(self._limits, self._motion(now), self._watchdog.time_s, brake)

    def _end(self) -> None:
        self.phase, self._raised, self._descent = Phase.OVER, False, None

    def _motion(self, now: Now) -> Motion:
        """Return what is known: the state while it comes, else the flight controller's tilt and the last speed."""
        if self._state is not None and not self._watchdog.fault(now, (STATE,)):
            return motion_of(self._state.q_world_body, self._state.v_body)
        time_s, speed, tilt = self._watchdog.time_s, None, None
        if self._state is not None and time_s - self._state_s < FRESH_S:
            speed = float(np.linalg.norm(self._state.v_body))
        if time_s - self.talk.attitude_s < FRESH_S:
            angles = self.talk.attitude
            tilt = math.acos(max(-1.0, min(1.0, math.cos(angles.roll) * math.cos(angles.pitch))))
        return Motion(tilt, speed)

    # From phase to sticks.

    def _frame(self, now: Now) -> bytes:
        if self.phase is Phase.RACING:
            channels = self._racing_channels(self._command)
        elif self.phase is Phase.ENDING:
            channels = self._safe_channels(self._descent.sticks(self._motion(now), self._watchdog.time_s))
        else:
            arm = self.phase is Phase.PODIUM or self.phase is Phase.ARMING and self._raised
            self._pack.load(0.0, self._watchdog.time_s)
            channels = self._channels.frame(self._sticks(CENTRED), CLOSED_US, arm=arm, angle=True)
        self.frames_sent += 1
        self._frame_s = self._watchdog.time_s
        return self.talk.frame(channels, now.steady_s)

    def _racing_channels(self, command: BodyRateThrust) -> list[int]:
        throttle_us = self._throttle_us(command.thrust)
        return self._channels.frame(self._sticks(command.omega_body), throttle_us, arm=True, angle=False)

    def _safe_channels(self, safe: SafeSticks) -> list[int]:
        if not safe.armed:
            self._end()
            return self._channels.frame(self._sticks(CENTRED), CLOSED_US, arm=False, angle=True)
        # In angle mode the firmware takes the share of the largest rate for the share of its largest angle.
        limit_deg = self._found.pid.angle_limit_deg if self._found.pid else 60
        share = np.clip(np.array([*safe.lean, 0.0]) / math.radians(limit_deg), -1.0, 1.0)
        centred = self._sticks(share * sticks.max_rates(self._curves))
        return self._channels.frame(centred, self._throttle_us(safe.thrust or 0.0), arm=True, angle=True)

    def _sticks(self, omega_body):
        return sticks.sticks_from_rates(np.asarray(omega_body), self._curves)

    def _throttle_us(self, thrust: float) -> int:
        loaded = self._pack.load(thrust, self._watchdog.time_s)
        voltage = self._settings.assumed_voltage or loaded or self._vehicle.battery.reference_voltage
        idle = self._found.motor_idle
        throttle = sticks.throttle_for_thrust(np.asarray(thrust), voltage, self._vehicle, idle)
        return int(sticks.throttle_stick(throttle, self._found.receiver.min_check_us))

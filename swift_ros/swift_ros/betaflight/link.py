"""The link to the flight controller as a state machine without sockets: commands in, bytes out. No ROS.

idle ── race/arm ──▶ arming ── armed ──▶ podium ── race/start ──▶ racing ── end or fault ──▶ ending ──▶ over

The caller passes on messages and received bytes and writes the returned frames: one stick frame at once for every
command, and further frames only when commands are missing. The caller gives all times.
"""

import enum
import math
from collections import deque
from dataclasses import replace

import numpy as np

from swift_ros import geometry
from swift_ros.betaflight import arming_flags, read_back, sticks
from swift_ros.betaflight.braking_space import BrakingSpace
from swift_ros.betaflight.failsafe import DeadReckoning, Descent, DescentLimits, Motion, SafeSticks, Stage, motion_of
from swift_ros.betaflight.link_settings import LinkSettings
from swift_ros.betaflight.msp_messages import Code
from swift_ros.betaflight.msp_session import MspSession
from swift_ros.betaflight.pack import PackObserver
from swift_ros.betaflight.read_back import ReadBack
from swift_ros.betaflight.tumble import TumbleWatch
from swift_ros.betaflight.watchdog import ClockReading, InputWatchdog
from swift_ros.race import judge
from swift_ros.types import BodyRateThrust, Odometry
from swift_ros.vehicle import Vehicle

COMMAND, STATE, JUDGE = "command/body_rate_thrust", "state/odometry", "race/judged"
FILL_S = 0.025  # s without a command, after which a frame is sent anyway; the firmware allows 0.1 s between two frames
FRESH_S = 0.5  # s; an older answer of the flight controller, and an older speed, is not used
CLOSED_US = 1000  # us, below min_check: the firmware's "throttle low"
FLY_ON_S = 8.0  # s after the finish, longest wait for a free way to brake
SPACE_M = (1.5, 0.5)  # m between hull and gates while braking: wanted at the finish, and accepted after FLY_ON_S
CENTRED = np.zeros(3)
OVERLOADED = (
    "the flight controller does not keep up with 100 frames a second; set serial_update_rate_hz 1000 in its CLI"
)


class Phase(enum.Enum):
    """Phases of a flight; see the module's docstring."""

    IDLE = "idle"
    ARMING = "arming"
    PODIUM = "podium"
    RACING = "racing"
    ENDING = "ending"
    OVER = "over"


FLYING = (Phase.RACING, Phase.ENDING)
PLANNED_ENDS = (judge.MISSED, judge.STOPPED)  # of a race whose vehicle flies well, besides the finish
IN_THE_WAY = "a gate, the ground or the edge of the flight volume is in the way of braking"


class MspLink:
    """State machine of the link.

    Attributes:
        phase: phase of the flight.
        frames_sent: number of stick frames so far.
        command_stamp_ns: stamp of the command that the last frame answers.
        failsafe: whether the failsafe has ended the flight.
        events: (level, sentence) pairs for the caller, which removes them.
        session: requests to the flight controller and its newest answers.
        space: of braking on the track; after the finish the pilot flies on until it is free. None, as at first: the
            vehicle brakes at the finish.
    """

    def __init__(self, found: ReadBack, vehicle: Vehicle, settings: LinkSettings, lockstep: bool, blocks=()):
        """Start in phase idle.

        Args:
            found: configuration read back from the flight controller.
            vehicle: vehicle file.
            settings: settings of the link.
            lockstep: whether time is simulated and waits for the graph.
            blocks: permanent reasons not to arm, from `read_back.check`.
        """
        self.phase = Phase.IDLE
        self.frames_sent = 0
        self.command_stamp_ns = 0
        self.failsafe = False
        self.space: BrakingSpace | None = None
        self.events: deque[tuple[str, str]] = deque()
        ticks = (settings.status_ticks, settings.battery_ticks, settings.rotor_ticks)
        self.session = MspSession(*ticks, bounded=not lockstep)
        self._pack = PackObserver(vehicle, settings.voltmeter_s)
        self._found, self._vehicle, self._settings = found, vehicle, settings
        self._blocks, self._lockstep = tuple(blocks), lockstep
        self._override = settings.receiver == "msp_override"
        self._composer = read_back.FrameComposer(found, settings.receiver)
        self._curves = found.curves
        silences_s = {COMMAND: settings.silence_s, STATE: settings.silence_s, JUDGE: settings.judge_silence_s}
        self._sources = (COMMAND, STATE, JUDGE) if settings.state_required else (COMMAND,)
        self._watchdog = InputWatchdog(silences_s, settings.lockstep_silence_s if lockstep else None)
        self._tumble = TumbleWatch(vehicle.rates.max)
        tilt = math.radians(settings.failsafe_level_tilt_deg)
        self._limits = DescentLimits(tilt, settings.failsafe_descent_s)
        self._descent: Descent | None = None
        self._finished_s: float | None = None  # of a race whose pilot still flies on
        self._reckoning: DeadReckoning | None = None
        self._thrust = 0.0  # m/s^2, of the last frame
        self._command: BodyRateThrust | None = None
        self._pending_command: BodyRateThrust | None = None
        self._state: Odometry | None = None
        self._state_s = self._frame_s = -math.inf
        self._state_stamp_ns = -1
        self._race_states: deque[tuple[str, int]] = deque()
        self._race_state = ""
        self._arm_switch = False

    # Inputs.

    def take_race_state(self, race_state: str, stamp_ns: int) -> None:
        """Take a state of race/status (passages repeat it); it acts at the first command with that stamp or later.

        A race that was armed before this node started is not joined.
        """
        first, repeated, self._race_state = not self._race_state, race_state == self._race_state, race_state
        if first and race_state in (judge.ARMED, judge.RACING):
            self.events.append(("error", f"the race is {race_state} already; call race/stop and race/arm again"))
        elif not repeated:
            self._race_states.append((race_state, stamp_ns))

    def take_command(self, command: BodyRateThrust, now: ClockReading) -> None:
        """Take a command; `answer` returns its frame. A command with NaN, or too old, is ignored: the sticks stay."""
        self._watchdog.update(now)
        self._pending_command = command
        valid = math.isfinite(command.thrust) and bool(np.all(np.isfinite(command.omega_body)))
        if self._is_usable(COMMAND, valid, command.stamp_ns, now):
            self._command = command

    def take_state(self, state: Odometry, now: ClockReading) -> None:
        """Take the estimated state. A state with NaN, with an invalid quaternion, or too old, is ignored."""
        self._watchdog.update(now)
        self._state_stamp_ns = max(self._state_stamp_ns, state.stamp_ns)
        numbers = np.concatenate([state.p_world, state.q_world_body, state.v_body, state.omega_body])
        valid = bool(np.all(np.isfinite(numbers)) and abs(np.linalg.norm(state.q_world_body) - 1.0) < 0.1)
        if self._is_usable(STATE, valid, state.stamp_ns, now):
            self._state, self._state_s = state, self._watchdog.time_s
            if self._command is not None:
                self._tumble.update(state.omega_body, self._command.omega_body, self._state_s)

    def _is_usable(self, source: str, valid: bool, stamp_ns: int, now: ClockReading) -> bool:
        """Return whether a message is used; if so, note it in the watchdog. In manual flight a stamp can be missing."""
        age_s = 1e-9 * (now.ros_ns - stamp_ns)
        if not valid:
            self.events.append(("warn", f"{source} contains NaN or an invalid quaternion; it is ignored"))
        elif (self._settings.state_required or stamp_ns) and age_s > self._settings.stale_s:
            self.events.append(("warn", f"{source} is {age_s:.2f} s old; it is ignored"))
        else:
            self._watchdog.note_message(source, now)
            return True
        return False

    def take_judge_message(self, now: ClockReading) -> None:
        """Note a message of the race monitor."""
        self._watchdog.update(now)
        self._watchdog.note_message(JUDGE, now)

    def receive(self, chunk: bytes, arrived_s: float) -> set:
        """Take bytes that arrived at `arrived_s` (s, steady clock); return the codes of new answers."""
        news = self.session.receive(chunk, arrived_s, self._watchdog.time_s)
        battery = self.session.battery
        if battery is not None and Code.BATTERY_STATE in news:
            self._pack.measure(battery.voltage, self._watchdog.time_s)
        return news

    # Outputs.

    def answer(self, now: ClockReading) -> bytes | None:
        """Return the frame for the pending command, or None.

        In lockstep the command waits until the state that caused it has arrived, so that the frames do not depend on
        the order of arrival.
        """
        command = self._pending_command
        ordered = self._lockstep and self._settings.state_required
        if command is None or ordered and self._state_stamp_ns < command.stamp_ns:
            return None
        self._pending_command = None
        self.command_stamp_ns = command.stamp_ns
        self._watchdog.update(now)
        self._proceed(now, command.stamp_ns if self._lockstep else now.ros_ns)
        return self._frame(now)

    def tick(self, now: ClockReading) -> bytes | None:
        """Check the clocks, at 100 Hz or faster. Return a frame when a fault begins or when commands are missing."""
        if self._watchdog.update(now):
            return None
        before, quiet_s = self.phase, self._watchdog.time_s - self._frame_s
        if not self._lockstep or quiet_s > self._settings.silence_s:  # in lockstep, commands trigger all decisions
            self._proceed(now, now.ros_ns)
        # In lockstep the frames must not depend on how long the graph took to start: the first one answers a command.
        begun = not self._lockstep or self._command is not None
        fills = begun and self.phase is not Phase.RACING and quiet_s > FILL_S
        return self._frame(now) if fills or self.phase is not before else None

    def requests(self, now: ClockReading) -> bytes:
        """Return the requests that are due after the frame just sent."""
        if self.session.overloaded:
            self.events.append(("warn", OVERLOADED))
        return self.session.requests(self.frames_sent, self.phase is Phase.ENDING, now.steady_s)

    def final_frame(self, now: ClockReading) -> bytes:
        """Return a last frame, at the end of the program: disarmed, throttle closed."""
        self._end()
        return self._frame(now)

    @property
    def armed(self) -> bool:
        """Whether the flight controller reports that it is armed."""
        return self._is_on(read_back.ARM)

    @property
    def modes(self) -> tuple[str, ...]:
        """The flight controller's active modes."""
        return () if self.session.status is None else self._found.modes(self.session.status.modes)

    # Reasons not to arm.

    def arming_blocks(self, now: ClockReading) -> list[str]:
        """Return the reasons not to arm: the firmware's flags by name, others as "NAME: sentence"; armed: none."""
        if self.phase is Phase.ENDING or self._flies_on:
            return ["FLIGHT: the last flight has not ended yet"]
        if self.phase in (Phase.PODIUM, Phase.RACING):
            return []
        blocks, status = list(self._blocks), self.session.status
        if status is None or not self._lockstep and now.steady_s - self.session.replied_s > FRESH_S:
            return [*blocks, "LINK: the flight controller does not answer"]
        if self.session.overloaded:
            blocks.append(f"LINK: {OVERLOADED}")
        blocks += [name for name in arming_flags.arming_blocks(status) if name != arming_flags.ARM_SWITCH]
        for box in (read_back.ARM, read_back.OVERRIDE) if self._override else ():
            if not self._is_on(box):
                blocks.append(f"PILOT: {read_back.BOX_NAMES[box]} is off on the pilot's radio")
        if not self._is_on(read_back.ANGLE):
            mask = "; does msp_override_channels_mask contain its AUX channel?" if self._override else ""
            blocks.append(f"ANGLE_MODE: the flight controller does not enter angle mode when commanded{mask}")
        fault = self._watchdog.fault(now, self._sources)
        return [*blocks, *([f"INPUT: {fault}"] if fault else []), *self._level_blocks(), *self._battery_blocks()]

    def _level_blocks(self):
        if self._state is not None:
            tilt_deg = math.degrees(float(geometry.tilt_of(self._state.q_world_body)))
            if tilt_deg > self._settings.level_limit_deg:
                yield f"LEVEL: tilted by {tilt_deg:.0f} deg, more than {self._settings.level_limit_deg:.0f}"

    def _battery_blocks(self):
        battery, min_v = self.session.battery, self._settings.min_cell_v
        if self._settings.assumed_voltage:
            return
        if battery is None or self._pack.source_voltage is None:
            yield "BATTERY: the flight controller measures no battery"
            return
        cell_v = battery.voltage / (battery.cells or self._vehicle.battery.cells or 1)
        if cell_v < min_v:
            yield f"BATTERY: {cell_v:.2f} V a cell, less than {min_v:.2f}"

    def _is_on(self, box: int) -> bool:
        return self.session.status is not None and self._found.is_on(box, self.session.status.modes)

    # Transitions between phases.

    def _proceed(self, now: ClockReading, reached_ns: int) -> None:
        """Act on the race states up to `reached_ns`, then on faults."""
        if self.phase is Phase.ARMING and self._arm_switch and self.armed:
            self.phase = Phase.PODIUM
        while self._race_states and self._race_states[0][1] <= reached_ns:
            self._follow_race(self._race_states.popleft()[0], now)
        if self._flies_on:
            self._brake_when_free(now)
        if self.phase in (Phase.IDLE, Phase.OVER):
            self._watchdog.clear_jump()  # the clock may be set while the motors stand still
        elif self.phase is Phase.ARMING:
            self._arm_switch = not self.arming_blocks(now)
        elif self.phase in (Phase.PODIUM, *FLYING):
            self._check_faults(now)
        if self._descent and self._descent.stage is Stage.OVER and self.phase is Phase.ENDING:
            self._end()

    def _follow_race(self, race_state: str, now: ClockReading) -> None:
        if race_state == judge.ARMED and self.phase in (Phase.IDLE, Phase.OVER):
            self.phase, self.failsafe, self._finished_s = Phase.ARMING, False, None
        elif race_state == judge.RACING and self.phase is Phase.PODIUM:
            self.phase = Phase.RACING
        elif race_state == judge.RACING and self.phase is not Phase.RACING:
            self.events.append(("error", "race/start came while the flight controller was not armed"))
        elif race_state == judge.FINISHED and self.phase is Phase.RACING:
            self._finish()
        elif race_state in PLANNED_ENDS and self.phase is Phase.RACING:
            self._begin_descent(now, planned=True)
        elif race_state == judge.LOST and self.phase is Phase.RACING:
            self._fail("the race monitor lost a node", now)
        elif race_state in judge.ENDS and (race_state == judge.CRASHED or self.phase is not Phase.ENDING):
            self._end()
        elif race_state == judge.IDLE and self.phase is not Phase.IDLE:
            self._end()
            self.phase = Phase.IDLE

    def _finish(self) -> None:
        """Note the finish; the pilot flies on until nothing is in the way of braking."""
        self._finished_s = self._watchdog.time_s
        if not self._has_space():
            self.events.append(("ok", f"finished; {IN_THE_WAY}, so the pilot flies on"))

    @property
    def _flies_on(self) -> bool:
        """Whether the pilot flies on after the finish, as in `RaceControl.flies_on`."""
        return self.phase is Phase.RACING and self._finished_s is not None

    def _brake_when_free(self, now: ClockReading) -> None:
        """After the finish, begin to brake where nothing is in the way, at the latest after FLY_ON_S."""
        assert self._finished_s is not None  # the caller asked
        has_space, over = self._has_space(), self._watchdog.time_s - self._finished_s >= FLY_ON_S
        if over and not has_space:
            self.events.append(("warn", f"{IN_THE_WAY}; it begins all the same, {FLY_ON_S:g} s after the finish"))
        if over or has_space:
            self._begin_descent(now, planned=True)

    def _has_space(self) -> bool:
        """Return whether the way of braking is free; with the time since the finish a narrower one counts as free."""
        if self.space is None or self._state is None or self._finished_s is None:
            return True
        share = min((self._watchdog.time_s - self._finished_s) / FLY_ON_S, 1.0)
        wanted_m, accepted_m = SPACE_M
        return self.space.clearance_m(self._state) >= wanted_m + share * (accepted_m - wanted_m)

    def _check_faults(self, now: ClockReading) -> None:
        if not self.armed:
            status = self.session.status
            names = [] if status is None else arming_flags.arming_blocks(status)
            flags = ", ".join(names) or "it reports no reason"
            self._abort("the flight controller disarmed itself: " + flags)
        elif self._override and not self._is_on(read_back.OVERRIDE):
            self._abort("the pilot took the sticks; only a new race/arm gives them back")
        elif fault := self._watchdog.fault(now, self._sources) or self._silent_controller():
            if self.phase is Phase.PODIUM:
                self._abort(f"on the podium {fault}")
            elif self.phase is Phase.RACING:
                self._fail(fault, now)
        elif self.phase is Phase.RACING and (fault := self._tumble.fault(self._watchdog.time_s)):
            self._fail(fault, now, stop=True)
        known = self.phase is Phase.ENDING and self._settings.state_required and not self.failsafe
        if known and (fault := self._watchdog.fault(now, (STATE,))):
            self.failsafe = True
            self.events.append(("error", f"failsafe: {fault}; the descent goes on by the flight controller's attitude"))

    def _silent_controller(self) -> str | None:
        """Return a sentence when the flight controller no longer answers: it may have restarted, or lost the frames."""
        silent = self._watchdog.time_s - self.session.answered_s > FRESH_S
        return f"the flight controller has not answered for {FRESH_S} s" if silent else None

    def _fail(self, fault: str, now: ClockReading, stop: bool = False) -> None:
        """End the flight by the failsafe; `stop` the motors at once where nothing can level the vehicle."""
        self.failsafe = True
        descent = self._begin_descent(now, planned=False)
        if stop:
            descent.stop()
        stopped = "the throttle closes" if self._override else "the motors stop"
        end = f"{stopped} at once" if descent.stage is Stage.OVER else "levelling, braking and descending in angle mode"
        self.events.append(("error", f"failsafe: {fault}; {end}"))

    def _abort(self, reason: str) -> None:
        """Report an error and disarm."""
        self.events.append(("error", reason))
        self._end()

    def _begin_descent(self, now: ClockReading, planned: bool) -> Descent:
        self.phase = Phase.ENDING
        self._descent = Descent(self._limits, self._motion(now), self._watchdog.time_s, planned)
        return self._descent

    def _end(self) -> None:
        self.phase, self._arm_switch, self._descent = Phase.OVER, False, None

    def _motion(self, now: ClockReading) -> Motion:
        """Return the motion: by the state without a fault of it, else by the flight controller's attitude."""
        if self._state is not None and not self._watchdog.fault(now, (STATE,)):
            self._reckoning = None
            motion = motion_of(self._state.q_world_body, self._state.v_body)
            return motion if self.space is None else replace(motion, height=self.space.height_m(self._state))
        time_s, angles = self._watchdog.time_s, self.session.attitude
        if angles is None or time_s - self.session.attitude_s > FRESH_S:
            return Motion()
        if self._reckoning is None and self._state is not None and time_s - self._state_s < FRESH_S:
            last = motion_of(self._state.q_world_body, self._state.v_body)
            assert last.v_heading is not None  # of a state it is known
            self._reckoning = DeadReckoning(last.v_heading, angles.heading, self._state_s)
        tilt = math.acos(max(-1.0, min(1.0, math.cos(angles.roll) * math.cos(angles.pitch))))
        return Motion(tilt, self._reckoning.advance(angles, self._thrust, time_s) if self._reckoning else None)

    # Frames of the phases.

    def _frame(self, now: ClockReading) -> bytes:
        if self.phase is Phase.RACING:
            assert self._command is not None  # the podium without a command is a fault
            channels = self._racing_channels(self._command)
        elif self.phase is Phase.ENDING:
            assert self._descent is not None  # it begins with this phase
            channels = self._safe_channels(self._descent.sticks(self._motion(now), self._watchdog.time_s))
        else:
            arm = self.phase is Phase.PODIUM or self.phase is Phase.ARMING and self._arm_switch
            self._pack.predict(0.0, self._watchdog.time_s)
            channels = self._composer.channels(self._sticks(CENTRED), CLOSED_US, arm=arm, angle=True)
        self.frames_sent += 1
        self._frame_s = self._watchdog.time_s
        return self.session.frame(channels, now.steady_s)

    def _racing_channels(self, command: BodyRateThrust) -> list[int]:
        throttle_us = self._throttle_us(command.thrust)
        return self._composer.channels(self._sticks(command.omega_body), throttle_us, arm=True, angle=False)

    def _safe_channels(self, safe: SafeSticks) -> list[int]:
        if not safe.armed:
            self._end()
            return self._composer.channels(self._sticks(CENTRED), CLOSED_US, arm=False, angle=True)
        # In angle mode the firmware maps the share of the largest rate to the same share of its largest angle.
        share = np.clip(np.array([*safe.lean, 0.0]) / self._found.angle_limit, -1.0, 1.0)
        leaning = self._sticks(share * sticks.max_rates(self._curves))
        return self._composer.channels(leaning, self._throttle_us(safe.thrust or 0.0), arm=True, angle=True)

    def _sticks(self, omega_body):
        return sticks.sticks_from_rates(np.asarray(omega_body), self._curves)

    def _throttle_us(self, thrust: float) -> int:
        self._thrust = thrust
        predicted = self._pack.predict(thrust, self._watchdog.time_s)
        voltage = self._settings.assumed_voltage or predicted or self._vehicle.battery.reference_voltage
        idle = self._found.motor_idle
        throttle = sticks.throttle_for_thrust(np.asarray(thrust), voltage, self._vehicle, idle)
        return int(sticks.throttle_stick(throttle, self._found.receiver.min_check_us))

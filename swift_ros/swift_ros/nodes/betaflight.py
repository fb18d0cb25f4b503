"""Node betaflight: the pilot's commands as MSP frames to a flight controller, its answers as topics."""

import contextlib
import math
import time

import numpy as np
from rclpy.clock import Clock, ClockType

from swift_ros import configuration
from swift_ros.betaflight import read_back
from swift_ros.betaflight.braking_space import BrakingSpace
from swift_ros.betaflight.link import COMMAND, JUDGE, STATE, MspLink, Phase
from swift_ros.betaflight.link_settings import LinkSettings
from swift_ros.betaflight.msp_messages import Code
from swift_ros.betaflight.transport import ConnectionLost, connect
from swift_ros.betaflight.watchdog import ClockReading
from swift_ros.messages.control import from_command, to_battery, to_link, to_rotors
from swift_ros.messages.motion import odometry_from_bytes
from swift_ros.messages.stamps import from_time
from swift_ros.nodes.shell import Shell, run
from swift_ros.track import Track
from swift_ros.vehicle import Vehicle
from swift_ros.working_time import WorkingTime

TICK_S, REPORT_S = 0.01, 1.0  # s; periods of the link and of the reports on /diagnostics
TOGETHER_S = 0.005  # s; the clocks are read within this time, else again: a pause in between would look like a jump
# s of working time, longest waits for the simulator in lockstep: for its first answer it may compile a tick; another
# answer that does not come was lost; after it the flight controller may restart, and time goes on
FIRST_ANSWER_S, ANSWER_S, SILENT_S = 60.0, 1.0, 0.03
POLL_S = 0.1  # s, longest wait for bytes before the working time is read again


class BetaflightNode(Shell):
    """Shell around MspLink: writes one frame at once for each command, then publishes betaflight/link."""

    def __init__(self):
        super().__init__("betaflight", LinkSettings)
        settings, vehicle = self.settings, configuration.load(Vehicle, self.folder / "drone.yaml")
        self._working_time = WorkingTime()
        clock = self._working_time.now_s if self.lockstep else time.monotonic
        patience_s = settings.connect_timeout_s
        self._transport = connect(settings.port, settings.baud, patience_s, self.get_logger().warning, clock)
        found = read_back.read_back(self._transport.ask)
        for sentence in read_back.describe(found, settings.receiver):
            self.get_logger().info(sentence)
        blocks = read_back.check(found, vehicle, settings.receiver, settings.firmware_failsafe_s)
        self._link = MspLink(found, vehicle, settings, self.lockstep, blocks)
        if settings.state_required:  # manual flight has no place in the map
            track = configuration.load(Track, self.folder / "track.yaml")
            self._link.space = BrakingSpace(track, vehicle, found.angle_limit)
        self._reports_rotors, self._rotors = found.reports_rotors, len(vehicle.rotors)
        self._reached_ns, self._reported_s, self._patience_s = 0, {}, FIRST_ANSWER_S
        self._link_topic, self._battery_topic = self.publisher("betaflight/link"), self.publisher("battery")
        self._rotors_topic = self.publisher("betaflight/rotors")
        self.subscribe(COMMAND, self._on_command)
        self.subscribe(STATE, self._on_state, raw=True)
        self.subscribe(JUDGE, lambda message: self._link.take_judge_message(self._now()))
        self.subscribe("race/status", lambda m: self._link.take_race_state(m.state, from_time(m.header.stamp)))
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        for clock in (steady, self.get_clock()) if self.lockstep else (steady,):
            self.create_timer(TICK_S, self._on_tick, clock=clock)
        self.create_timer(REPORT_S, self._report, clock=steady)

    def _now(self, stamp_ns: int = 0) -> ClockReading:
        # In lockstep a command may arrive before the tick of /clock of its stamp.
        self._reached_ns = max(self._reached_ns, stamp_ns) if self.lockstep else 0
        while True:
            before_s, ros_ns, steady_s = time.monotonic(), self.now_ns(), time.monotonic()
            if steady_s - before_s < TOGETHER_S:
                working_s = self._working_time.now_s() if self.lockstep else 0.0
                return ClockReading(max(ros_ns, self._reached_ns), steady_s, working_s)

    def _on_command(self, message):
        command = from_command(message)
        self._link.take_command(command, self._now(command.stamp_ns))
        self._answer()

    def _on_state(self, data: bytes):
        self._link.take_state(odometry_from_bytes(data), self._now())
        self._answer()

    def _answer(self) -> None:
        now = self._now()
        frame = self._link.answer(now)
        if frame is not None:
            self._send(frame, now, wait=self.lockstep)

    def _on_tick(self) -> None:
        now = self._now()
        frame = self._link.tick(now)
        if frame is not None:
            self._send(frame, now, wait=False)
        self._collect(wait=False)

    def _send(self, frame: bytes, now: ClockReading, wait: bool) -> None:
        """Write the frame, then the requests that are due; in lockstep read the answers before time advances."""
        self._transport.write(frame)
        written_ns = now.ros_ns if self.lockstep else self._now().ros_ns
        self._transport.write(self._link.requests(now))
        self._collect(wait)
        while self._link.events:  # first: the race monitor names the reason when it reads that the failsafe is active
            self._report_event(*self._link.events.popleft())
        self._publish_link(now, written_ns)

    def _collect(self, wait: bool) -> None:
        deadline_s = self._working_time.now_s() + self._patience_s if wait else 0.0
        while True:
            waits = wait and self._link.session.has_open_request and self._working_time.now_s() < deadline_s
            arrived = self._transport.read(min(POLL_S, self._patience_s) if waits else 0.0)
            if arrived is not None:
                self._patience_s = ANSWER_S
                self._publish(self._link.receive(*arrived))
            elif not waits:
                break
        if wait and self._link.session.has_open_request:
            self._link.session.drop_requests()
            self._patience_s = SILENT_S
            self._report_event("error", "the flight controller does not answer")

    def _publish(self, news: set) -> None:
        session, stamp_ns = self._link.session, self._now().ros_ns
        b = session.battery
        if b is not None and Code.BATTERY_STATE in news:
            self._battery_topic.publish(to_battery(stamp_ns, b.voltage, b.current, b.drawn_ah, b.capacity_ah))
        if session.motors is not None and Code.MOTOR in news:
            rotors = session.rotors if self._reports_rotors else None
            speed = [m.rpm * math.pi / 30 for m in rotors] if rotors else [math.nan] * self._rotors
            motor = np.clip((np.array(session.motors[: self._rotors]) - 1000) / 1000, 0.0, 1.0)
            self._rotors_topic.publish(to_rotors(stamp_ns, speed[: self._rotors], motor))

    def _publish_link(self, now: ClockReading, written_ns: int) -> None:
        link = self._link
        message = to_link(
            written_ns,
            link.command_stamp_ns,
            frames_sent=link.frames_sent,
            frames_bad=link.session.frames_bad,
            round_trip_ms=link.session.round_trip_ms,
            armed=link.armed,
            modes=link.modes,
            arming_blocks=link.arming_blocks(now),
            failsafe=link.failsafe,
        )
        self._link_topic.publish(message)

    def _report(self) -> None:
        blocks = self._link.arming_blocks(self._now()) if self._link.phase is Phase.ARMING else []
        if blocks:
            self._report_event("warn", f"does not arm: {'; '.join(blocks)}")

    def _report_event(self, level: str, text: str) -> None:
        if time.monotonic() - self._reported_s.get(text, -1.0) >= 1.0:
            self._reported_s[text] = time.monotonic()
            self.diagnose(level, text)

    def close(self) -> None:
        """Stop the motors instead of waiting for the firmware's failsafe.

        In lockstep nothing is sent: the race must be a function of its seed.
        """
        if not self.lockstep:
            with contextlib.suppress(ConnectionLost):
                self._transport.write(self._link.final_frame(self._now()))
        self._transport.close()


def main():
    """Run the node."""
    run(BetaflightNode)

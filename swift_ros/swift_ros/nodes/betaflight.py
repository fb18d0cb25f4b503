"""Node betaflight: the pilot's commands as MSP frames to a flight controller, its answers as topics."""

import contextlib
import math
import time

import numpy as np
from rclpy.clock import Clock, ClockType

from swift_ros import configuration, messages
from swift_ros.betaflight import read_back
from swift_ros.betaflight.failsafe import Now
from swift_ros.betaflight.link import COMMAND, JUDGE, STATE, LinkSettings, MspLink, Phase
from swift_ros.betaflight.msp_messages import Code
from swift_ros.betaflight.transport import Broken, connect
from swift_ros.nodes.shell import Shell, run
from swift_ros.vehicle import Vehicle

TICK_S, REPORT_S = 0.01, 1.0
TOGETHER_S = 0.005  # both clocks are read within, or again: a pause in between would look like a jump of one
ANSWER_S = 60.0  # lockstep: the simulator answers within a tick, which may have to be compiled first


class BetaflightNode(Shell):
    """Shell around Link: one frame written at once for every command, then betaflight/link; answers come in between."""

    def __init__(self):
        super().__init__("betaflight", LinkSettings)
        settings, vehicle = self.settings, configuration.load(Vehicle, self.folder / "drone.yaml")
        patience_s = settings.connect_timeout_s
        self._transport = connect(settings.port, settings.baud, patience_s, self.get_logger().warning)
        found = read_back.read_back(self._transport.ask)
        for sentence in read_back.describe(found, settings.receiver):
            self.get_logger().info(sentence)
        blocks = read_back.check(found, vehicle, settings.receiver, settings.firmware_failsafe_s)
        self._link = MspLink(found, vehicle, settings, self.lockstep, blocks)
        self._reports_rotors, self._rotors = found.reports_rotors, len(vehicle.rotors)
        self._reached_ns, self._told_s = 0, {}
        self._link_topic, self._battery_topic = self.publisher("betaflight/link"), self.publisher("battery")
        self._rotors_topic = self.publisher("betaflight/rotors")
        self.subscribe(COMMAND, self._on_command)
        self.subscribe(STATE, self._on_state)
        self.subscribe(JUDGE, lambda message: self._link.hear_judge(self._now()))
        self.subscribe("race/status", lambda m: self._link.hear_race(m.state, messages.stamp_ns(m.header.stamp)))
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        for clock in (steady, self.get_clock()) if self.lockstep else (steady,):
            self.create_timer(TICK_S, self._on_tick, clock=clock)
        self.create_timer(REPORT_S, self._report, clock=steady)

    def _now(self, stamp_ns: int = 0) -> Now:
        # In lockstep a command may overtake the tick of /clock that it belongs to.
        self._reached_ns = max(self._reached_ns, stamp_ns) if self.lockstep else 0
        while True:
            before_s, ros_ns, steady_s = time.monotonic(), self.now_ns(), time.monotonic()
            if steady_s - before_s < TOGETHER_S:
                return Now(max(ros_ns, self._reached_ns), steady_s)

    def _on_command(self, message):
        command = messages.from_command(message)
        self._link.hear_command(command, self._now(command.stamp_ns))
        self._answer()

    def _on_state(self, message):
        state = messages.from_odometry(message)
        self._link.hear_state(state, self._now())
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

    def _send(self, frame: bytes, now: Now, wait: bool) -> None:
        """Write the frame, then the questions that are due; in lockstep take the answers before time goes on."""
        self._transport.write(frame)
        written_ns = now.ros_ns if self.lockstep else self._now().ros_ns
        self._transport.write(self._link.questions(now))
        self._collect(wait)
        self._publish_link(now, written_ns)
        while self._link.events:
            self._tell(*self._link.events.popleft())

    def _collect(self, wait: bool) -> None:
        deadline = time.monotonic() + ANSWER_S
        while True:
            left_s = deadline - time.monotonic() if wait and self._link.talk.waits else 0.0
            arrived = self._transport.read(max(left_s, 0.0))
            if arrived is None:
                break
            self._publish(self._link.receive(*arrived))
        if wait and self._link.talk.waits:
            self._link.talk.give_up()
            self._tell("error", f"the flight controller did not answer within {ANSWER_S:.0f} s")

    def _publish(self, news: set) -> None:
        talk, stamp_ns = self._link.talk, self._now().ros_ns
        if Code.BATTERY_STATE in news:
            b = talk.battery
            self._battery_topic.publish(messages.to_battery(stamp_ns, b.voltage, b.current, b.drawn_ah, b.capacity_ah))
        if Code.MOTOR in news:
            known = self._reports_rotors and talk.rotors
            speed = [m.rpm * math.pi / 30 for m in talk.rotors] if known else [math.nan] * self._rotors
            motor = np.clip((np.array(talk.motors[: self._rotors]) - 1000) / 1000, 0.0, 1.0)
            self._rotors_topic.publish(messages.to_rotors(stamp_ns, speed[: self._rotors], motor))

    def _publish_link(self, now: Now, written_ns: int) -> None:
        link = self._link
        message = messages.to_link(
            written_ns,
            link.command_stamp_ns,
            frames_sent=link.frames_sent,
            frames_bad=link.talk.frames_bad,
            round_trip_ms=link.talk.round_trip_ms,
            armed=link.armed,
            modes=link.modes,
            arming_blocks=link.arming_blocks(now),
            failsafe=link.failsafe,
        )
        self._link_topic.publish(message)

    def _report(self) -> None:
        blocks = self._link.arming_blocks(self._now()) if self._link.phase is Phase.ARMING else []
        if blocks:
            self._tell("warn", f"does not arm: {'; '.join(blocks)}")

    def _tell(self, level: str, text: str) -> None:
        if time.monotonic() - self._told_s.get(text, -1.0) >= 1.0:
            self._told_s[text] = time.monotonic()
            self.diagnose(level, text)

    def close(self) -> None:
        """On an orderly end, stop the motors instead of leaving that to the firmware's failsafe; in lockstep the
        simulator, whose race is a function of its seed, is not told."""
        if not self.lockstep:
            with contextlib.suppress(Broken):
                self._transport.write(self._link.farewell(self._now()))
        self._transport.close()


def main():
    """Run the node."""
    run(BetaflightNode)

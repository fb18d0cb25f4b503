"""A link, a scripted flight controller and a clock, for the stories of `test_link` and `test_failsafe`."""

import numpy as np
from fake_firmware import FakeFirmware

from swift_ros import configuration
from swift_ros.betaflight import read_back
from swift_ros.betaflight.link import MspLink, Phase
from swift_ros.betaflight.link_settings import LinkSettings
from swift_ros.betaflight.watchdog import ClockReading
from swift_ros.configuration import configuration_folder
from swift_ros.types import BodyRateThrust, Odometry
from swift_ros.vehicle import GRAVITY, Vehicle

TICK_NS = 10_000_000
VEHICLE = configuration.load(Vehicle, configuration_folder() / "drone.yaml")
UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])


def settings(**changes) -> LinkSettings:
    """Return the shipped settings with changes."""
    content = configuration.read_yaml(configuration_folder() / "nodes.yaml")["betaflight"]
    return configuration.build(LinkSettings, content | changes, "the story's settings")


class Story:
    """Plays ticks of 10 ms. `alive` names the sources that send; thrust, rates, attitude and velocity are constant."""

    def __init__(self, firmware=None, lockstep=False, space=None, **changes):
        self.firmware = firmware or FakeFirmware()
        self.settings = settings(**changes)
        found = read_back.read_back(self.firmware.ask)
        blocks = read_back.check(found, VEHICLE, self.settings.receiver, self.settings.firmware_failsafe_s)
        self.link = MspLink(found, VEHICLE, self.settings, lockstep, blocks)
        self.link.space = space
        self.link.take_race_state("idle", 0)
        self.alive = {"command", "state", "judge", "clock"}
        self.ros_ns, self.steady_s = 1_000_000_000, 500.0
        self.thrust, self.omega = 0.0, np.zeros(3)
        self.delay_ns = 0  # delay of the stamps of commands
        self.q, self.v_body = UPRIGHT, np.zeros(3)
        self.history: list[tuple[float, list[int]]] = []  # (s since the story's mark, channels)
        self.mark_s = 0.0

    @property
    def now(self) -> ClockReading:
        return ClockReading(self.ros_ns, self.steady_s, working_s=self.steady_s)

    @property
    def blocks(self) -> str:
        return "; ".join(self.link.arming_blocks(self.now))

    def write(self, frame: bytes | None) -> None:
        if frame is not None:
            replies = self.firmware.feed(frame + self.link.requests(self.now))
            self.history.append((self.steady_s - self.mark_s, self.firmware.frames[-1]))
            self.link.receive(replies, self.steady_s + 0.001)

    def play(self, seconds: float) -> "Story":
        """Play for a time."""
        for _ in range(round(seconds / 0.01)):
            self.steady_s += 0.01
            self.ros_ns += TICK_NS if "clock" in self.alive else 0
            if "judge" in self.alive:
                self.link.take_judge_message(self.now)
            if "state" in self.alive:
                state = Odometry(self.ros_ns, np.zeros(3), self.q, self.v_body, np.zeros(3))
                self.link.take_state(state, self.now)
            if "command" in self.alive:
                self.link.take_command(BodyRateThrust(self.ros_ns - self.delay_ns, self.thrust, self.omega), self.now)
                self.write(self.link.answer(self.now))
            self.write(self.link.tick(self.now))
        return self

    def announce(self, race_state: str) -> "Story":
        self.link.take_race_state(race_state, self.ros_ns)
        return self

    def race(self, thrust: float = GRAVITY) -> "Story":
        """Arm, start and fly."""
        self.play(0.5).announce("armed").play(0.5).announce("racing")
        self.thrust = thrust
        self.play(0.1)
        assert self.link.phase is Phase.RACING, self.blocks
        return self

    def mark(self) -> "Story":
        """Begin a new `history`."""
        self.history, self.mark_s = [], self.steady_s
        return self

    def first(self, condition) -> float:
        """Return the time in s of the first frame since the mark with condition(channels)."""
        return next(t for t, channels in self.history if condition(channels))


def is_angle(channels) -> bool:
    return channels[5] > 1700


def is_armed(channels) -> bool:
    return channels[4] > 1700

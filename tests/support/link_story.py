"""A link, a scripted flight controller and a clock: what the stories of `test_link` and `test_failsafe` play in."""

import numpy as np
from fake_firmware import FakeFirmware

from swift_ros import configuration
from swift_ros.betaflight import read_back
from swift_ros.betaflight.failsafe import Now
from swift_ros.betaflight.link import LinkSettings, MspLink, Phase
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
    """Plays tick by tick, 10 ms each. What is alive is in `alive`; thrust, rates, attitude and velocity are held."""

    def __init__(self, firmware=None, lockstep=False, **changes):
        self.firmware = firmware or FakeFirmware()
        self.settings = settings(**changes)
        found = read_back.read_back(self.firmware.ask)
        blocks = read_back.check(found, VEHICLE, self.settings.receiver, self.settings.firmware_failsafe_s)
        self.link = MspLink(found, VEHICLE, self.settings, lockstep, blocks)
        self.link.hear_race("idle", 0)
        self.alive = {"command", "state", "judge", "clock"}
        self.ros_ns, self.steady_s = 1_000_000_000, 500.0
        self.thrust, self.omega = 0.0, np.zeros(3)
        self.delay_ns = 0  # by which the stamps of commands are behind
        self.q, self.v_body = UPRIGHT, np.zeros(3)
        self.history: list[tuple[float, list[int]]] = []  # (s since the story's mark, channels)
        self.mark_s = 0.0

    @property
    def now(self) -> Now:
        return Now(self.ros_ns, self.steady_s)

    @property
    def blocks(self) -> str:
        return "; ".join(self.link.arming_blocks(self.now))

    def write(self, frame: bytes | None) -> None:
        if frame is not None:
            replies = self.firmware.feed(frame + self.link.questions(self.now))
            self.history.append((self.steady_s - self.mark_s, self.firmware.frames[-1]))
            self.link.receive(replies, self.steady_s + 0.001)

    def play(self, seconds: float) -> "Story":
        """Let time pass."""
        for _ in range(round(seconds / 0.01)):
            self.steady_s += 0.01
            self.ros_ns += TICK_NS if "clock" in self.alive else 0
            if "judge" in self.alive:
                self.link.hear_judge(self.now)
            if "state" in self.alive:
                state = Odometry(self.ros_ns, np.zeros(3), self.q, self.v_body, np.zeros(3))
                self.link.hear_state(state, self.now)
            if "command" in self.alive:
                self.link.hear_command(BodyRateThrust(self.ros_ns - self.delay_ns, self.thrust, self.omega), self.now)
                self.write(self.link.answer(self.now))
            self.write(self.link.tick(self.now))
        return self

    def say(self, word: str) -> "Story":
        self.link.hear_race(word, self.ros_ns)
        return self

    def race(self, thrust: float = GRAVITY) -> "Story":
        """Arm, start and fly."""
        self.play(0.5).say("armed").play(0.5).say("racing")
        self.thrust = thrust
        self.play(0.1)
        assert self.link.phase is Phase.RACING, self.blocks
        return self

    def mark(self) -> "Story":
        """Count `history` from here."""
        self.history, self.mark_s = [], self.steady_s
        return self

    def first(self, condition) -> float:
        """Return when the first frame since the mark met condition(channels), s."""
        return next(t for t, channels in self.history if condition(channels))


def is_angle(channels) -> bool:
    return channels[5] > 1700


def is_armed(channels) -> bool:
    return channels[4] > 1700

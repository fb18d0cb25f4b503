"""Kinds of faults, what each can be planted in, and the draw of one fault from its seed."""

import math
from dataclasses import dataclass

from swift_ros.graph.topic_table import NODES, TOPICS
from swift_sim_bridge import seeds
from swift_sim_bridge.racing.race import RACERS

FIRST_S, LAST_S = 0.3, 6.5  # s after the start between which faults begin; a lap takes some 7 s
SHORTEST_S, LONGEST_S = 0.02, 3.0  # s that a fault lasts, drawn log-uniformly
FOREVER_S = 1e6  # s of a fault that does not end
FOREVER_SHARE = 0.3  # share of the faults that do not end
REAL_TIME, LOCKSTEP = "real time", "lockstep"
CLOCKS = (LOCKSTEP, REAL_TIME)
KILL, FREEZE, TERMINATE = "kill", "freeze", "terminate"  # kinds of faults
DELAY, DROP, DUPLICATE, REORDER = "delay", "drop", "duplicate", "reorder"
NOT_A_NUMBER, ABSURD_VALUE, TIME_JUMP = "not a number", "absurd value", "time jump"
FOREIGN_PUBLISHER, FULL_DISK, BROWN_OUT = "foreign publisher", "full disk", "brown-out"
LOST_BYTES, WRONG_BYTES = "lost bytes", "wrong bytes"
SERIAL, FLIGHT_CONTROLLER, DISK = "serial line", "flight controller", "disk of the recorder"


def _relayed() -> tuple[str, ...]:
    """Return the topics from one node of a race to another one."""
    subscribed = {topic for name in RACERS for topic in NODES[name].subscribes}
    return tuple(
        topic.name
        for topic in TOPICS.values()
        if topic.name in subscribed
        and not topic.shared
        and topic.name != "/clock"
        and any(topic.name in NODES[name].publishes for name in RACERS)
    )


VICTIMS = tuple(name for name in RACERS if name != "bridge")  # without the simulator there is no flight to judge
RELAYED = _relayed()
WITH_NUMBERS = tuple(name for name in RELAYED if name not in ("camera/image_raw", "race/judged"))
FOREIGN = tuple(name for name in RELAYED if not name.startswith("camera/"))


@dataclass(frozen=True)
class Kind:
    """One kind of fault.

    Attributes:
        meaning: description for a reader; {size} is replaced.
        targets: nodes, topics or other parts that it can be planted in.
        lasts: whether it has a duration.
        sizes: smallest and largest size, drawn log-uniformly; None without one.
    """

    meaning: str
    targets: tuple[str, ...]
    lasts: bool = True
    sizes: tuple[float, float] | None = None


KINDS = {
    KILL: Kind("killed by SIGKILL", VICTIMS, lasts=False),
    FREEZE: Kind("stopped by SIGSTOP, continued by SIGCONT if it ends", VICTIMS),
    TERMINATE: Kind("ended by SIGTERM", VICTIMS, lasts=False),
    DELAY: Kind("messages arrive {size:.3g} s late", RELAYED, sizes=(0.01, 1.0)),
    DROP: Kind("a share of {size:.2g} of the messages is lost", RELAYED, sizes=(0.03, 1.0)),
    DUPLICATE: Kind("{size:.0f} copies of each message", RELAYED, sizes=(2, 20)),
    REORDER: Kind("groups of {size:.0f} messages in random order", RELAYED, sizes=(2, 10)),
    NOT_A_NUMBER: Kind("NaN or infinity in a share of {size:.2g} of the messages", WITH_NUMBERS, sizes=(0.03, 1.0)),
    ABSURD_VALUE: Kind("a number times {size:.1g} in each message", WITH_NUMBERS, sizes=(10.0, 1e300)),
    TIME_JUMP: Kind("stamps jump by up to {size:.3g} s", RELAYED, sizes=(0.01, 100.0)),
    FOREIGN_PUBLISHER: Kind("another publisher, {size:.0f} messages per second", FOREIGN, sizes=(1, 1000)),
    FULL_DISK: Kind("nothing more can be written", (DISK,), lasts=False),
    LOST_BYTES: Kind("a share of {size:.2g} of the bytes is lost", (SERIAL,), sizes=(0.001, 1.0)),
    WRONG_BYTES: Kind("a share of {size:.2g} of the bytes is changed", (SERIAL,), sizes=(0.001, 1.0)),
    BROWN_OUT: Kind("restarts for lack of voltage", (FLIGHT_CONTROLLER,), lasts=False),
}


@dataclass(frozen=True)
class Fault:
    """A fault to plant in a race.

    Attributes:
        seed: of the draw, of the race and of what is random in the fault.
        clock: of the race, LOCKSTEP or REAL_TIME.
        kind: key of KINDS.
        target: node, topic or other part that it is planted in.
        at_s: s after the start signal.
        duration_s: s that it lasts; FOREVER_S: to the end.
        size: see the kind's meaning; 0.0 without one.
    """

    seed: int
    clock: str
    kind: str
    target: str
    at_s: float
    duration_s: float
    size: float

    @property
    def sentence(self) -> str:
        """The fault in words."""
        kind = KINDS[self.kind]
        lasts = "" if not kind.lasts or self.duration_s == FOREVER_S else f", for {self.duration_s:.2f} s"
        meaning = kind.meaning.format(size=self.size)
        return f"{self.clock}, {self.at_s:.2f} s after the start: {self.target}: {meaning}{lasts}"


def draw(seed: int) -> Fault:
    """Return the fault of a seed: even seeds in lockstep, odd ones in real time."""
    rng = seeds.generator(seed, "fault")
    name = str(rng.choice(list(KINDS)))
    kind = KINDS[name]
    target = str(rng.choice(kind.targets))
    at_s = round(float(rng.uniform(FIRST_S, LAST_S)), 3)
    duration_s = round(_log_uniform(rng, SHORTEST_S, LONGEST_S), 3)
    forever = not kind.lasts or rng.random() < FOREVER_SHARE
    size = _log_uniform(rng, *kind.sizes) if kind.sizes else 0.0
    return Fault(seed, CLOCKS[seed % 2], name, target, at_s, FOREVER_S if forever else duration_s, size)


def _log_uniform(rng, low: float, high: float) -> float:
    return math.exp(rng.uniform(math.log(low), math.log(high)))

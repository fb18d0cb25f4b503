"""Who is alive and how fast: rates, latencies and silences of the graph's topics, and the node to blame. Pure.

Times are told by the caller: `now_ns` on the node's clock (simulated in lockstep), `steady_s` on the steady clock.
"""

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from swift_ros.graph.topic_table import NODES, TOPICS

WINDOW_S = 5.0
# A watchdog that was starved wakes up to a clock ahead of what is still in its queues: it believes a silence only after
# so many looks, between which the queues were read.
BELIEF_LOOKS = 5
SAMPLES = 600
RATE_SHARE = 0.8  # slower than this share of its rate, a topic gets a warning


@dataclass(frozen=True)
class Health:
    """One topic's health. level: "ok", "warn" or "error"; rate_hz: over the last seconds, NaN when too few; latency p50
    and p99: ms from header stamp to reception, NaN when not known; age_s: since the last message, NaN before any."""

    topic: str
    level: str
    text: str
    rate_hz: float
    latency_p50_ms: float
    latency_p99_ms: float
    age_s: float


@dataclass
class _Topic:
    first_ns: int
    look: int = 0
    received_ns: deque = field(default_factory=lambda: deque(maxlen=SAMPLES))
    latencies_ms: deque = field(default_factory=lambda: deque(maxlen=SAMPLES))


class Watchdog:
    """Watches the topics that `rows` (names of started nodes) publish."""

    def __init__(self, rows=tuple(NODES)):
        self._rows = [NODES[name] for name in rows]
        published = {topic for row in self._rows for topic in row.publishes}
        self._watched = [name for name in TOPICS if name in published]
        self._heard: dict[str, _Topic] = {}
        self._looks = 0
        self._asked = {row.name: deque(maxlen=SAMPLES) for row in self._rows if row.answers}

    def hear(self, topic: str, stamp_ns: int | None, now_ns: int, steady_s: float) -> None:
        """Note one message; stamp_ns: of its header (of the command it answers for betaflight/link), None without."""
        state = self._heard.setdefault(topic, _Topic(now_ns))
        state.look = self._looks
        state.received_ns.append(now_ns)
        if stamp_ns is None:
            return
        state.latencies_ms.append(1e-6 * (now_ns - stamp_ns))
        for row in self._rows:
            if row.answers == topic:
                self._asked[row.name].append((stamp_ns, steady_s))
            if row.answers and row.publishes[0] == topic:
                asked = self._asked[row.name]
                while asked and asked[0][0] <= stamp_ns:
                    asked.popleft()

    def unheard(self) -> list[str]:
        """Return the topics that should be there before a race and have never been heard."""
        return [name for name in self._watched if TOPICS[name].silence_s and name not in self._heard]

    def look(self) -> None:
        """Note that time has passed; to be called at a steady rate of some 50 Hz, between messages."""
        self._looks += 1

    def silent(self, now_ns: int) -> list[str]:
        """Return the topics that were heard and have fallen silent, in the order of the table."""
        missed = [name for name in self._watched if name in self._heard and TOPICS[name].silence_s]
        late = [name for name in missed if self._age_s(name, now_ns) > TOPICS[name].silence_s]
        return [name for name in late if self._looks - self._heard[name].look > BELIEF_LOOKS]

    def culprit(self, now_ns: int, steady_s: float) -> str | None:
        """Return the node to blame for a silence: the one with the oldest unanswered message, if that is older than
        work takes; else the first whose topic is silent; None when nothing is amiss."""
        waiting = [(asked[0][1], name) for name, asked in self._asked.items() if asked]
        waiting = [(since_s, name) for since_s, name in waiting if steady_s - since_s > _work_s(name)]
        if waiting:
            return min(waiting)[1]
        silent = self.silent(now_ns)
        return next((row.name for topic in silent for row in self._rows if topic in row.publishes), None)

    def health(self, now_ns: int, racing: bool) -> list[Health]:
        """Return the health of each watched topic with a rate, in the order of the table; while not racing, a topic
        that has not been heard is no fault."""
        return [self._health(name, now_ns, racing) for name in self._watched if TOPICS[name].rate_hz]

    def _age_s(self, name: str, now_ns: int) -> float:
        return 1e-9 * (now_ns - self._heard[name].received_ns[-1])

    def _health(self, name: str, now_ns: int, racing: bool) -> Health:
        state, topic, nan = self._heard.get(name), TOPICS[name], float("nan")
        if state is None:
            level = "error" if racing and topic.silence_s else "ok"
            return Health(name, level, "never heard", nan, nan, nan, nan)
        recent = [t for t in state.received_ns if now_ns - t <= 1e9 * WINDOW_S]
        span = 1e-9 * (now_ns - max(state.first_ns, recent[0])) if recent else 0.0
        rate = len(recent) / span if span > 0.5 else nan
        p50, p99 = np.percentile(state.latencies_ms, (50, 99)) if state.latencies_ms else (nan, nan)
        age = self._age_s(name, now_ns)
        if topic.silence_s and age > topic.silence_s:
            level, text = ("error" if racing else "warn"), f"silent for {age:.2f} s"
        elif rate < RATE_SHARE * topic.rate_hz:
            level, text = "warn", f"{rate:.0f} Hz instead of {topic.rate_hz:g}"
        else:
            level, text = "ok", "as it should be"
        return Health(name, level, text, rate, float(p50), float(p99), age)


def _work_s(node: str) -> float:
    """How long (s) an answer of a node may be under way before it is owed."""
    return 0.5 * (TOPICS[NODES[node].publishes[0]].silence_s or 0.0)

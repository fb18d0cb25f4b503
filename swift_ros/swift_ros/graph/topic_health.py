"""Health of the graph's topics: rates, latencies, silent topics, and the node at fault. No ROS.

The caller passes the times: `now_ns` on the node's clock (simulated in lockstep), `steady_s` on the steady clock,
in lockstep in working time.
"""

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from swift_ros.graph.topic_table import NODES, TOPICS

WINDOW_S = 5.0  # s; rates are means over this time; longer is smoother and reports a loss later
# A monitor that got no CPU time may read its clock before the messages that wait in its queues. It therefore reports a
# silence only after this many calls of `count_check` without a message, before or between which the queues are read.
MIN_SILENT_CHECKS = 5
MAX_SAMPLES = 600  # messages kept for each topic: WINDOW_S at 100 Hz, and 1 s more
MIN_RATE_SHARE = 0.8  # a topic slower than this share of its nominal rate, one message in five missing, gets a warning
MIN_SPAN_S = 0.5  # s; over less time no rate is computed: it would be of 15 messages at 30 Hz


@dataclass(frozen=True)
class TopicHealth:
    """Health of one topic.

    Attributes:
        topic: its name in the table.
        level: "ok", "warn" or "error".
        text: a sentence for the reader.
        rate_hz: mean rate over the last seconds, Hz; NaN when there are too few messages.
        latency_p50_ms: median time from header stamp to reception, ms; NaN when unknown.
        latency_p99_ms: 99th percentile of the same, ms.
        age_s: time since the last message, s; NaN before the first.
    """

    topic: str
    level: str
    text: str
    rate_hz: float
    latency_p50_ms: float
    latency_p99_ms: float
    age_s: float


@dataclass
class _Reception:
    first_ns: int
    last_check: int = 0
    received_ns: deque = field(default_factory=lambda: deque(maxlen=MAX_SAMPLES))
    latencies_ms: deque = field(default_factory=lambda: deque(maxlen=MAX_SAMPLES))


class TopicMonitor:
    """Monitors the topics that a set of nodes publishes.

    Args:
        nodes: names of the nodes that run, rows of the table.
    """

    def __init__(self, nodes=tuple(NODES)):
        self._rows = [NODES[name] for name in nodes]
        published = {topic for row in self._rows for topic in row.publishes}
        self._monitored = [name for name in TOPICS if name in published]
        self._received: dict[str, _Reception] = {}
        self._checks = 0
        # by node: (stamp, steady time of reception) of each input that waits for its answer
        self._unanswered = {row.name: deque(maxlen=MAX_SAMPLES) for row in self._rows if row.answers}

    def record(self, topic: str, stamp_ns: int | None, now_ns: int, steady_s: float) -> None:
        """Record the reception of one message.

        Args:
            topic: its name in the table.
            stamp_ns: stamp of its header, or for betaflight/link of the command that it answers; None without a stamp.
                `ros2 topic pub` sends 0, which is none either.
            now_ns: time of reception on the node's clock.
            steady_s: time of reception on the steady clock.
        """
        reception = self._received.setdefault(topic, _Reception(now_ns))
        reception.last_check = self._checks
        reception.received_ns.append(now_ns)
        if not stamp_ns:
            return
        reception.latencies_ms.append(1e-6 * (now_ns - stamp_ns))
        for row in self._rows:
            if row.answers == topic:
                self._unanswered[row.name].append((stamp_ns, steady_s))
            if row.answers and row.publishes[0] == topic:
                unanswered = self._unanswered[row.name]
                while unanswered and unanswered[0][0] <= stamp_ns:
                    unanswered.popleft()

    def topics_not_received(self) -> list[str]:
        """Return the topics that must be present before a race and of which no message has come yet."""
        return [name for name in self._monitored if TOPICS[name].silence_s and name not in self._received]

    def count_check(self) -> None:
        """Count one periodic check. Call it at a steady rate of about 50 Hz, after the messages received before it."""
        self._checks += 1

    def silent_topics(self, now_ns: int) -> list[str]:
        """Return the topics that were received before and are now silent, in the order of the table."""
        limits = {name: TOPICS[name].silence_s for name in self._monitored if name in self._received}
        late = [name for name, silence_s in limits.items() if silence_s and self._age_s(name, now_ns) > silence_s]
        return [name for name in late if self._checks - self._received[name].last_check > MIN_SILENT_CHECKS]

    def node_at_fault(self, now_ns: int, steady_s: float) -> str | None:
        """Return the node that causes a silence, None when there is no fault.

        This is the node with the oldest unanswered input, if that is older than the node's allowed processing time;
        else the publisher of the first silent topic.
        """
        waiting = [(unanswered[0][1], name) for name, unanswered in self._unanswered.items() if unanswered]
        waiting = [(since_s, name) for since_s, name in waiting if steady_s - since_s > _allowed_processing_s(name)]
        if waiting:
            return min(waiting)[1]
        silent = self.silent_topics(now_ns)
        return next((row.name for topic in silent for row in self._rows if topic in row.publishes), None)

    def health(self, now_ns: int, racing: bool) -> list[TopicHealth]:
        """Return the health of each monitored topic that has a nominal rate, in the order of the table.

        Only while racing is a topic without any message an error.
        """
        return [self._health(name, now_ns, racing) for name in self._monitored if TOPICS[name].rate_hz]

    def _age_s(self, name: str, now_ns: int) -> float:
        return 1e-9 * (now_ns - self._received[name].received_ns[-1])

    def _health(self, name: str, now_ns: int, racing: bool) -> TopicHealth:
        reception, topic, nan = self._received.get(name), TOPICS[name], float("nan")
        if reception is None:
            level = "error" if racing and topic.silence_s else "ok"
            return TopicHealth(
                topic=name,
                level=level,
                text="no message received",
                rate_hz=nan,
                latency_p50_ms=nan,
                latency_p99_ms=nan,
                age_s=nan,
            )
        recent = [t for t in reception.received_ns if now_ns - t <= 1e9 * WINDOW_S]
        span = 1e-9 * (now_ns - max(reception.first_ns, recent[0])) if recent else 0.0
        rate = len(recent) / span if span > MIN_SPAN_S else nan
        p50, p99 = np.percentile(reception.latencies_ms, (50, 99)) if reception.latencies_ms else (nan, nan)
        age = self._age_s(name, now_ns)
        if topic.silence_s and age > topic.silence_s:
            level, text = ("error" if racing else "warn"), f"silent for {age:.2f} s"
        elif topic.rate_hz and rate < MIN_RATE_SHARE * topic.rate_hz:
            level, text = "warn", f"{rate:.0f} Hz instead of {topic.rate_hz:g}"
        else:
            level, text = "ok", "nominal"
        return TopicHealth(
            topic=name,
            level=level,
            text=text,
            rate_hz=rate,
            latency_p50_ms=float(p50),
            latency_p99_ms=float(p99),
            age_s=age,
        )


def _allowed_processing_s(node: str) -> float:
    """Return the time (s) that a node may take for an answer before it counts as blocked."""
    return 0.5 * (TOPICS[NODES[node].publishes[0]].silence_s or 0.0)

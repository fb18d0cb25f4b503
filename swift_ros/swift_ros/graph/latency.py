"""Latency of each hop of the graph, from the publication times of its messages. No ROS.

Publication times are source time stamps of the middleware. The last hop ends when the write of the MSP frame has
returned (header stamp of `betaflight/link`).
"""

import bisect
from collections import defaultdict

import numpy as np

# A hop leads from a topic to the topic whose message with the same stamp answers it.
ODOMETRY_CHAIN = ("vio/raw", "vio/odometry", "state/odometry", "command/body_rate_thrust", "betaflight/link")
IMAGE_CHAIN = ("camera/image_raw", "gates/detections", "gates/poses", "state/updates")
FRAME = "first MSP frame written"  # end of both chains, part of the keys of the result
TOPICS = tuple(dict.fromkeys(IMAGE_CHAIN + ODOMETRY_CHAIN))
# ns; a header stamp that differs from its publication time by more is on another clock (simulated time)
MAX_SAME_CLOCK_NS = 1_000_000_000


class Publications:
    """Publication times of messages: add each with `record`, then call `hops`."""

    def __init__(self):
        self._at_ns: dict[str, dict[int, int]] = defaultdict(dict)

    def record(self, topic: str, stamp_ns: int, published_ns: int) -> None:
        """Record one message.

        Args:
            topic: its name in the table.
            stamp_ns: header stamp; for betaflight/link the stamp of the command that it answers.
            published_ns: publication time; for betaflight/link the time of the write (see `written_ns`).
        """
        self._at_ns[topic].setdefault(stamp_ns, published_ns)

    def hops(self) -> dict[str, np.ndarray]:
        """Return the latencies (ms) of each hop in the order of the chains.

        "image to …" and "odometry to …" are the latencies of the whole chains.
        """
        result = self._chain(ODOMETRY_CHAIN)
        complete = self._answered(ODOMETRY_CHAIN[0], ODOMETRY_CHAIN[-1]) or self._answered(*ODOMETRY_CHAIN[1::3])
        result[f"odometry to {FRAME}"] = _ms(complete)
        result |= self._chain(IMAGE_CHAIN)
        used = self._first_states()
        result["state/updates to state/odometry"] = _ms([(updated, state) for _, updated, state, _ in used])
        result[f"image to {FRAME}"] = _ms([(image, frame) for image, _, _, frame in used])
        return result

    def _chain(self, topics) -> dict[str, np.ndarray]:
        pairs = zip(topics[:-1], topics[1:], strict=True)
        return {f"{asked} to {answer}": _ms(self._answered(asked, answer)) for asked, answer in pairs}

    def _answered(self, asked: str, answer: str) -> list[tuple[int, int]]:
        answers = self._at_ns[answer]
        return [(at, answers[stamp]) for stamp, at in self._at_ns[asked].items() if stamp in answers]

    def _first_states(self) -> list[tuple[int, int, int, int]]:
        """Return for each image the publication times (ns) of itself, its update, the next state and its MSP frame."""
        states = sorted((at, stamp) for stamp, at in self._at_ns["state/odometry"].items())
        sent = [at for at, _ in states]
        found = []
        for stamp, image_ns in self._at_ns["camera/image_raw"].items():
            updated_ns = self._at_ns["state/updates"].get(stamp)
            if updated_ns is None:
                continue
            for at, state in states[bisect.bisect_right(sent, updated_ns) :]:
                frame_ns = self._at_ns["betaflight/link"].get(state)
                if frame_ns is not None:
                    found.append((image_ns, updated_ns, at, frame_ns))
                    break
        return found


def written_ns(header_ns: int, published_ns: int) -> int:
    """Return when the write of an MSP frame returned: its header stamp, or on simulated time its publication time."""
    return header_ns if abs(published_ns - header_ns) < MAX_SAME_CLOCK_NS else published_ns


def table(hops: dict[str, np.ndarray]) -> str:
    """Return a text table of the hops: count, p50, p99 and maximum, ms."""
    width = max(map(len, hops), default=0)
    lines = [f"{'hop':<{width}}  {'n':>6}  {'p50 ms':>7}  {'p99 ms':>7}  {'max ms':>7}"]
    for name, values in hops.items():
        numbers = (f"{value:7.2f}" for value in (*np.percentile(values, (50, 99)), values.max())) if len(values) else ()
        lines.append(f"{name:<{width}}  {len(values):>6}  " + "  ".join(numbers))
    return "\n".join(line.rstrip() for line in lines)


def _ms(pairs) -> np.ndarray:
    return np.array([1e-6 * (late - early) for early, late in pairs])

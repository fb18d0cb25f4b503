"""How long the graph takes, hop by hop, from who published what and when. Pure.

Times are of the publishing process, taken by the middleware as it sends; the last hop ends when the write of the MSP
frame returned (`betaflight/link`'s header stamp).
"""

import bisect
from collections import defaultdict

import numpy as np

# one hop: a topic and the topic whose message with the same stamp answers it
ODOMETRY_CHAIN = ("vio/raw", "vio/odometry", "state/odometry", "command/body_rate_thrust", "betaflight/link")
IMAGE_CHAIN = ("camera/image_raw", "gates/detections", "gates/poses", "state/updates")
FRAME = "first MSP frame written"
TOPICS = tuple(dict.fromkeys(IMAGE_CHAIN + ODOMETRY_CHAIN))
CLOCKS_DIFFER_NS = 1_000_000_000


class Publications:
    """When each message was published: `note` it, then ask for `hops`."""

    def __init__(self):
        self._at_ns: dict[str, dict[int, int]] = defaultdict(dict)

    def note(self, topic: str, stamp_ns: int, published_ns: int) -> None:
        """Note one message. For betaflight/link, stamp_ns is that of the command it answers and published_ns the moment
        of the write (see `written_ns`)."""
        self._at_ns[topic].setdefault(stamp_ns, published_ns)

    def hops(self) -> dict[str, np.ndarray]:
        """Return ms by hop, in the order of the chains; "image to …" and "odometry to …" are the whole ways."""
        result = self._chain(ODOMETRY_CHAIN)
        whole = self._answered(ODOMETRY_CHAIN[0], ODOMETRY_CHAIN[-1]) or self._answered(*ODOMETRY_CHAIN[1::3])
        result[f"odometry to {FRAME}"] = _ms(whole)
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
        """For each image that moved or left the state: when it, its update, the first state thereafter and that state's
        frame went out."""
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
    """Return when the write of an MSP frame returned: the link's own word, or, on simulated time, its publication."""
    return header_ns if abs(published_ns - header_ns) < CLOCKS_DIFFER_NS else published_ns


def table(hops: dict[str, np.ndarray]) -> str:
    """Return hops as text: count, p50, p99 and worst, ms."""
    width = max(map(len, hops), default=0)
    lines = [f"{'hop':<{width}}  {'n':>6}  {'p50 ms':>7}  {'p99 ms':>7}  {'max ms':>7}"]
    for name, values in hops.items():
        numbers = (f"{value:7.2f}" for value in (*np.percentile(values, (50, 99)), values.max())) if len(values) else ()
        lines.append(f"{name:<{width}}  {len(values):>6}  " + "  ".join(numbers))
    return "\n".join(line.rstrip() for line in lines)


def _ms(pairs) -> np.ndarray:
    return np.array([1e-6 * (late - early) for early, late in pairs])

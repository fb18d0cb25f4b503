"""The time from a state to the moment in which its command is in force, in recorded flights in real time."""

from pathlib import Path

import numpy as np

from swift_ros.graph.topic_table import full_name
from swift_ros.messages.stamps import from_time, message_stamp_ns
from swift_ros.recording import bags

SHARE = 0.95  # of the commands; later ones are rare, as where the computer was busy
DIGITS = 2  # of the figure


def measure(recorded: list[Path]) -> float | None:
    """Return the delay, s, that SHARE of the commands in all bags have at most; None where time was simulated."""
    delays = np.concatenate([delays_s(bag) for bag in recorded])
    return float(f"{np.quantile(delays, SHARE):.{DIGITS}g}") if delays.any() else None


def delays_s(bag: Path) -> np.ndarray:
    """Return the times (n,) s from the odometry of a command to its first MSP frame; zeros in lockstep."""
    first: dict[int, float] = {}
    for _, link, _ in bags.read(bag, [full_name("betaflight/link")]):
        if stamp_ns := from_time(link.command_stamp):  # that of the odometry from which the command follows
            first.setdefault(stamp_ns, 1e-9 * (message_stamp_ns(link) - stamp_ns))
    return np.array(list(first.values()))

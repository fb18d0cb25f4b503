"""What a report proposes to fly so that look-alikes can be told apart, as paths of the referee's own: name and seconds
are read from the report's sentence, the figures are written a second time.
"""

import re
from collections.abc import Callable

import numpy as np

from swift_sim_bridge.referee.simulator.instruments import LEAD_S
from swift_sim_bridge.referee.simulator.paths import TICK_S, Path

SENTENCE = re.compile(r"(?P<name>.+) for (?P<seconds>\d+) s: \d+ standard deviations apart")
HEIGHT_M, LOW_M, PASS_S = 3.0, 0.2, 6.0
SHAKE_RAD, SHAKE_HZ = np.array([0.15, 0.15, 0.3]), np.array([3.0, 3.7, 1.6])


def _swing(s, size: float, period: float):
    """Return a way forth and back of `size` m."""
    return 0.5 * size * (1.0 - np.cos(2 * np.pi * s / period))


def _still(s):
    return np.tile([0.0, 0.0, HEIGHT_M], (len(s), 1))


def _up(s, height):
    return _still(s) + np.outer(height, [0.0, 0.0, 1.0])


def _punches(s):
    return _up(s, 0.27 * np.sin(2 * np.pi * 0.8 * s))


def _passes(s, size: float = 16.0, period: float = PASS_S):
    return _still(s) + np.outer(_swing(s, size, period), [1.0, 0.0, 0.0])


def _crossed(s):
    return np.where(s[:, None] % (2 * PASS_S) < PASS_S, _passes(s), _still(s) + (_passes(s) - _still(s))[:, [1, 0, 2]])


def _circles(s):
    return _still(s) + np.stack([5.0 * np.cos(1.6 * s), 5.0 * np.sin(1.6 * s), 0.5 * np.sin(3.0 * s)], axis=1)


FIGURES: dict[str, tuple[Callable, float, bool]] = {  # positions m after s seconds, yaw rate rad/s, whether it shakes
    "hover at one place": (_still, 0.0, False),
    "climb and sink at up to 5 m/s": (lambda s: _up(s, _swing(s, 8.0, 5.0)), 0.0, False),
    "punch the throttle, level": (_punches, 0.0, False),
    "roll, pitch and yaw doublets at 2 to 4 Hz": (_still, 0.0, True),
    "roll, pitch and yaw doublets with throttle punches": (_punches, 0.0, True),
    "spin about yaw at 3 rad/s": (_still, 3.0, False),
    "straight passes, forth and back": (_passes, 0.0, False),
    "straight passes, forth and back, then sideways": (_crossed, 0.0, False),
    "straight passes at up to 15 m/s, 40 m forth and back": (lambda s: _passes(s, 40.0, 8.0), 0.0, False),
    "circles at 8 m/s while yawing": (_circles, 0.7, False),
    "low passes at 0.2 m": (lambda s: _passes(s) + [0.0, 0.0, LOW_M - HEIGHT_M], 0.0, False),
}


def proposed(report: dict) -> tuple[str, float] | None:
    """Return the manoeuvre, and for how many seconds, that a report proposes for the first set that it cannot tell
    apart; None where it has no such set, or proposes nothing that a pilot could fly by its name."""
    for found in report.get("findings", []):
        if found["verdict"] == "ambiguous":
            said = SENTENCE.match(found.get("separating_manoeuvre") or "")
            if said and said["name"] in FIGURES:
                return said["name"], float(said["seconds"])
    return None


def path(name: str, seconds: float) -> Path:
    """Return the path of a manoeuvre that is flown for so long after a run-up of LEAD_S, in which it gathers speed from
    rest."""
    figure, turning, shaken = FIGURES[name]
    t = TICK_S * np.arange(round((LEAD_S + seconds) / TICK_S))
    share = np.clip(t / LEAD_S, 0.0, 1.0)
    s = LEAD_S * (share**3 - 0.5 * share**4 - 0.5) + np.maximum(t - LEAD_S, 0.0)  # 0 when the run-up ends
    rate = 3.0 * share**2 - 2.0 * share**3
    p = figure(s)
    v = np.gradient(p, TICK_S, axis=0)
    phase = 2 * np.pi * SHAKE_HZ
    shake = rate[:, None] * SHAKE_RAD * phase * np.cos(np.outer(s, phase)) if shaken else np.zeros_like(p)
    return Path(p, v, np.gradient(v, TICK_S, axis=0), turning * s, turning * rate, shake)

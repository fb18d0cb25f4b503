"""The manoeuvres that a report may propose to separate confounders, as paths of the referee's own.

A finding of the report has the manoeuvre's id and duration; the figures are a second implementation.
"""

from collections.abc import Callable

import numpy as np

from swift_sim_bridge.referee.simulator.instruments import LEAD_S
from swift_sim_bridge.referee.simulator.paths import TICK_S, Path

HEIGHT_M = 3.0  # height of all manoeuvres but the low passes
LOW_M = 0.2  # height of the low passes
PASS_S = 6.0  # period of a straight pass, forth and back
DOUBLET_RAD, DOUBLET_HZ = np.array([0.15, 0.15, 0.3]), np.array([3.0, 3.7, 1.6])  # about x, y, z


def _excursion(s, size: float, period: float):
    """Return a distance (n,) that goes to `size` m and back in each period."""
    return 0.5 * size * (1.0 - np.cos(2 * np.pi * s / period))


def _hover(s):
    """Return one place (n, 3)."""
    return np.tile([0.0, 0.0, HEIGHT_M], (len(s), 1))


def _vertical(s, height):
    """Return a vertical path with a height (n,) over HEIGHT_M."""
    return _hover(s) + np.outer(height, [0.0, 0.0, 1.0])


def _punches(s):
    """Return throttle punches at 0.8 Hz."""
    return _vertical(s, 0.27 * np.sin(2 * np.pi * 0.8 * s))


def _passes(s, size: float = 16.0, period: float = PASS_S):
    """Return straight passes along x."""
    return _hover(s) + np.outer(_excursion(s, size, period), [1.0, 0.0, 0.0])


def _crossed_passes(s):
    """Return straight passes along x and y in turn."""
    return np.where(s[:, None] % (2 * PASS_S) < PASS_S, _passes(s), _hover(s) + (_passes(s) - _hover(s))[:, [1, 0, 2]])


def _circles(s):
    """Return circles of 5 m radius at 8 m/s."""
    return _hover(s) + np.stack([5.0 * np.cos(1.6 * s), 5.0 * np.sin(1.6 * s), 0.5 * np.sin(3.0 * s)], axis=1)


FIGURES: dict[
    str, tuple[Callable, float, bool]
] = {  # by id: position (n, 3) m at times s (n,), yaw rate rad/s, with doublets
    "hover": (_hover, 0.0, False),
    "climb_and_sink": (lambda s: _vertical(s, _excursion(s, 8.0, 5.0)), 0.0, False),
    "throttle_punches": (_punches, 0.0, False),
    "attitude_doublets": (_hover, 0.0, True),
    "attitude_doublets_with_punches": (_punches, 0.0, True),
    "yaw_spin": (_hover, 3.0, False),
    "straight_passes": (_passes, 0.0, False),
    "straight_and_sideways_passes": (_crossed_passes, 0.0, False),
    "fast_passes": (lambda s: _passes(s, 40.0, 8.0), 0.0, False),
    "yawing_circles": (_circles, 0.7, False),
    "low_passes": (lambda s: _passes(s) + [0.0, 0.0, LOW_M - HEIGHT_M], 0.0, False),
}


def proposed_manoeuvre(report: dict) -> tuple[str, float] | None:
    """Return id and duration (s) of the manoeuvre that a report proposes for its first ambiguous finding.

    None if there is no ambiguous finding, or none with a manoeuvre of FIGURES.
    """
    for finding in report.get("findings", []):
        manoeuvre = finding.get("manoeuvre")
        if finding["verdict"] == "ambiguous" and manoeuvre and manoeuvre["id"] in FIGURES:
            return manoeuvre["id"], float(manoeuvre["seconds"])
    return None


def path(manoeuvre: str, seconds: float) -> Path:
    """Return the path of a manoeuvre with this duration, after a run-up from rest of LEAD_S.

    Args:
        manoeuvre: key of FIGURES.
        seconds: duration, s.
    """
    figure, yaw_rate, with_doublets = FIGURES[manoeuvre]
    t = TICK_S * np.arange(round((LEAD_S + seconds) / TICK_S))
    share = np.clip(t / LEAD_S, 0.0, 1.0)
    s = LEAD_S * (share**3 - 0.5 * share**4 - 0.5) + np.maximum(
        t - LEAD_S, 0.0
    )  # time on the figure: 0 at the end of the run-up
    rate = 3.0 * share**2 - 2.0 * share**3
    p = figure(s)
    v = np.gradient(p, TICK_S, axis=0)
    phase = 2 * np.pi * DOUBLET_HZ
    doublets = rate[:, None] * DOUBLET_RAD * phase * np.cos(np.outer(s, phase)) if with_doublets else np.zeros_like(p)
    return Path(p, v, np.gradient(v, TICK_S, axis=0), yaw_rate * s, yaw_rate * rate, doublets)

"""Limits, and flown races against them, by segment, as text for the terminal."""

from collections.abc import Sequence

import numpy as np

from swift_ros.race.limit import Limit, Times
from swift_ros.text import align
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.limit.models import TITLES


def segments(gates: int) -> list[str]:
    """Return the names of a lap's segments: 1-2, 2-3, and so on to gate 1."""
    return [f"{i + 1}-{(i + 1) % gates + 1}" for i in range(gates)]


def limit_table(limit: Limit) -> str:
    """Return a limit: the lap by segment, and the race to its last two passages, for both models."""
    times = [limit.full_thrust, limit.as_flown]
    rows = [("", "full thrust s", "as flown s")]
    rows += [(name, *(f"{one.lap_s[i]:.3f}" for one in times)) for i, name in enumerate(segments(_gates(limit)))]
    rows.append(("lap", *(f"{one.whole_lap_s:.3f}" for one in times)))
    rows.append(("start", *(f"{one.race_s[0]:.3f}" for one in times)))
    rows.append((f"race to gate {_gates(limit)}", *(f"{one.race_before_last_s:.2f}" for one in times)))
    rows.append(("race to gate 1", *(f"{one.whole_race_s:.2f}" for one in times)))
    return align(rows)


def figures(lines, vehicle: Vehicle) -> str:
    """Return length, speed and thrust of the lines, one row each.

    Args:
        lines: by course and model, see `solve.solve_limit`.
        vehicle: of the lines.
    """
    rows = [("", "length m", "mean m/s", "top m/s", "force along z, mean N", "lowest V")]
    for course, by_model in lines.items():
        for kind, line in by_model.items():
            force = line.mean(vehicle.mass * line.specific_force_body[:, 2])
            numbers = (line.length_m, line.length_m / line.t_s[-1], line.speed.max(), force)
            rows.append((f"{course}, {TITLES[kind]}", *(f"{n:.1f}" for n in numbers), f"{line.voltage.min():.2f}"))
    return align(rows)


def flown_table(limit: Limit, races: Sequence[np.ndarray]) -> str:
    """Return flown laps by segment beside the limit as flown, and what they lose on it.

    Args:
        limit: of the track and the vehicle.
        races: of each race the times of its segments, s: podium to gate 1, gate 1 to 2, and so on.
    """
    gates, times = _gates(limit), limit.as_flown
    laps = [race[first : first + gates] for race in races for first in range(1, len(race) - gates + 1, gates)]
    rows = [("", "limit s", "best s", "median s", "lost s", "times limit")]
    if laps:
        whole = np.sum(laps, axis=1)
        best, median = laps[int(np.argmin(whole))], np.median(laps, axis=0)
        for i, name in enumerate(segments(gates)):
            rows.append(_row(name, times.lap_s[i], best[i], median[i], 3))
        rows.append(_row("lap", times.whole_lap_s, whole.min(), float(np.median(whole)), 3))
    starts = [race[0] for race in races if len(race)]
    if starts:
        rows.append(_row("start", times.race_s[0], min(starts), float(np.median(starts)), 3))
    for name, count, least in _endings(times, gates):
        whole = [race[:count].sum() for race in races if len(race) >= count]
        if whole:
            rows.append(_row(name, least, min(whole), float(np.median(whole)), 2))
    return align(rows) + f"\nbest: the fastest lap or race; {len(laps)} laps of {len(races)} races"


def _endings(times: Times, gates: int):
    yield f"race to gate {gates}", len(times.race_s) - 1, times.race_before_last_s
    yield "race to gate 1", len(times.race_s), times.whole_race_s


def _row(name: str, least: float, best: float, median: float, digits: int) -> tuple[str, ...]:
    numbers = (f"{value:.{digits}f}" for value in (least, best, median, median - least))
    return (name, *numbers, f"{median / least:.3f}")


def _gates(limit: Limit) -> int:
    return len(limit.as_flown.lap_s)

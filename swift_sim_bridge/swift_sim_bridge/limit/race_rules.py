"""The rules of a race applied to a time-optimal line."""

from swift_ros import geometry
from swift_ros.race.judge import FINISHED, Judge, RaceEvent
from swift_ros.track import Track
from swift_ros.types import Odometry
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.limit.line import Line

BEYOND_S = (0.03, 0.06, 0.09)  # s, a line goes straight on for so long, until the hull has left the last gate


def race_events(line: Line, track: Track, vehicle: Vehicle) -> list[RaceEvent]:
    """Return the events of a race along a line, which begins with the start signal."""
    judge = Judge(track, vehicle.hull_radius, vehicle.hull_height)
    judge.start(0)
    v_body = geometry.rotate_inverse(line.q_world_body, line.v_world)
    rows = list(zip(line.t_s, line.p_world, line.q_world_body, v_body, line.omega_body, strict=True))
    for later_s in BEYOND_S:
        rows.append((line.t_s[-1] + later_s, line.p_world[-1] + later_s * line.v_world[-1], *rows[-1][2:]))
    return [event for t, *state in rows for event in judge.update(Odometry(round(1e9 * t), *state))]


def verdict(line: Line, track: Track, vehicle: Vehicle) -> str:
    """Return a sentence on a race along a line: its smallest margin, or what the hull touches."""
    events = race_events(line, track, vehicle)
    if events and events[-1].state == FINISHED:
        return f"by the rules of a race it finishes; smallest margin {min(one.margin_m for one in events):.3f} m"
    touched = events[-1].text if events and not events[-1].is_passage else "passes no further gate"
    passed = sum(one.is_passage for one in events)
    return f"warning: by the rules of a race it {touched} after {passed} passages; the limit may be too short"

"""The physical limit of a track and a vehicle: lap and race, of full thrust and as flown."""

import time
from collections.abc import Callable

from swift_ros.errors import UsageError
from swift_ros.race import limit
from swift_ros.race.limit import Limit, Times
from swift_ros.track import Track
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.limit import course
from swift_sim_bridge.limit.collocation import Flight, NoLine, solve
from swift_sim_bridge.limit.course import Course
from swift_sim_bridge.limit.first_guess import first_guess, with_drive
from swift_sim_bridge.limit.line import Line, line_of
from swift_sim_bridge.limit.models import AS_FLOWN, FULL_THRUST, TITLES, Model, make_model

STEP_S = 0.04  # s, longest interval; between 0.06 and 0.03 s the lap of the shipped track grows by 0.04 %
# Shares of the vehicle's roll rate at which the point mass of a first guess turns its thrust. Each may lead to another
# side of a gate; the fastest solution counts.
TURNING = (1.0, 0.5, 2.0)
SLOWER = 1.05  # times of a vehicle with battery and air over those of full thrust, in its first guess
PROGRESS_S = 5.0  # s between two lines of progress

CURE = "check places, order and directions of the gates with `swiftros check`"

LAP, RACE = "lap", "race"


def solve_limit(
    vehicle: Vehicle, track: Track, headroom: float, say: Callable[[str], None]
) -> dict[str, dict[str, Line]]:
    """Return the time-optimal lines by course (LAP, RACE) and model (FULL_THRUST, AS_FLOWN).

    Args:
        vehicle: the vehicle file.
        track: with at least two gates.
        headroom: share of the motor commands that is left to the rate loop as flown.
        say: called with each line of progress.

    Raises:
        UsageError: no line was found.
    """
    ideal, flown = (make_model(vehicle, kind, headroom) for kind in (FULL_THRUST, AS_FLOWN))
    lap, race = course.flying_lap(track, vehicle), course.race(track, vehicle)
    laps = _attempts(ideal, vehicle, lap, TURNING, say)
    best = min(laps, key=lambda turning: laps[turning].durations_s.sum())
    races = _attempts(ideal, vehicle, race, (best, *(one for one in TURNING if one != best)), say, most=1)
    lines = {}
    for name, one, flight in ((LAP, lap, laps[best]), (RACE, race, next(iter(races.values())))):
        title = f"{one.name}, {TITLES[AS_FLOWN]}"
        try:
            slower = solve(flown, one, with_drive(flight, flown, SLOWER), _reporter(title, say))
        except NoLine as reason:
            raise UsageError(f"no {title}, was found for '{track.name}' (IPOPT: {reason}); {CURE}") from reason
        lines[name] = {FULL_THRUST: line_of(ideal, flight), AS_FLOWN: line_of(flown, slower)}
    return lines


def _attempts(
    model: Model, vehicle: Vehicle, one: Course, turnings, say, most: int | None = None
) -> dict[float, Flight]:
    """Return flights of full thrust by the `turning` of their first guess, at most `most` of them.

    Raises UsageError without one.
    """
    found, reason = {}, None
    for turning in turnings:
        if len(found) == most:
            break
        title = f"{one.name}, {TITLES[FULL_THRUST]}, guess {turnings.index(turning) + 1} of {len(turnings)}"
        report = _reporter(title, say)
        try:
            found[turning] = solve(model, one, first_guess(vehicle, one, STEP_S, turning, report), report)
            say(f"{title}: {found[turning].durations_s.sum():.3f} s")
        except NoLine as failure:
            reason = failure
            say(f"{title}: {reason}")
    if not found:
        raise UsageError(f"no {one.name} was found for '{one.track.name}' (IPOPT: {reason}); {CURE}")
    return found


def _reporter(title: str, say: Callable[[str], None]) -> Callable[[int, float], None]:
    """Return a report of iterations that says a line every PROGRESS_S."""
    said_s = time.monotonic()

    def report(iteration: int, flight_s: float) -> None:
        nonlocal said_s
        if time.monotonic() - said_s >= PROGRESS_S:
            said_s = time.monotonic()
            say(f"{title}: iteration {iteration}, {flight_s:.2f} s")

    return report


def limit_of(lines: dict[str, dict[str, Line]], track: Track, vehicle: Vehicle, headroom: float) -> Limit:
    """Return the content of `limit.yaml`; times are rounded to 0.1 ms."""
    track_sha256, vehicle_sha256 = limit.key_of(track, vehicle)

    def times(kind: str) -> Times:
        return Times(*(tuple(round(float(s), 4) for s in lines[name][kind].segments_s) for name in (LAP, RACE)))

    return Limit(
        track=track.name,
        vehicle=vehicle.name,
        track_sha256=track_sha256,
        vehicle_sha256=vehicle_sha256,
        headroom=headroom,
        full_thrust=times(FULL_THRUST),
        as_flown=times(AS_FLOWN),
    )

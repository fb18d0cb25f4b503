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
from swift_sim_bridge.limit.models import AS_FLOWN, FULL_THRUST, TITLES, Model, P, make_model
from swift_sim_bridge.limit.obstacles import Detour, Touch, sides, touches

STEP_S = 0.04  # s, longest interval; between 0.06 and 0.03 s the lap of the shipped track grows by 0.04 %
# Shares of the vehicle's roll rate at which the point mass of a first guess turns its thrust. Each may lead to another
# side of a gate; the fastest solution counts.
TURNING = (1.0, 0.5, 2.0)
SLOWER = 1.05  # times of a vehicle with battery and air over those of full thrust, in its first guess
SIDES_TRIED = 2  # of a frame beside the way, the nearest ones; the fastest line counts
MOST_ROUNDS = 8  # round one frame; in each the points that still touch it are added
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
        title = f"{one.name}, {TITLES[FULL_THRUST]}, round frames"
        try:
            flight, detours = clear_of_frames(ideal, one, flight, (), _reporter(title, say))
            title = f"{one.name}, {TITLES[AS_FLOWN]}"
            report = _reporter(title, say)
            slower = solve(flown, one, with_drive(flight, flown, SLOWER), report, detours)
            slower, _ = clear_of_frames(flown, one, slower, detours, report)
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


def clear_of_frames(
    model: Model, one: Course, flight: Flight, detours: tuple[Detour, ...], report
) -> tuple[Flight, tuple[Detour, ...]]:
    """Return the fastest flight found that touches no frame beside its way, and its detours.

    Raises NoLine when there is none.
    """
    for _ in range(MOST_ROUNDS):
        found = touches(one, flight.segments, flight.states[:, P])
        if not found:
            return flight, detours
        known = next((each for each in detours if each.touch.is_at(found[0])), None)
        if known is None:
            return _round_new_frame(model, one, flight, detours, found[0], report)
        wider = Detour(known.touch.joined(found[0]), known.side)
        detours = (*(each for each in detours if each is not known), wider)
        flight = solve(model, one, flight, report, detours)
    raise NoLine(f"gate {found[0].gate + 1} was touched after {MOST_ROUNDS} rounds")


def _round_new_frame(model: Model, one: Course, flight: Flight, detours, found: Touch, report):
    """Return the flight and the detours of the faster side of a frame; see `clear_of_frames`."""
    solved, reason = [], None
    for side in sides(one, found.gate, flight.states[list(found.points), P])[:SIDES_TRIED]:
        tried = (*detours, Detour(found, side))
        try:
            solved.append(clear_of_frames(model, one, solve(model, one, flight, report, tried), tried, report))
        except NoLine as failure:
            reason = failure
    if not solved:
        raise NoLine(f"round gate {found.gate + 1}: {reason}")
    return min(solved, key=lambda pair: pair[0].durations_s.sum())


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

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

STEP_S = 0.03  # s, longest interval; half of it changes the lap of the shipped track by less than 0.01 %
# Shares of the vehicle's roll rate at which the point mass of a first guess turns its thrust. Each may lead to another
# side of a gate; the fastest solution counts.
TURNING = (1.0, 0.5, 2.0)
SLOWER = 1.05  # times of a vehicle with battery and air over those of full thrust, in its first guess
PROGRESS_S = 2.0  # s between two lines of progress

LAP, RACE = "lap", "race"


def solve_limit(vehicle: Vehicle, track: Track, say: Callable[[str], None]) -> dict[str, dict[str, Line]]:
    """Return the time-optimal lines by course (LAP, RACE) and model (FULL_THRUST, AS_FLOWN).

    Args:
        vehicle: the vehicle file.
        track: with at least two gates.
        say: called with each line of progress.

    Raises:
        UsageError: no line was found.
    """
    models = {kind: make_model(vehicle, kind) for kind in (FULL_THRUST, AS_FLOWN)}
    courses = {LAP: course.flying_lap(track, vehicle), RACE: course.race(track, vehicle)}
    return {name: _lines(vehicle, models, one, say) for name, one in courses.items()}


def _lines(vehicle: Vehicle, models: dict[str, Model], one: Course, say) -> dict[str, Line]:
    """Return the lines of a course by model."""
    ideal = _fastest(vehicle, models[FULL_THRUST], one, say)
    flights = {FULL_THRUST: ideal}
    flown = models[AS_FLOWN]
    try:
        flights[AS_FLOWN] = solve(flown, one, with_drive(ideal, flown, SLOWER), _reporter(f"{one.name}, as flown", say))
    except NoLine as reason:
        raise UsageError(_no_line(one, AS_FLOWN, reason)) from reason
    return {kind: line_of(models[kind], flight) for kind, flight in flights.items()}


def _fastest(vehicle: Vehicle, model: Model, one: Course, say) -> Flight:
    """Return the fastest flight with full thrust from several first guesses. Raises UsageError without one."""
    found, reasons = [], []
    for number, turning in enumerate(TURNING, start=1):
        title = f"{one.name}, full thrust, guess {number} of {len(TURNING)}"
        report = _reporter(title, say)
        try:
            found.append(solve(model, one, first_guess(vehicle, one, STEP_S, turning, report), report))
            say(f"{title}: {found[-1].durations_s.sum():.3f} s")
        except NoLine as reason:
            reasons.append(reason)
            say(f"{title}: {reason}")
    if not found:
        raise UsageError(_no_line(one, FULL_THRUST, reasons[-1]))
    return min(found, key=lambda flight: flight.durations_s.sum())


def _no_line(one: Course, kind: str, reason: NoLine) -> str:
    return (
        f"no {one.name} of '{one.track.name}' was found for the vehicle with {TITLES[kind]} (IPOPT: {reason}); check "
        "places, order and directions of the gates with `swiftros check`"
    )


def _reporter(title: str, say: Callable[[str], None]) -> Callable[[int, float], None]:
    """Return a report of iterations that says a line every PROGRESS_S."""
    said_s = time.monotonic()

    def report(iteration: int, flight_s: float) -> None:
        nonlocal said_s
        if time.monotonic() - said_s >= PROGRESS_S:
            said_s = time.monotonic()
            say(f"{title}: iteration {iteration}, {flight_s:.2f} s")

    return report


def limit_of(lines: dict[str, dict[str, Line]], track: Track, vehicle: Vehicle) -> Limit:
    """Return the content of `limit.yaml`; times are rounded to 0.1 ms."""
    track_sha256, vehicle_sha256 = limit.key_of(track, vehicle)

    def times(kind: str) -> Times:
        return Times(*(tuple(round(float(s), 4) for s in lines[name][kind].segments_s) for name in (LAP, RACE)))

    return Limit(track.name, vehicle.name, track_sha256, vehicle_sha256, times(FULL_THRUST), times(AS_FLOWN))

"""Reads a race from its bag, the simulator's report and the runner's faults."""

import json
from dataclasses import replace
from pathlib import Path

from swift_ros.errors import UsageError
from swift_ros.graph.topic_table import full_name
from swift_ros.messages.control import from_command
from swift_ros.messages.motion import from_odometry
from swift_ros.messages.race import from_race_status
from swift_ros.messages.stamps import from_time
from swift_ros.race.judge import ENDS, RACING
from swift_ros.race.result import BAG, FAULTS, REPORT, RaceRecord, RaceResult, result_of
from swift_ros.recording import bags
from swift_ros.track import Track
from swift_ros.vehicle import Vehicle

_ODOMETRY = ("ground_truth/odometry", "state/odometry", "vio/odometry")


def read_race(folder: Path, track: Track, vehicle: Vehicle) -> tuple[RaceResult, RaceRecord]:
    """Return the result and the record of the race in `folder` (its bag and report). Raises UsageError."""
    seed = folder.resolve().name.removeprefix("seed-")
    report = {"seed": int(seed) if seed.isdigit() else None, "faults": _read_json(folder / FAULTS, [])}
    report |= _read_json(folder / REPORT, {})
    record = read_record(folder / BAG)
    return result_of(record, track, vehicle, report), record


def _read_json(path: Path, default):
    try:
        return json.loads(path.read_text()) if path.is_file() else default
    except ValueError as error:
        raise UsageError(f"{path} is not valid JSON; fly the race again") from error


def read_record(bag: Path) -> RaceRecord:
    """Return the race in a bag, an empty record without a bag. Raises UsageError when it has no race/status."""
    if not bag.exists():
        return RaceRecord({topic: [] for topic in _ODOMETRY}, [], None, None)
    bags.require(bag, full_name("race/status"))
    return read_flight(bag)


def read_flight(bag: Path) -> RaceRecord:
    """Return the record of any flight in a bag; without a race it has no events. Raises UsageError without a bag."""
    record = RaceRecord({topic: [] for topic in _ODOMETRY}, [], None, None)
    names = {full_name(topic): topic for topic in (*_ODOMETRY, "race/status", "command/body_rate_thrust", "battery")}
    for full, message, _ in bags.read(bag, names):
        topic = names[full]
        if topic == "race/status":
            record.events.append(from_race_status(message))
        elif topic == "command/body_rate_thrust":
            record.commands.append(from_command(message))
        elif topic == "battery":
            record.voltages.append((from_time(message.header.stamp), message.voltage))
        else:
            record.odometry[topic].append(from_odometry(message))
    start = next((event.stamp_ns for event in record.events if event.state == RACING), None)
    end = next((event.stamp_ns for event in record.events if event.state in ENDS), None)
    return replace(record, start_ns=start, end_ns=end)


def recorded_configuration(bag: Path) -> tuple[Track, Vehicle]:
    """Return the track and the vehicle that the recorder stored in a bag. Raises UsageError when they are missing."""
    return bags.stored_record(bag, Track, "track.yaml"), bags.stored_record(bag, Vehicle, "drone.yaml")


def recorded_models(bag: Path) -> dict[str, str]:
    """Return the SHA-256 of each network that the recorder stored in a bag, by file name."""
    prefix = "sha256 models/"
    custom = bags.custom_data(bag)
    return {name.removeprefix(prefix): text for name, text in sorted(custom.items()) if name.startswith(prefix)}

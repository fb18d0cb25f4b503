"""The time-optimal lap and race of a track and a vehicle, as `swiftros limit` writes them, to compare flights with.

A configuration folder keeps such files in `limits/`. One applies to a flight of the same track and the same vehicle;
names, notes and sensor noise do not matter.
"""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import yaml

from swift_ros import configuration
from swift_ros.race.result import RaceResult
from swift_ros.track import Track
from swift_ros.vehicle import Vehicle

FILE, FOLDER = "limit.yaml", "limits"
# keys of a vehicle file that do not change how it flies
NOTES = ("name", "recording", "sensors")


@dataclass(frozen=True)
class Times:
    """Times of the limit of one model of the vehicle.

    Attributes:
        lap_s: of each segment of a flying lap, s: gate 1 to 2, and so on to gate 1.
        race_s: of each segment of a race, s: podium to gate 1, and so on to the last passage of gate 1.
    """

    lap_s: tuple[float, ...]
    race_s: tuple[float, ...]

    @property
    def whole_lap_s(self) -> float:
        """Time of the flying lap, s."""
        return sum(self.lap_s)

    @property
    def whole_race_s(self) -> float:
        """Time of the race to the last passage of gate 1, s."""
        return sum(self.race_s)

    @property
    def race_before_last_s(self) -> float:
        """Time of the race to the passage before the last one, of the last gate, s."""
        return sum(self.race_s[:-1])


@dataclass(frozen=True)
class Limit:
    """The file `limit.yaml`.

    Attributes:
        track, vehicle: names, for a reader.
        track_sha256, vehicle_sha256: of the contents for which it holds, see `digest`.
        headroom: share of the motor commands that is left to the rate loop as flown.
        full_thrust: of a vehicle that has the vehicle file's largest thrust at any time, without air.
        as_flown: of the vehicle with its battery, motors and aerodynamics.
    """

    track: str
    vehicle: str
    track_sha256: str
    vehicle_sha256: str
    headroom: float
    full_thrust: Times
    as_flown: Times

    @cached_property
    def key(self) -> tuple[str, str]:
        """What must be the same of a flight's track and vehicle, see `key_of`."""
        return self.track_sha256, self.vehicle_sha256


def key_of(track: Track, vehicle: Vehicle) -> tuple[str, str]:
    """Return the hashes of a track and a vehicle."""
    return digest(track), digest(vehicle)


def digest(record) -> str:
    """Return the SHA-256 of a track or a vehicle, without names, notes and sensor noise."""
    content = {key: value for key, value in configuration.content(record).items() if key not in NOTES}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def write(limit: Limit, path: Path, command: str) -> None:
    """Write a file `limit.yaml`; its first line is the command that made it."""
    content = configuration.content(limit)
    path.write_text(f"# {command}\n{yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=110)}")


def find(folder: Path | None, track: Track, vehicle: Vehicle) -> Limit | None:
    """Return the limit of a track and a vehicle from a configuration folder or the shipped one; None without one.

    Args:
        folder: configuration folder; None: the shipped one alone.
        track, vehicle: of the flight.

    Raises:
        UsageError: a file is wrong.
    """
    wanted = key_of(track, vehicle)
    folders = [configuration.shipped_folder()] if folder is None else [folder, configuration.shipped_folder()]
    for path in dict.fromkeys(file for one in folders for file in sorted((one / FOLDER).glob("*.yaml"))):
        limit = configuration.load(Limit, path)
        if limit.key == wanted:
            return limit
    return None


def sentence(limit: Limit, races: Sequence[RaceResult]) -> str:
    """Return the flown laps and races as multiples of the limit as flown; "" when no lap was flown."""
    laps_s = [lap for race in races for lap in race.laps_s]
    races_s = [race.time_s for race in races if race.time_s is not None]
    times, parts = limit.as_flown, []
    for name, flown, least in (("lap", laps_s, times.whole_lap_s), ("race", races_s, times.whole_race_s)):
        if flown:
            best, median = min(flown) / least, float(np.median(flown)) / least
            both = f"best {best:.3f}, median {median:.3f}" if len(flown) > 1 else f"{best:.3f}"
            parts.append(f"{name} {both} times {least:.2f} s")
    return f"against the limit as flown: {'; '.join(parts)}" if parts else ""

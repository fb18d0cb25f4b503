"""The file of a limit: written, read, found by track and vehicle, and compared with races."""

import dataclasses
import shutil

import numpy as np
import pytest

from swift_ros import cli, configuration
from swift_ros.errors import UsageError
from swift_ros.race import limit
from swift_ros.race.limit import Limit, Times
from swift_ros.race.result import RaceResult
from swift_ros.track import Track
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.commands import race
from swift_sim_bridge.limit import tables
from swift_sim_bridge.pilot import train

LAP = (0.9, 0.8, 0.8, 0.4, 0.7, 0.9, 0.8)  # 5.3 s
FLOWN = RaceResult(3, True, "finished", 18.2, [5.9, 6.0, 5.8], 22, None, 0.2, 0.4, 0.12, 0.9, [4.1, 3.9], "aa", "bb")


@pytest.fixture
def track(repository) -> Track:
    return configuration.load(Track, repository / "config/track.yaml")


@pytest.fixture
def vehicle(repository) -> Vehicle:
    return configuration.load(Vehicle, repository / "config/drone.yaml")


@pytest.fixture
def known(track, vehicle) -> Limit:
    """Return a made-up limit of 5.3 s a lap with full thrust, and of 1.1 times that as flown."""
    times = Times(LAP, (0.8, *LAP, *LAP, *LAP))
    slower = Times(*(tuple(1.1 * s for s in part) for part in (times.lap_s, times.race_s)))
    return Limit(track.name, vehicle.name, *limit.key_of(track, vehicle), 0.0, times, slower)


def test_what_is_written_is_found_again_for_this_track_and_vehicle_alone(known, track, vehicle, tmp_path):
    (tmp_path / limit.FOLDER).mkdir()
    limit.write(known, tmp_path / limit.FOLDER / "mine.yaml", "swiftros limit --track mine.yaml")
    assert limit.find(tmp_path, track, vehicle) == known
    renamed = dataclasses.replace(vehicle, name="the same under another name", sensors={"gyro_rad_s": 0.5})
    assert limit.find(tmp_path, track, renamed) == known
    heavier = dataclasses.replace(vehicle, mass=0.9)
    assert limit.find(tmp_path, track, heavier) is None


def test_a_damaged_file_is_named(track, vehicle, tmp_path):
    (tmp_path / limit.FOLDER).mkdir()
    path = tmp_path / limit.FOLDER / "mine.yaml"
    path.write_text("track: mine\nlap: 5.2\n")
    with pytest.raises(UsageError, match=r"mine\.yaml has the unknown key 'lap'"):
        limit.find(tmp_path, track, vehicle)


def test_races_are_multiples_of_the_limit(known):
    sentence = limit.sentence(known, [FLOWN])
    assert sentence == "against the limit as flown: lap best 0.995, median 1.012 times 5.83 s; race 0.991 times 18.37 s"
    assert limit.sentence(known, [dataclasses.replace(FLOWN, laps_s=[], time_s=None)]) == ""


def test_commands_print_the_ratio_where_the_limit_is_known(known, repository, tmp_path, capsys):
    """In a folder with a limit of its track and vehicle, `race` prints a line; trials name the multiple."""
    for name in ("track.yaml", "drone.yaml"):
        shutil.copy(repository / "config" / name, tmp_path)
    (tmp_path / limit.FOLDER).mkdir()
    limit.write(known, tmp_path / limit.FOLDER / "mine.yaml", "swiftros limit")
    race.print_limit(tmp_path, [FLOWN])
    assert capsys.readouterr().out == limit.sentence(known, [FLOWN]) + "\n"
    trial = {"finish_rate": 1.0, "median_lap_s": 6.413, "passages": 22.0, "mean_margin_m": 0.4}
    assert "lap  6.41 s (1.100 times the limit)" in train.describe(trial, known.as_flown.whole_lap_s)
    assert "limit" not in train.describe(trial, None)


def test_the_shipped_limits_hold_for_the_shipped_files(repository):
    """Each shipped track has a limit for the shipped vehicle, and the other racer has one on the shipped track."""
    config = repository / "config"
    track, vehicle = (
        configuration.load(Track, config / "track.yaml"),
        configuration.load(Vehicle, config / "drone.yaml"),
    )
    tracks = [configuration.load(Track, path) for path in sorted((config / "tracks").glob("*.yaml"))]
    racer = configuration.load(Vehicle, config / "vehicles/six_to_one.yaml")
    for one, other in [(track, vehicle), (track, racer), *((each, vehicle) for each in tracks)]:
        found = limit.find(config, one, other)
        assert found, f"solve the limit of {other.name} on {one.name} again, and copy it to config/limits"
        assert len(found.as_flown.lap_s) == len(one.gates) and len(found.as_flown.race_s) == one.passages
        assert found.full_thrust.whole_lap_s < found.as_flown.whole_lap_s


def test_laps_are_compared_by_segment(known):
    """The pilot loses 0.2 s at 4-5 in each lap of two races, the second of which ends after two laps."""
    lap = 1.1 * np.array(LAP)
    lap[3] += 0.2
    races = [np.r_[1.0, lap, lap, lap], np.r_[1.2, lap, lap, lap[:2]]]
    rows = {row.split("  ")[0]: row.split() for row in tables.flown_table(known, races).splitlines()}
    assert rows["4-5"][1:] == ["0.440", "0.640", "0.640", "0.200", "1.455"]
    assert rows["5-6"][-2:] == ["0.000", "1.000"]
    assert rows["lap"][1:] == ["5.830", "6.030", "6.030", "0.200", "1.034"]
    assert rows["start"][1:4] == ["0.880", "1.000", "1.100"]
    assert rows["race to gate 1"][-5:] == ["18.37", "19.09", "19.09", "0.72", "1.039"]
    assert rows["best: the fastest lap or race; 5 laps of 2 races"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"gates": [{"position": [0.0, 0.0, 1.5], "yaw_deg": 0.0}]}, "has one gate, to which no lap leads back"),
        ({"inner_side": 0.37}, r"the opening of gate 1 is 0.37 m wide, and the hull of .* takes 0.37 m"),
    ],
)
def test_impossible_tracks_get_one_sentence(change, message, repository, tmp_path):
    content = configuration.read_yaml(repository / "config/track.yaml")
    path = tmp_path / "track.yaml"
    path.write_text(str(content | change))
    with pytest.raises(UsageError, match=message):
        cli.run(["limit", "--track", str(path), "--out", str(tmp_path / "out")])
    assert not (tmp_path / "out").exists()


def test_races_without_a_known_limit_get_one_sentence(tmp_path):
    with pytest.raises(UsageError, match="holds no recorded race"):
        cli.run(["limit", "--race", str(tmp_path)])

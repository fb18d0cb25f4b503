"""Races with rendered images whose camera is not the one of camera.yaml: the error is named, from pixels alone.

The vehicle file plants errors in the camera that flies. An error without such a term is planted in the camera.yaml with
which a recorded race is replayed.
"""

import contextlib
import io
import re
import shutil

import pytest

from swift_ros import cli, configuration
from swift_ros.track import Track

SAID = r"the corners of the gates fit|no gate of the map is where|gates of the map, and in \d+ images"


def change(path, pattern: str, text: str) -> None:
    """Replace the only match of a pattern in a file."""
    content, count = re.subn(pattern, text, path.read_text(), flags=re.MULTILINE)
    assert count == 1, (path, pattern)
    path.write_text(content)


def warned(*words) -> list[str]:
    """Run a command; return the lines that it prints on the calibration."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        cli.main([str(word) for word in words])
    return [line for line in printed.getvalue().splitlines() if re.search(SAID, line)]


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """Return a copy of the configuration with a track of one lap."""
    folder = tmp_path_factory.mktemp("short") / "config"
    shutil.copytree(configuration.configuration_folder(), folder)
    change(folder / "track.yaml", r"^laps: 3", "laps: 1")
    assert configuration.load(Track, folder / "track.yaml").laps == 1
    return folder


@pytest.fixture(scope="module")
def recorded(short, tmp_path_factory):
    """Return the folder of a race whose calibration is right, of which nothing is said."""
    out = tmp_path_factory.mktemp("race")
    assert warned("race", "--seed", 1, "--config", short, "--out", out) == []
    return out


@pytest.mark.parametrize(
    ("term", "said"),
    [
        ("rolling_shutter: {readout: 0.02}", r"reads the rows in (1[4-9]|2\d) ms, top row first"),
        ("camera_focal: {scale: 0.07}", r"focal length [5-8]\.\d % longer"),
        ("camera_extrinsic: {rotation: [0.0524, 0.0, 0.0]}", r"optical axis [23]\.\d degrees higher"),
    ],
)
def test_an_error_of_the_flying_camera_is_named(short, tmp_path, term, said):
    folder = tmp_path / "config"
    shutil.copytree(short, folder)
    change(folder / "drone.yaml", r"^(terms:.*)$", rf"\1\n  {term}")
    found = warned("race", "--seed", 1, "--config", folder, "--out", tmp_path / "race")
    assert found and re.search(said, found[0]), found


@pytest.mark.parametrize(
    ("file", "old", "new", "said"),
    [
        (
            "camera.yaml",
            r"^distortion: .*$",
            "distortion: [0.05, 0.037, -0.036, 0.006]",
            r"57 degrees [2-4]\.\d degrees further in",
        ),
        ("camera.yaml", r"^pitch_deg: 20\.0", "pitch_deg: -20.0", r"with pitch_deg 20 in camera\.yaml gates are there"),
        (
            "camera.yaml",
            r"^pitch_deg: 20\.0",
            "roll_deg: 180.0\npitch_deg: 20.0",
            r"with roll_deg 0 in camera\.yaml gates",
        ),
        ("track.yaml", r"^start_yaw_deg: -57\.4", "start_yaw_deg: 32.6", r"see 2 gates .* 0 of them and 2 elsewhere"),
    ],
)
def test_an_error_of_a_file_is_named_in_a_replay(short, recorded, tmp_path, file, old, new, said):
    folder = tmp_path / "config"
    shutil.copytree(short, folder)
    change(folder / file, old, new)
    found = warned("replay", recorded, "--config", folder, "--out", tmp_path / "replay")
    assert found and re.search(said, found[0]), found


def test_a_covered_lens_is_reported(short, tmp_path):
    folder = tmp_path / "config"
    shutil.copytree(short, folder)
    change(folder / "simulation.yaml", r"^  gain: .*$", "  gain: [0.01, 0.01]")
    found = warned("race", "--seed", 1, "--config", folder, "--out", tmp_path / "race")
    assert found and re.search("should see 2 gates of the map, .* 0 of them and 0 elsewhere", found[0]), found

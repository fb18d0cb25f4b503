"""After the finish a vehicle lands with nothing in its way, on each track and with each vehicle that has a pilot."""

import json

import pytest

from swift_ros.cli import main
from swift_ros.race.result import REPORT

SEED = 1000
COURSES = {
    "split_s": [],
    "figure_eight": ["--track", "config/tracks/figure_eight.yaml", "--pilot", "config/pilots/figure_eight.onnx"],
    "dive": ["--track", "config/tracks/dive.yaml", "--pilot", "config/pilots/dive.onnx"],
    "six_to_one": ["--vehicle", "config/vehicles/six_to_one.yaml", "--pilot", "config/pilots/six_to_one.onnx"],
}


@pytest.mark.parametrize("course", COURSES)
def test_after_the_finish_the_vehicle_lands_without_a_touch(course, repository, monkeypatch, tmp_path):
    monkeypatch.chdir(repository)
    assert main(["race", "--land", "--seed", str(SEED), *COURSES[course], "--out", str(tmp_path)]) == 0
    report = json.loads((tmp_path / f"seed-{SEED}" / REPORT).read_text())
    assert report["contact"] is None, report
    assert report["disarmed_s"] is not None and report["speed_m_s"] < 0.3

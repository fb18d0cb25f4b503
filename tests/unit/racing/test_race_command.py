"""`swiftros race` without the flight: seeds, folders, configuration, the table."""

import dataclasses
import json
from types import SimpleNamespace

import pytest

from swift_ros import cli, configuration
from swift_ros.camera.model import Camera
from swift_ros.errors import UsageError
from swift_ros.graph.domain import RunDomain
from swift_ros.race.result import RaceResult
from swift_ros.track import Track
from swift_ros.trained_for.folder import warnings
from swift_sim_bridge.commands import race
from swift_sim_bridge.racing import tables
from swift_sim_bridge.racing.race import node_parameters
from swift_sim_bridge.tcp_ports import free_port

FLOWN = RaceResult(3, True, "finished", 18.2, [5.9, 6.0, 5.8], 22, None, 0.2, 0.4, 0.12, 0.9, [4.1, 3.9], "aa", "bb")


def seeds(seed=None, seeds=None, first_seed=0):
    return race.chosen_seeds(SimpleNamespace(seed=seed, seeds=seeds, first_seed=first_seed))


def test_the_default_is_one_race_with_seed_0():
    assert (seeds(), seeds(seed=7), seeds(seeds=3)) == ([0], [7], [0, 1, 2])
    assert seeds(seeds=2, first_seed=1000) == [1000, 1001]
    for wrong in (
        {"seed": 1, "seeds": 2},
        {"seed": -1},
        {"seeds": 0},
        {"seed": 2**31},
        {"seeds": 2, "first_seed": 2**31 - 1},
    ):
        with pytest.raises(UsageError):
            seeds(**wrong)


def test_bad_input_removes_no_earlier_results(tmp_path, capsys):
    out = tmp_path / "out"
    (out / "seed-3").mkdir(parents=True)
    for wrong in (["--seeds", "0"], ["--track", str(tmp_path / "none.yaml")], ["--config", str(tmp_path / "none")]):
        assert cli.main(["race", *wrong, "--out", str(out)]) == 2
    (out / "thesis.tex").write_text("three years")
    assert cli.main(["race", "--out", str(out)]) == 2
    assert "thesis.tex" in capsys.readouterr().err
    assert (out / "seed-3").exists() and (out / "thesis.tex").exists()


def test_a_ros_domain_in_use_is_refused_before_earlier_results_are_removed(tmp_path, capsys):
    domain = RunDomain()
    for command, folder in (("race", "seed-3"), ("sim", "logs")):
        (tmp_path / command / folder).mkdir(parents=True)
        port = ["--msp-port", str(free_port())] * (command == "sim")
        assert cli.main([command, *port, "--out", str(tmp_path / command)]) == 2
        assert f"another run of swiftros uses ROS domain {domain.number}" in capsys.readouterr().err
        assert (tmp_path / command / folder).exists()
    domain.close()


def test_another_track_is_used_through_a_folder_of_links(tmp_path, repository):
    assert race.configure(tmp_path, race.chosen_files(None)) == repository / "config"
    other = tmp_path / "oval.yaml"
    text = (repository / "config" / "track.yaml").read_text()
    other.write_text(text.replace("name: Split-S", "name: Oval"))
    folder = race.configure(tmp_path, race.chosen_files(None, track=other))
    assert configuration.load(Track, folder / "track.yaml").name == "Oval"
    assert (folder / "nodes.yaml").read_text() == (repository / "config" / "nodes.yaml").read_text()
    assert (folder / "models").is_dir()


@pytest.mark.parametrize(
    ("content", "sentence"),
    [("gates: []", "lacks the key"), ("name: [", "not valid YAML at line"), (None, "cannot be read")],
)
def test_a_bad_track_is_refused_in_one_sentence_with_exit_code_2(tmp_path, capsys, content, sentence):
    track = tmp_path / "track.yaml"
    if content is not None:
        track.write_text(content)
    assert cli.main(["race", "--track", str(track), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert sentence in error and str(track) in error and len(error.strip().splitlines()) == 1


def test_the_table_has_a_row_for_each_race_with_the_reason_of_its_end():
    missing = dict.fromkeys(("time_s", "thrust_to_weight", "min_gate_margin_m", "state_rmse_m", "vio_rmse_m"))
    crash = {"seed": 4, "finished": False, "end": "crashed", "crash": "touched gate 3", "laps_s": []}
    crashed = dataclasses.replace(FLOWN, **crash, **missing)
    head, first, second = tables.races([FLOWN, crashed]).splitlines()
    assert head.split()[:2] == ["seed", "end"]
    assert " ".join(first.split()) == "3 finished 22 18.20 5.90 6.00 5.80 0.20 0.120 0.90 4.10 to 3.90"
    assert "crashed: touched gate 3" in second
    totals = "1 of 2 finished; laps: median 5.90 s, best 5.80 s; RMSE: state 0.120 m, VIO 0.90 m"
    assert tables.totals([FLOWN, crashed]) == totals
    assert json.dumps(dataclasses.asdict(crashed))


def test_a_configuration_folder_that_lacks_files_is_refused_by_their_names(tmp_path, repository, capsys):
    (tmp_path / "empty").mkdir()
    (tmp_path / "part").mkdir()
    for name in ("drone.yaml", "track.yaml"):
        (tmp_path / "part" / name).write_text((repository / "config" / name).read_text())
    for name, missing in (("empty", "camera.yaml, drone.yaml"), ("part", "camera.yaml, models, nodes.yaml")):
        for command in ("race", "sim"):
            assert cli.main([command, "--config", str(tmp_path / name), "--out", str(tmp_path / "out")]) == 2
            assert f"has no {missing}" in capsys.readouterr().err


def test_races_side_by_side_are_separate_vehicles_for_a_ground_station(tmp_path):
    domains = (0, 20, 101)
    parameters = [node_parameters(0, tmp_path, tmp_path, domain)["mavlink_telemetry"] for domain in domains]
    assert parameters == [{}, {"system_id": 20}, {"system_id": 101}]


def test_another_pilot_and_camera_are_used_through_a_folder_of_links(tmp_path, repository):
    given = {"pilot": repository / "config/pilots/dive.onnx", "camera": repository / "config/cameras/pinhole_100.yaml"}
    folder = race.configure(tmp_path, race.chosen_files(None, **given))
    for name in ("pilot.onnx", "pilot.json"):
        assert (folder / "models" / name).read_bytes() == given["pilot"].with_name("dive" + name[5:]).read_bytes()
    assert (folder / "models" / "gate_detector.onnx").is_file()
    assert configuration.load(Camera, folder / "camera.yaml").pitch_deg == 40.0
    assert any("another track" in sentence for sentence in warnings(folder))


def test_the_provenance_of_the_former_pilot_does_not_stand_beside_another_one(tmp_path, repository):
    (tmp_path / "mine.onnx").write_bytes((repository / "config/pilots/dive.onnx").read_bytes())
    folder = race.configure(tmp_path / "out", race.chosen_files(None, pilot=tmp_path / "mine.onnx"))
    assert not (folder / "models" / "pilot.json").exists()


@pytest.mark.parametrize("name", ["none.onnx", "track.yaml"])
def test_a_pilot_that_is_no_network_is_refused_in_one_sentence(tmp_path, repository, capsys, name):
    assert cli.main(["race", "--pilot", str(repository / "config" / name), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert "is no file .onnx; name the pilot.onnx of a training" in error and len(error.strip().splitlines()) == 1

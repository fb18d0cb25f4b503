"""Flights label themselves where their poses are right, and not where they have drifted; proposals find the gates."""

import json
from dataclasses import replace

import numpy as np
import pytest
from labelled_flight import FRAMES, SOUND_FRAMES, record

from swift_ros import cli
from swift_ros.errors import UsageError
from swift_sim_bridge.gate_detector.evaluation.setup import load_setup
from swift_sim_bridge.labelling import frames, proposals, self_labels
from swift_sim_bridge.labels import folder
from swift_sim_bridge.labels.labelled_images import FLIGHT, PERSON, VISIBLE, LabelledGate


@pytest.fixture(scope="module")
def setup(repository):
    return load_setup(repository / "config")


@pytest.fixture(scope="module")
def flight(setup, repository, tmp_path_factory):
    return record(tmp_path_factory.mktemp("flight") / "bag", setup, repository / "config")


@pytest.fixture
def frames_of(flight, tmp_path):
    """Return a function of the topic of poses that returns the frames of the flight."""
    return lambda poses: frames.of_bag(flight.bag, tmp_path / "frames", frames.BagFrames(every=1, poses=poses))


def nearest(gates, corners) -> float:
    """Return the largest distance (px) of true corners from those of the gate that is nearest to them."""
    whole = [gate.corners_px for gate in gates if gate.is_whole]
    return min((np.linalg.norm(found - corners, axis=-1).max() for found in whole), default=np.inf)


def test_a_flight_with_true_poses_labels_itself(flight, setup, frames_of):
    found = frames_of(None)
    result = self_labels.label_flight(proposals.Proposer(found, setup))
    numbers = [round(10 * image.stamp_s) - 1 for image in result.images]
    assert len(numbers) >= FRAMES - 1  # in one, the frame of a gate cuts a small one behind it, which is not confirmed
    assert sum(result.left_out.values()) == result.left_out[self_labels.DRIFT] == FRAMES - len(numbers)
    for number, image in zip(numbers, result.images, strict=True):
        assert nearest(image.gates, flight.corners_px[number]) < 0.01
        assert image.source == FLIGHT and image.sequence
    folder.write(found.path, result.images)
    read = folder.read(found.path)
    assert read.camera(read.images[0]) == setup.camera
    assert [image.stamp_s for image in read.images] == pytest.approx([image.stamp_s for image in result.images])


def test_frames_whose_pose_has_drifted_are_left_out_and_counted(flight, setup, frames_of):
    result = self_labels.label_flight(proposals.Proposer(frames_of("state/odometry"), setup))
    stamps = [image.stamp_s for image in result.images]
    assert len(stamps) >= SOUND_FRAMES - 1 and max(stamps) <= 0.1 * SOUND_FRAMES + 1e-6
    assert result.left_out[self_labels.DRIFT] == FRAMES - len(stamps)
    assert f"{FRAMES - len(stamps)} frames left out" in result.sentences()[1]


def test_edges_alone_notice_drift_of_a_gate_that_the_detector_does_not_know(setup, frames_of, monkeypatch):
    nothing = [(np.zeros((0, 2)), np.zeros(0))] * 4
    monkeypatch.setattr("swift_ros.perception.gate_detector.GateDetector.corners", lambda *_: nothing)
    result = self_labels.label_flight(proposals.Proposer(frames_of("state/odometry"), setup))
    stamps = [image.stamp_s for image in result.images]
    assert result.by_corners == 0 and result.by_edges > 0
    assert stamps and max(stamps) <= 0.1 * SOUND_FRAMES + 1e-6


def test_true_poses_propose_the_gates_of_the_map_and_estimated_ones_those_of_the_detector(flight, setup, frames_of):
    for poses, origin in (("ground_truth/odometry", proposals.MAP), ("state/odometry", proposals.DETECTOR)):
        found = frames_of(poses)
        proposed = proposals.Proposer(found, setup).propose(found.images[2], None)
        assert proposed[0].origin == origin
        assert nearest([one.gate for one in proposed], flight.corners_px[2]) < 2.0


def test_corrected_corners_are_tracked_to_the_next_frame(flight, setup, frames_of, monkeypatch):
    found = frames_of(frames.WITHOUT_MAP)
    assert found.flight is None
    proposer = proposals.Proposer(found, setup)
    monkeypatch.setattr(proposer, "detected", lambda image: [])
    before = found.images[2]
    gate = LabelledGate(flight.corners_px[2], np.full(4, VISIBLE))
    labelled = replace(before, gates=(gate,), source=PERSON)
    (tracked,) = proposer.propose(found.images[5], labelled)
    assert tracked.origin == proposals.TRACKED
    moved = np.linalg.norm(flight.corners_px[5] - flight.corners_px[2], axis=-1).min()
    off = np.linalg.norm(tracked.gate.corners_px - flight.corners_px[5], axis=-1).max()
    assert off < 2.0 < moved


def test_a_corner_that_leaves_the_image_is_not_tracked(flight, setup, frames_of):
    found = frames_of(frames.WITHOUT_MAP)
    proposer = proposals.Proposer(found, setup)
    nowhere = LabelledGate(np.array([[3.0, 3.0], [40.0, 3.0], [40.0, 40.0], [3.0, 40.0]]), np.full(4, VISIBLE))
    before = replace(found.images[0], gates=(nowhere,))
    origins = {one.origin for one in proposer.propose(found.images[7], before)}
    assert proposals.TRACKED not in origins  # outside of the image circle there is nothing to track


def test_the_command_labels_a_bag_and_keeps_what_a_person_has_labelled(flight, tmp_path, capsys):
    out = tmp_path / "labels"
    call = ["label", str(flight.bag), "--out", str(out), "--every", "2", "--self-label"]
    assert cli.main(call) == 0
    content = json.loads((out / folder.LABELS).read_text())
    assert len(content["images"]) == FRAMES // 2
    content["images"][0]["source"] = PERSON
    content["annotations"] = [row for row in content["annotations"] if row["image_id"] != 1]
    (out / folder.LABELS).write_text(json.dumps(content))
    assert cli.main(call) == 0
    first = folder.read(out).images[0]
    assert first.source == PERSON and first.gates == ()
    assert "1 images keep the labels" in capsys.readouterr().out


def test_a_folder_of_extracted_frames_keeps_their_attitudes(frames_of):
    found = frames_of(None)
    again = frames.of_folder(found.path, None)
    assert [image.file_name for image in again.images] == [image.file_name for image in found.images]
    for one, other in zip(again.images, found.images, strict=True):
        assert np.allclose(one.q_world_camera, other.q_world_camera)


@pytest.mark.parametrize(
    ("wanted", "sentence"),
    [
        (frames.BagFrames(every=0), "--every 0"),
        (frames.BagFrames(poses="vio/odometry"), "no topic of poses in the map"),
        (frames.BagFrames(poses="gates"), "no topic of poses in the map"),
    ],
)
def test_wrong_choices_of_frames_meet_a_sentence(flight, tmp_path, wanted, sentence):
    with pytest.raises(UsageError, match=sentence):
        frames.of_bag(flight.bag, tmp_path, wanted)


def test_a_camera_of_another_size_than_the_images_is_refused(flight, tmp_path, repository):
    config = tmp_path / "config"
    config.mkdir()
    text = (repository / "config/camera.yaml").read_text().replace("width: 384", "width: 400")
    (config / "camera.yaml").write_text(text)
    with pytest.raises(UsageError, match="384 x 384 px.*400 x 384 px.*--config"):
        frames.of_bag(flight.bag, tmp_path / "out", frames.BagFrames(config=config))


def test_paths_without_images_meet_a_sentence(tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    for call, sentence in (
        (["label", str(tmp_path / "gone")], "does not exist"),
        (["label", str(tmp_path / "empty"), "--fov-deg", "90"], "holds no image"),
        (["label", str(tmp_path / "empty")], "camera.yaml"),
        (["label", str(tmp_path / "empty"), "--self-label"], "needs the poses"),
        (["label", str(tmp_path / "empty"), "--export", "a.xml"], "holds no labels.json"),
        (["label", str(tmp_path / "empty"), "--export", "a.txt"], "neither COCO"),
        (["evaluate", "detector", "--images", str(tmp_path / "empty")], "holds no labels.json"),
    ):
        assert cli.main(call) == 2
        assert sentence in capsys.readouterr().err

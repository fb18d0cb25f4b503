"""Folders of labelled images: what is written comes back, what is broken is refused by a sentence, nothing is torn."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from swift_ros import configuration, geometry
from swift_ros.camera.model import Camera, project
from swift_ros.errors import UsageError
from swift_sim_bridge.labels import folder
from swift_sim_bridge.labels.labelled_images import (
    NOT_LABELLED,
    OCCLUDED,
    VISIBLE,
    LabelledGate,
    LabelledImage,
    q_world_body,
    r_world_camera,
)

SQUARE = np.array([[100.0, 50.0], [180.0, 52.0], [182.0, 131.5], [99.25, 130.0]])


def gate(corners=SQUARE, visibility=(VISIBLE,) * 4) -> LabelledGate:
    return LabelledGate(np.array(corners, dtype=float), np.array(visibility))


def labelled(name="a.png", gates=(), **values) -> LabelledImage:
    return LabelledImage(name, 320, 240, tuple(gates), **values)


@pytest.fixture
def images(tmp_path):
    """Return a folder with two images, labelled and written."""
    turned = geometry.quaternion_from_rotation_vector(np.array([0.1, 0.2, 0.3]))
    cut = gate(np.where([[True], [False], [True], [True]], SQUARE, np.nan), (VISIBLE, NOT_LABELLED, OCCLUDED, VISIBLE))
    written = [
        labelled("a.png", [gate(), cut], q_world_camera=turned, stamp_s=12.25, sequence="hall", source="person"),
        labelled("below/b.png", all_gates=False),
    ]
    (tmp_path / "below").mkdir()
    for image in written:
        cv2.imwrite(str(tmp_path / image.file_name), np.full((240, 320), 7, np.uint8))
    folder.write(tmp_path, written, folder.pinhole(320, 240, 80.0))
    return tmp_path


def change(path, edit) -> None:
    """Change the content of labels.json."""
    file = path / folder.LABELS
    content = json.loads(file.read_text())
    edit(content)
    file.write_text(json.dumps(content))


def test_labels_come_back_as_they_were_written(images):
    found = folder.read(images)
    first, second = found.images
    assert first.file_name == "a.png"
    assert (first.stamp_s, first.sequence, first.source, first.all_gates) == (12.25, "hall", "person", True)
    assert np.allclose(geometry.rotation_matrix(first.q_world_camera), r_world_camera(first))
    assert np.allclose(first.gates[0].corners_px, SQUARE)
    assert first.gates[0].is_whole and not first.gates[1].is_whole
    assert first.gates[1].visibility.tolist() == [2, 0, 1, 2]
    assert np.isnan(first.gates[1].corners_px[1]).all()
    assert second.gates == () and not second.all_gates and second.q_world_camera is None
    assert found.pixels(second).shape == (240, 320)
    assert found.camera(first) == folder.pinhole(320, 240, 80.0)


def test_the_file_is_coco_keypoints_as_others_read_it(images):
    content = json.loads((images / folder.LABELS).read_text())
    row = content["annotations"][0]
    assert content["categories"][0]["keypoints"] == ["top_left", "top_right", "bottom_right", "bottom_left"]
    assert len(row["keypoints"]) == 12 and row["num_keypoints"] == 4
    assert row["bbox"] == [99.25, 50.0, 82.75, 81.5]
    assert content["annotations"][1]["keypoints"][3:6] == [0, 0, 0]


def test_a_camera_whose_attitude_is_not_known_is_level():
    camera = folder.pinhole(320, 240, 80.0)
    rotation = r_world_camera(labelled())
    ahead_and_above = np.array([[10.0, 0.0, 1.0]]) @ rotation  # world x ahead, z up
    assert np.allclose(project(camera, ahead_and_above)[0][0, 0], camera.cx)
    assert project(camera, ahead_and_above)[0][0, 1] < camera.cy


def test_the_attitude_of_the_body_is_that_of_the_camera_without_its_mount(repository):
    camera = configuration.load(Camera, repository / "config/camera.yaml")
    body = geometry.quaternion_from_rotation_vector(np.array([0.4, -0.3, 1.0]))
    image = labelled(q_world_camera=geometry.quaternion_multiply(body, camera.q_body_camera))
    assert np.allclose(
        geometry.rotation_matrix(q_world_body(r_world_camera(image), camera)), geometry.rotation_matrix(body)
    )


def test_without_a_camera_file_a_field_of_view_is_assumed_or_the_error_says_what_to_do(images):
    (images / folder.CAMERA).unlink()
    with pytest.raises(UsageError, match="swiftros calibration.*--fov-deg"):
        folder.read(images)
    found = folder.read(images, fov_deg=90.0)
    assert found.camera(found.images[0]).fx == pytest.approx(160.0)
    with pytest.raises(UsageError, match="5 to 150"):
        folder.read(images, fov_deg=200.0)


def test_images_of_another_size_than_the_cameras_are_refused(images):
    folder.write(images, list(folder.read(images).images), folder.pinhole(640, 480, 80.0))
    with pytest.raises(UsageError, match=r"640 x 480 px, a\.png has 320 x 240 px"):
        folder.read(images)


def test_an_image_file_of_another_size_or_without_content_is_refused(images):
    found = folder.read(images)
    cv2.imwrite(str(images / "a.png"), np.zeros((100, 100), np.uint8))
    with pytest.raises(UsageError, match="100 x 100 px, labels.json says 320 x 240"):
        found.pixels(found.images[0])
    (images / "a.png").write_bytes(b"no image")
    with pytest.raises(UsageError, match=r"a\.png is not a readable image"):
        found.pixels(found.images[0])


@pytest.mark.parametrize(
    ("corners", "visibility", "sentence"),
    [
        (SQUARE[[0, 2, 1, 3]], (2, 2, 2, 2), "cross"),
        (SQUARE[::-1], (2, 2, 2, 2), "anticlockwise"),
        (SQUARE[::-1], (2, 2, 1, 0), "anticlockwise"),
        (SQUARE + [200.0, 0.0], (2, 2, 2, 2), r"visible corner top_right outside .* \(380, 52\) of 320 x 240"),
        (SQUARE + [900.0, 0.0], (1, 1, 1, 1), "corner top_left outside"),
        (np.zeros((4, 2)) + 9.0, (2, 2, 2, 2), "in a point"),
        (SQUARE, (0, 0, 0, 0), "no labelled corner"),
        (np.full((4, 2), np.nan), (2, 2, 2, 2), "not a number"),
    ],
)
def test_an_impossible_gate_is_neither_written_nor_read(images, corners, visibility, sentence):
    before = (images / folder.LABELS).read_text()
    with pytest.raises(UsageError, match=f"labels.json, image c.png: gate 1 has .*{sentence}"):
        folder.write(images, [labelled("c.png", [gate(corners, visibility)])])
    assert (images / folder.LABELS).read_text() == before
    points = np.column_stack([corners, visibility]).ravel().tolist()
    change(images, lambda content: content["annotations"][0].update(keypoints=points))
    with pytest.raises(UsageError, match=r"labels\.json, image a\.png.*gate"):
        folder.read(images)


def test_an_occluded_corner_may_lie_outside_of_the_image(images):
    beyond = gate(SQUARE - [120.0, 0.0], (OCCLUDED, VISIBLE, VISIBLE, OCCLUDED))
    folder.write(images, [labelled("a.png", [beyond])])
    assert folder.read(images).images[0].gates[0].corners_px[0, 0] == -20.0


@pytest.mark.parametrize(
    ("edit", "sentence"),
    [
        (lambda content: content.pop("images"), "no list 'images'"),
        (lambda content: content["images"].clear(), "which the file does not list"),
        (lambda content: content["images"][0].update(file_name="gone.png"), "gone.png, which is missing"),
        (lambda content: content["images"][0].update(file_name="../a.png"), "outside of the folder"),
        (lambda content: content["images"][0].update(file_name=None), "no file_name"),
        (lambda content: content["images"][1].update(id=1), "no number of its own"),
        (lambda content: content["images"][0].update(width=0), r"size \(0, 240\)"),
        (lambda content: content["images"][0].update(q_world_camera=[0, 0, 0, 2]), "length 2 instead of 1"),
        (lambda content: content["images"][0].update(q_world_camera=[0, 0, 1]), "four numbers"),
        (lambda content: content["images"][0].update(stamp_s="now"), "'stamp_s' must be a number"),
        (lambda content: content["images"][0].update(all_gates="no"), "'all_gates' must be of type bool"),
        (lambda content: content["annotations"][0].update(keypoints=[1, 2]), "triples"),
        (lambda content: content["annotations"][0].update(keypoints=[1, 2, 2] * 3), "3 keypoints instead of 4"),
        (lambda content: content["annotations"][0]["keypoints"].__setitem__(0, float("nan")), "numbers"),
        (lambda content: content["annotations"][0]["keypoints"].__setitem__(0, 10**400), "numbers"),
        (lambda content: content["annotations"][0]["keypoints"].__setitem__(2, 7), "visibility other than"),
        (lambda content: content["categories"][0]["keypoints"].reverse(), "swiftros label FOLDER --import FILE"),
    ],
)
def test_a_wrong_file_meets_a_sentence_with_its_name(images, edit, sentence):
    change(images, edit)
    with pytest.raises(UsageError, match=f"labels.json.*{sentence}"):
        folder.read(images)


def test_a_torn_file_is_refused_at_every_length(images):
    whole = (images / folder.LABELS).read_bytes()
    for length in range(0, len(whole) - 2, 97):
        (images / folder.LABELS).write_bytes(whole[:length])
        with pytest.raises(UsageError, match="not valid JSON"):
            folder.read(images)


def test_a_write_that_fails_leaves_the_former_labels(images, monkeypatch):
    before = (images / folder.LABELS).read_text()

    def full(handle):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(UsageError, match="No space left"):
        folder.write(images, [replace(folder.read(images).images[0], gates=())])
    assert (images / folder.LABELS).read_text() == before

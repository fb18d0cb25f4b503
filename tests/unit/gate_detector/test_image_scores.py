"""Scores on labelled images: planted hits, misses and false detections are counted as what they are."""

import json
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from swift_ros.camera.model import project
from swift_ros.types import GateCorners
from swift_sim_bridge.gate_detector.evaluation import image_report, image_scores
from swift_sim_bridge.gate_detector.evaluation.image_scores import ImageEvaluation
from swift_sim_bridge.labels import folder
from swift_sim_bridge.labels.labelled_images import LabelledGate, LabelledImage

SQUARE = np.array([[100.0, 50.0], [180.0, 52.0], [182.0, 131.5], [99.25, 130.0]])  # sides of 80 px: 8 px are near
ELSEWHERE = SQUARE * 0.3 + [250.0, 10.0]


def gate(corners=SQUARE, visibility=(2, 2, 2, 2)) -> LabelledGate:
    visibility = np.array(visibility)
    return LabelledGate(np.where((visibility == 0)[:, None], np.nan, corners), visibility)


def score(monkeypatch, tmp_path, gates, corners, whole=(), **values):
    """Return the figures of one image.

    Args:
        monkeypatch, tmp_path: fixtures.
        gates: labelled.
        corners: detected by class, four lists of points.
        whole: detected gates (4, 2).
        values: of the LabelledImage; `inner_side` of the gates.
    """
    inner_side = values.pop("inner_side", None)
    detector = SimpleNamespace(
        corners=lambda *_: [(np.reshape(points, (-1, 2)), np.ones(len(points))) for points in corners],
        detect=lambda *_: [GateCorners(np.asarray(one), np.ones(4)) for one in whole],
        network=None,
        grouping=None,
    )
    monkeypatch.setattr(image_scores, "GateDetector", lambda *_: detector)
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((240, 320), np.uint8))
    folder.write(tmp_path, [LabelledImage("a.png", 320, 240, tuple(gates), **values)], folder.pinhole(320, 240, 80.0))
    images = folder.read(tmp_path)
    evaluation = ImageEvaluation(images, detector, 9.0, inner_side)
    evaluation.add(images.images[0])
    result = image_scores.figures(evaluation.tally)
    image_report.write_worst(images, evaluation.tally, tmp_path / "worst.png")
    assert cv2.imread(str(tmp_path / "worst.png")).shape == (400, 1600, 3)
    assert json.dumps(result) and image_report.table(result, images, 9.0)
    return result


def test_near_corners_are_correct_and_far_ones_are_wrong_and_missed(monkeypatch, tmp_path):
    found = [[SQUARE[0] + 3.0], [SQUARE[1] + [9.0, 0.0]], [SQUARE[2], SQUARE[2] + 1.0], []]
    corners = score(monkeypatch, tmp_path, [gate()], found)["corners"]
    assert (corners["labelled"], corners["detected"]) == (4, 4)
    assert corners["recall"] == 2 / 4 and corners["precision"] == 2 / 4  # one at 9 px is wrong, one is a repetition
    assert corners["error_px"]["of"] == 2 and corners["elsewhere"] == 0


def test_a_tenth_of_the_side_is_near_and_five_px_at_least(monkeypatch, tmp_path):
    shift = np.array([0.0, 7.0])
    large = score(monkeypatch, tmp_path, [gate()], [[point + shift] for point in SQUARE], [SQUARE + shift])
    small = score(monkeypatch, tmp_path, [gate(ELSEWHERE)], [[p + shift] for p in ELSEWHERE], [ELSEWHERE + shift])
    assert large["corners"]["recall"] == 1.0 and large["whole_gates"]["recall"] == 1.0
    assert small["corners"]["recall"] == 0.0 and small["whole_gates"]["precision"] == 0.0


@pytest.mark.parametrize("all_gates", [True, False])
def test_detections_far_from_labels_count_unless_the_image_may_show_other_gates(monkeypatch, tmp_path, all_gates):
    found = [[SQUARE[k], ELSEWHERE[k]] for k in range(4)]
    result = score(monkeypatch, tmp_path, [gate()], found, [SQUARE, ELSEWHERE], all_gates=all_gates)
    assert result["corners"]["recall"] == 1.0
    assert result["corners"]["precision"] == (0.5 if all_gates else 1.0)
    assert result["corners"]["elsewhere"] == (0 if all_gates else 4)
    assert result["whole_gates"]["precision"] == (0.5 if all_gates else 1.0)
    assert result["whole_gates"]["elsewhere"] == (0 if all_gates else 1)


def test_occluded_corners_and_small_gates_count_neither_as_found_nor_as_missed(monkeypatch, tmp_path):
    small = SQUARE * 0.08 + [20.0, 200.0]
    found = [[SQUARE[k], small[k]] for k in range(4)]
    result = score(monkeypatch, tmp_path, [gate(visibility=(2, 2, 1, 0)), gate(small)], found, [SQUARE, small])
    corners = result["corners"]
    assert (corners["labelled"], corners["recall"]) == (2, 1.0)
    assert corners["detected"] == 3  # the corner that is not labelled is a wrong detection, the occluded one is ignored
    assert (result["gates"], result["gates_too_small"]) == (1, 1)
    assert result["whole_gates"]["labelled"] == 0 and result["whole_gates"]["detected"] == 0


def test_an_image_without_gates_has_false_detections_only(monkeypatch, tmp_path):
    result = score(monkeypatch, tmp_path, [], [[point] for point in SQUARE], [SQUARE])
    assert result["images_without_gate"] == 1
    assert result["corners"]["precision"] == 0.0 and result["corners"]["recall"] is None
    assert result["whole_gates"]["precision"] == 0.0


def test_the_pose_error_is_that_of_a_planted_displacement(monkeypatch, tmp_path):
    camera = folder.pinhole(320, 240, 80.0)
    square = np.array([[-0.75, -0.75, 0.0], [0.75, -0.75, 0.0], [0.75, 0.75, 0.0], [-0.75, 0.75, 0.0]])
    turn = cv2.Rodrigues(np.array([0.1, 0.4, 0.05]))[0]
    true, moved = (project(camera, square @ turn.T + [0.1, 0.2, z])[0] for z in (4.0, 4.2))
    result = score(monkeypatch, tmp_path, [gate(true)], [[p] for p in moved], [moved], inner_side=1.5)
    assert result["pose"]["position_error_m"]["median"] == pytest.approx(0.2, abs=1e-3)
    assert result["pose"]["angle_error_deg"]["median"] == pytest.approx(0.0, abs=0.1)

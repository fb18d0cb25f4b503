"""Gates on the podium although the mount is wrong: a detector that sees gates only in images with gravity down."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic_flight import CAMERA

from swift_ros import geometry
from swift_ros.perception.mount_search import EMPTY_IMAGES, MountSearch
from swift_ros.types import GateCorners, Odometry

LEVEL = np.array([0.0, 0.0, 0.0, 1.0])
GATE = GateCorners(np.array([[100.0, 100.0], [140.0, 100.0], [140.0, 140.0], [100.0, 140.0]]), np.ones(4))


class Detector:
    """Finds a gate where the image is turned upright within 5 degrees, if there is one in it."""

    def __init__(self, assumed, true=CAMERA):
        self.camera, self._true, self.turns_deg = assumed, true, []

    def detect(self, image, q_world_body):
        assumed = geometry.quaternion_multiply(q_world_body, self.camera.q_body_camera)
        true = geometry.quaternion_multiply(LEVEL, self._true.q_body_camera)
        self.turns_deg.append(float(np.degrees(2.0 * np.arccos(min(abs(assumed @ true), 1.0)))))
        return [GATE] if image and self.turns_deg[-1] < 5.0 else []

    def detect_all(self, image, q_world_body):
        return self.detect(image, q_world_body), []


def at_speed(speed: float) -> Odometry:
    return Odometry(0, np.zeros(3), LEVEL, np.array([speed, 0.0, 0.0]), np.zeros(3))


def found(search: MountSearch, images) -> list[bool]:
    return [bool(search.detect_all(image, LEVEL)[0]) for image in images]


@pytest.mark.parametrize(
    "wrong",
    [{"pitch_deg": -20.0}, {"roll_deg": 90.0}, {"roll_deg": 180.0}, {"pitch_deg": 0.0, "roll_deg": -20.0}],
    ids=str,
)
def test_gates_are_found_in_every_second_image_with_a_wrong_mount(wrong):
    search = MountSearch(Detector(replace(CAMERA, **wrong)))
    search.odometry(at_speed(0.0))
    seen = found(search, [True] * 80)
    assert not any(seen[:EMPTY_IMAGES])
    assert seen[40:] in ([True, False] * 20, [False, True] * 20)


def test_with_the_right_mount_each_image_is_turned_by_it():
    detector = Detector(CAMERA)
    assert all(found(MountSearch(detector), [True] * 40))
    assert max(detector.turns_deg) < 1e-3


def test_after_gates_appear_each_image_is_turned_by_the_given_mount_again():
    """A podium with a cover on the lens, which is then taken off."""
    detector = Detector(CAMERA)
    seen = found(MountSearch(detector), [False] * 40 + [True] * 20)
    assert not any(seen[:40]) and all(seen[42:])
    assert max(detector.turns_deg[:40]) > 10.0 and max(detector.turns_deg[42:]) < 1e-3


def test_in_flight_each_image_is_turned_by_the_given_mount():
    detector = Detector(replace(CAMERA, pitch_deg=-20.0))
    search = MountSearch(detector)
    assert any(found(search, [True] * 80))
    search.odometry(at_speed(2.0))
    search.odometry(at_speed(0.0))
    assert not any(found(search, [True] * 80))
    assert detector.turns_deg[80:] == pytest.approx([40.0] * 80)

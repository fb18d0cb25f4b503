"""The gate detector: the attitude of an image, and detections of the shipped model."""

from dataclasses import replace

import numpy as np
import pytest

from swift_ros import configuration, geometry
from swift_ros.camera import model as lens
from swift_ros.perception.gate_detector import AttitudeAtStamp, GateDetector
from swift_ros.types import Odometry
from swift_sim_bridge.gate_detector.evaluation.setup import load_setup
from swift_sim_bridge.rendering.renderer import Renderer

MS = 1_000_000
SPIN = np.array([0.0, 0.0, 2.0])


def odometry(stamp_ms):
    """Return odometry of a vehicle that rotates about z at 2 rad/s."""
    q = geometry.quaternion_from_yaw(np.array(2e-3 * stamp_ms))
    return Odometry(stamp_ms * MS, np.zeros(3), q, np.zeros(3), SPIN)


def yaws(images):
    return [(image, None if q is None else round(float(geometry.yaw_of(q)), 6)) for image, q in images]


def test_in_lockstep_images_wait_for_odometry_and_are_processed_in_order():
    attitude = AttitudeAtStamp(wait=True, max_age_s=0.1)
    attitude.add_odometry(odometry(0))
    attitude.add_image(10 * MS, "first")
    attitude.add_image(25 * MS, "second")
    assert list(attitude.ready_images()) == []
    attitude.add_odometry(odometry(20))
    assert yaws(attitude.ready_images()) == [("first", 0.02)]
    attitude.add_odometry(odometry(30))
    assert yaws(attitude.ready_images()) == [("second", 0.05)]


def test_in_real_time_the_newest_attitude_is_extrapolated_up_to_an_age():
    attitude = AttitudeAtStamp(wait=False, max_age_s=0.1)
    attitude.add_image(1 * MS, "before any odometry")
    assert yaws(attitude.ready_images()) == [("before any odometry", None)]
    attitude.add_odometry(odometry(100))
    attitude.add_image(115 * MS, "on")
    attitude.add_image(300 * MS, "too old")
    assert yaws(attitude.ready_images()) == [("on", 0.23), ("too old", None)]


@pytest.fixture(scope="module")
def stage(repository):
    return load_setup(repository / "config")


@pytest.mark.parametrize("turn", [(0, 0, 0), (1.3, 0, 0), (-0.8, 0.6, 0)])
def test_the_shipped_model_detects_the_next_gate_at_any_roll(stage, turn):
    track, renderer = stage.track, Renderer(stage.camera, stage.track, stage.looks, 1001)
    p_world = track.positions[0] - [5.0, 0.4, 0.3]
    q = geometry.quaternion_from_rotation_vector(np.array(turn, dtype=float))
    gates = stage.detector.detect(renderer.render(p_world, q, np.zeros(3), np.zeros(3)), q)
    true, _ = lens.project(stage.camera, lens.world_to_camera(stage.camera, p_world, q, track.corners[0]))
    assert min(np.abs(gate.corners_px - true).max() for gate in gates) < 2.0


def test_of_a_gate_half_outside_of_the_image_the_shipped_model_detects_the_rest(stage, repository):
    """A narrow lens that looks up by 40 degrees sees only the upper edge of a gate ahead of a level vehicle."""
    camera = configuration.load(lens.Camera, repository / "config/cameras/pinhole_100.yaml")
    half = {name: 0.5 * getattr(camera, name) for name in ("fx", "fy", "cx", "cy")}  # the size takes the time
    camera = replace(camera, width=320, height=240, **half)
    detector = GateDetector(camera, stage.detector.network, stage.detector.grouping)
    p_world, q = stage.track.positions[0] - [4.0, 0.2, 0.1], geometry.quaternion_from_yaw(np.array(0.0))
    image = Renderer(camera, stage.track, stage.looks, 1001).render(p_world, q, np.zeros(3), np.zeros(3))
    true, _ = lens.project(camera, lens.world_to_camera(camera, p_world, q, stage.track.corners[0]))
    assert (lens.inside_px(camera, true) > 0).tolist() == [True, True, False, False]
    whole, incomplete = detector.detect_all(image, q)
    assert all(np.abs(gate.corners_px - true).max() > 20.0 for gate in whole)
    [upper] = [gate for gate in incomplete if np.nanmax(np.abs(gate.corners_px - true)) < 3.0]
    assert np.isfinite(upper.corners_px).all(axis=1).tolist() == [True, True, False, False]
    assert (upper.confidence > 0.0).tolist() == [True, True, False, False]


def test_an_image_of_another_size_is_an_error(stage):
    with pytest.raises(ValueError, match="the image has 640 x 480 px, camera.yaml 384 x 384"):
        stage.detector.detect(np.zeros((480, 640), np.uint8), np.array([0.0, 0, 0, 1]))

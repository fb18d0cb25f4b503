"""The upright panorama: inverse conversions, vertical edges at any attitude, and attitude errors."""

from dataclasses import replace

import numpy as np
import pytest

from swift_ros import configuration, geometry
from swift_ros.camera import model as lens
from swift_ros.perception.upright import Panorama, UprightView, panorama_of_lens, r_upright_camera
from swift_sim_bridge.labels import folder

TRAINED = Panorama(384, 135.0)


@pytest.fixture(scope="module")
def view(repository):
    return UprightView(configuration.load(lens.Camera, repository / "config/camera.yaml"), TRAINED)


def attitudes(count):
    """Return random rotations R_world_camera."""
    q = geometry.normalize(np.random.default_rng(3).standard_normal((count, 4)))
    return geometry.rotation_matrix(q)


def test_points_and_rays_are_inverse(view):
    points = np.random.default_rng(0).uniform(1, 382, (500, 2))
    rays = view.panorama.rays(points)
    assert np.allclose(np.linalg.norm(rays, axis=-1), 1)
    assert np.allclose(view.panorama.points(7.0 * rays), points, atol=1e-9)
    assert np.allclose(view.panorama.points(np.array([1.0, 0.0, 0.0])), [191.5, 191.5])


def test_conversions_to_the_image_and_back_are_inverse_at_any_attitude(view):
    for r_world_camera in attitudes(20):
        rays = lens.unproject(view.camera, np.random.default_rng(1).uniform(80, 300, (50, 2)))
        points = view.from_rays(rays, r_world_camera)
        pixels, _ = lens.project(view.camera, rays)
        assert np.allclose(view.to_image(points, r_world_camera), pixels, atol=1e-6)


def test_the_panorama_shows_the_image_along_its_rays(view):
    ramps = np.mgrid[0:384, 0:384].astype(np.float32)
    for r_world_camera in attitudes(12):
        rows, columns = (view.warp(ramp, r_world_camera) for ramp in ramps)
        points = np.stack(np.meshgrid(np.arange(384), np.arange(384)), axis=-1)
        pixels = view.to_image(points, r_world_camera)
        inside = np.linalg.norm(pixels - 191.5, axis=-1) < 183
        assert np.abs(columns - pixels[..., 0])[inside].max() < 0.1
        assert np.abs(rows - pixels[..., 1])[inside].max() < 0.1


def test_a_vertical_edge_is_a_column_at_any_attitude(view):
    # a post seen from 3 m, somewhere within the view
    post = np.stack([np.full(9, 2.5), np.full(9, 1.6), np.linspace(-2, 2, 9)], axis=-1)
    for r_world_camera in attitudes(20):
        upright = r_upright_camera(r_world_camera)
        turned = post @ upright @ r_world_camera.T  # the same post in front of the camera, in the world
        columns = view.from_rays(turned @ r_world_camera, r_world_camera)[:, 0]
        assert np.ptp(columns) < 1e-6


def test_an_attitude_error_of_a_degree_does_not_move_a_corner(view):
    image = np.zeros((384, 384), np.uint8)
    image[239:242, 249:252] = 255
    for r_world_camera in attitudes(8):
        error = geometry.rotation_matrix(geometry.quaternion_from_rotation_vector(np.radians([0.6, -0.7, 0.4])))
        for estimated in (r_world_camera, error @ r_world_camera):
            turned = view.warp(image, estimated).astype(float)
            if turned.sum() < 500:  # the mark lies outside of the panorama
                continue
            rows, columns = np.mgrid[0:384, 0:384]
            middle = np.array([(turned * columns).sum(), (turned * rows).sum()]) / turned.sum()
            assert np.linalg.norm(view.to_image(middle, estimated) - [250, 240]) < 0.3


@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2])
def test_a_camera_that_points_vertically_keeps_its_heading(view, pitch):
    heading = 0.7
    ahead = np.array([np.cos(heading) * np.cos(pitch), np.sin(heading) * np.cos(pitch), np.sin(pitch)])
    right = np.array([np.sin(heading), -np.cos(heading), 0.0])
    r_world_camera = np.stack([right, np.cross(ahead, right), ahead], axis=1)
    level = np.array([np.cos(heading), np.sin(heading), 0.0])
    assert np.allclose(r_upright_camera(r_world_camera) @ r_world_camera.T @ level, [1, 0, 0], atol=1e-9)


def looking(elevation_deg, roll_deg=0.0):
    """Return the attitude (3, 3) of a camera with an elevation of its axis and a roll about it."""
    pitch, roll = np.radians(elevation_deg), np.radians(roll_deg)
    ahead, right = np.array([np.cos(pitch), 0.0, np.sin(pitch)]), np.array([0.0, -1.0, 0.0])
    level = np.stack([right, np.cross(ahead, right), ahead], axis=1)
    return level @ geometry.rotation_matrix(geometry.quaternion_from_rotation_vector(np.array([0.0, 0.0, roll])))


def test_the_lens_of_the_training_and_a_wider_one_have_the_panorama_of_the_training(view):
    assert panorama_of_lens(view.camera, TRAINED) == TRAINED
    wider = replace(view.camera, image_circle_deg=195.0)
    assert panorama_of_lens(wider, TRAINED) == TRAINED
    for r_world_camera in attitudes(20):
        assert view.panorama_at(r_world_camera) == TRAINED


@pytest.mark.parametrize("roll_deg", [0.0, 30.0, 90.0])
@pytest.mark.parametrize("elevation_deg", [-40.0, 0.0, 25.0, 40.0])
def test_a_narrow_image_fills_its_panorama_wherever_the_camera_looks(elevation_deg, roll_deg):
    camera = folder.pinhole(640, 480, 60.0)
    view, r_world_camera = UprightView(camera, TRAINED), looking(elevation_deg, roll_deg)
    turned = view.warp(np.full((480, 640), 255, np.uint8), r_world_camera)
    assert np.allclose(view.from_rays(np.array([0.0, 0.0, 1.0]), r_world_camera), [191.5, 191.5])
    rows, columns = np.nonzero(turned)
    assert max(np.ptp(rows), np.ptp(columns)) > 300
    assert 0.35 < np.mean(turned > 0) < 0.65  # a rectangle of 4:3 within its circle: 48 %
    corners = np.array([[0.0, 0.0], [639.0, 0.0], [639.0, 479.0], [0.0, 479.0]])
    points = view.from_rays(lens.unproject(camera, corners), r_world_camera)
    assert points.min() > -30 and points.max() < 384 + 30
    assert np.allclose(view.to_image(points, r_world_camera), corners, atol=1e-6)


def test_a_gate_has_its_shape_in_the_middle_of_a_raised_panorama():
    view, r_world_camera = UprightView(folder.pinhole(640, 480, 50.0), TRAINED), looking(40.0)
    square = np.array([[-0.02, -0.02, 1.0], [0.02, -0.02, 1.0], [0.02, 0.02, 1.0], [-0.02, 0.02, 1.0]])
    points = view.from_rays(square, r_world_camera)
    sides = np.linalg.norm(points - np.roll(points, -1, axis=0), axis=-1)
    assert np.ptp(sides) < 0.04 * sides.mean()


@pytest.mark.parametrize("elevation_deg", [-89.0, 70.0])
def test_no_panorama_reaches_nearer_to_the_poles_than_that_of_the_training(elevation_deg):
    view = UprightView(folder.pinhole(640, 480, 60.0), TRAINED)
    middle = np.array([191.5, 191.5])
    panorama = view.panorama_at(looking(elevation_deg))
    highest = np.degrees(np.abs(panorama.angles(middle + [[0.0, -192.0], [0.0, 192.0]])[:, 1])).max()
    assert highest == pytest.approx(np.degrees(192 / 135.0), abs=1e-6)


def test_a_large_photograph_is_averaged_not_sampled():
    camera = folder.pinhole(3200, 2400, 60.0)
    noise = np.random.default_rng(0).integers(0, 2, (2400, 3200)).astype(np.uint8) * 254 + 1
    turned = UprightView(camera, TRAINED).warp(noise, looking(10.0)).astype(float)
    assert turned[turned > 0].std() < 20.0  # 127 in the photograph, 80 where four pixels are read
    rows, columns = (
        UprightView(camera, TRAINED).warp((ramp / 16).astype(np.float32), looking(10.0)) * 16
        for ramp in np.mgrid[0:2400, 0:3200]
    )
    points = np.stack(np.meshgrid(np.arange(150, 230), np.arange(150, 230)), axis=-1)
    pixels = UprightView(camera, TRAINED).to_image(points, looking(10.0))
    assert np.abs(columns[150:230, 150:230] - pixels[..., 0]).max() < 0.5
    assert np.abs(rows[150:230, 150:230] - pixels[..., 1]).max() < 0.5

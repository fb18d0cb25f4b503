"""The upright panorama: inverse conversions, vertical edges at any attitude, and attitude errors."""

import numpy as np
import pytest

from swift_ros import configuration, geometry
from swift_ros.camera import model as lens
from swift_ros.perception.upright import Panorama, UprightView, r_upright_camera


@pytest.fixture(scope="module")
def view(repository):
    return UprightView(configuration.load(lens.Camera, repository / "config/camera.yaml"), Panorama(384, 135.0))


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

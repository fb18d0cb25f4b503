"""Errors of the camera: each is recovered from the pixels of corners, and is present in the image."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from known_motion import motion

from swift_ros import configuration, geometry
from swift_ros.camera import model as lens
from swift_ros.track import Track
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.rendering import scene as scenes
from swift_sim_bridge.rendering import textures
from swift_sim_bridge.rendering.motion import BodyMotion
from swift_sim_bridge.rendering.renderer import CircleRenderer
from swift_sim_bridge.seeds import generator
from swift_sim_bridge.sensors.camera import (
    ImageErrors,
    corner_displacement,
    flown_camera,
    image_errors,
    project_corners,
)
from swift_sim_bridge.sensors.clock import Moving
from swift_sim_bridge.sensors.terms import sensor_terms

FOLDER = configuration.configuration_folder()
CAMERA = configuration.load(lens.Camera, FOLDER / "camera.yaml")
TRACK = configuration.load(Track, FOLDER / "track.yaml")
SHIPPED = configuration.load(Vehicle, FOLDER / "drone.yaml")
STILL = np.zeros(3)


def terms(**entries):
    return sensor_terms(replace(SHIPPED, terms=entries))


def poses():
    """Return twenty bodies around the origin, and points 3 to 6 m before them."""
    points = generator(1, "points").uniform([3.0, -2.5, -1.0], [6.0, 2.5, 2.5], (12, 3))
    body = motion(np.arange(20) * 0.1)
    near = geometry.quaternion_from_rotation_vector(0.1 * geometry.rotation_vector_from_quaternion(body.q_world_body))
    return Moving(0.1 * body.p_world, near, body.v_world, body.omega_body), points


def seen(camera, errors=ImageErrors(), rng=None):  # noqa: B008 - a constant
    body, points = poses()
    pixels, inside = project_corners(camera, errors, body, points, rng)
    return np.where(inside[..., None], pixels, np.nan)


def fit(camera_of, parameters: int, pixels):
    """Return the parameters of the camera that gives these pixels, by Gauss-Newton from zero."""
    found, step = np.zeros(parameters), 1e-6
    there = np.isfinite(pixels)
    for _ in range(5):
        here = seen(camera_of(found))
        slopes = [(seen(camera_of(found + step * axis)) - here)[there] / step for axis in np.eye(parameters)]
        found = found + np.linalg.lstsq(np.stack(slopes, axis=1), (pixels - here)[there], rcond=None)[0]
    return found


def test_without_terms_the_camera_is_that_of_the_file():
    assert flown_camera(CAMERA, {}) is CAMERA and image_errors({}) == ImageErrors()
    zero = terms(camera_extrinsic={}, camera_focal={"scale": 0.0}, rolling_shutter={"readout": 0.0})
    assert np.array_equal(seen(flown_camera(CAMERA, zero), image_errors(zero)), seen(CAMERA), equal_nan=True)


def test_rotation_and_shift_of_a_camera_are_recovered():
    def camera(values):
        return flown_camera(CAMERA, terms(camera_extrinsic={"rotation": [*values[:3]], "position": [*values[3:]]}))

    planted = np.array([0.02, -0.03, 0.01, 0.01, -0.005, 0.02])
    assert fit(camera, 6, seen(camera(planted))) == pytest.approx(planted, rel=0.01)


def test_focal_length_and_centre_are_recovered():
    def camera(values):
        return flown_camera(CAMERA, terms(camera_focal={"scale": values[0], "centre_px": [*values[1:]]}))

    planted = np.array([0.015, 2.0, -1.5])
    assert fit(camera, 3, seen(camera(planted))) == pytest.approx(planted, rel=0.01)


def test_a_rolling_shutter_shifts_rows_in_proportion_to_the_rate_and_its_readout_is_recovered():
    errors = image_errors(terms(rolling_shutter={"readout": 0.015}))
    points = np.stack([np.full(9, 100.0), np.zeros(9), np.linspace(-80.0, 150.0, 9)], axis=1)
    level = np.array([0.0, 0.0, 0.0, 1.0])

    def columns_of(yaw_rate, image, yaw=0.0):
        turned = geometry.integrate_quaternion(level, np.array([0.0, 0.0, 1.0]), yaw)
        pixels, _ = project_corners(CAMERA, image, Moving(STILL, turned, STILL, np.array([0, 0, yaw_rate])), points)
        return pixels[:, 0], pixels[:, 1] / (CAMERA.height - 1) - 0.5

    still, _ = columns_of(0.0, ImageErrors())
    per_radian = (columns_of(0.0, ImageErrors(), 1e-4)[0] - columns_of(0.0, ImageErrors(), -1e-4)[0]) / 2e-4
    for yaw_rate in (-4.0, 2.0, 4.0, 8.0):
        columns, rows = columns_of(yaw_rate, errors)
        shift = (columns - still) / per_radian  # as an angle: rotation of the body until the row was read
        assert shift == pytest.approx(0.015 * yaw_rate * rows, rel=0.01)


def test_a_delayed_exposure_shows_the_body_at_the_later_time():
    errors = image_errors(terms(camera_exposure={"delay": 0.01}))
    body, points = poses()
    later = Moving(
        body.p_world + 0.01 * body.v_world,
        geometry.integrate_quaternion(body.q_world_body, body.omega_body, 0.01),
        body.v_world,
        body.omega_body,
    )
    late, then = (project_corners(CAMERA, *row, points)[0] for row in ((errors, body), (ImageErrors(), later)))
    assert late == pytest.approx(then, abs=1e-6)
    assert flown_camera(CAMERA, terms(camera_exposure={"longer": 0.004})).exposure_s == CAMERA.exposure_s + 0.004


def test_corner_noise_has_its_standard_deviation_in_projections_and_in_the_image():
    errors = image_errors(terms(corner_noise={"px": 1.5}))
    off = [seen(CAMERA, errors, generator(seed, "corners")) - seen(CAMERA) for seed in range(20)]
    assert np.nanstd(off) == pytest.approx(1.5, rel=0.03)
    field = np.stack([corner_displacement((192, 192), 1.5, generator(seed, "image")) for seed in range(10)])
    assert field.std() == pytest.approx(1.5, rel=0.05)
    apart = np.mean(field[..., :-50] * field[..., 50:]) / 1.5**2
    assert abs(apart) < 0.05


# In the image.


def picture(camera, errors, body):
    rng = np.random.default_rng(0)
    zero, one = (0.0, 0.0), (1.0, 1.0)
    looks = scenes.Looks(("plain",), 1, zero, one, one, (0.02, 0.02), zero, one, one, 0, zero, zero, zero, 1)
    scene = scenes.race_scene(replace(TRACK, gates=TRACK.gates[:1]), looks, rng)
    renderer = CircleRenderer(camera, np.full((1, textures.SIDE, textures.SIDE), 128, np.uint8), errors)
    return renderer.render(scene, BodyMotion(*body), 1, rng).astype(float)


def opening(image, near):
    """Return the centroid (2,) px of the dark opening of the white gate that holds the pixel `near`."""
    _, labels = cv2.connectedComponents((image < 128).astype(np.uint8), connectivity=4)
    here = labels == labels[round(near[1]), round(near[0])]
    here = cv2.dilate(here.astype(np.uint8), np.ones((3, 3))).astype(bool)  # with the grey of its edges
    dark = np.where(here, image.max() - image, 0.0)
    v, u = np.indices(image.shape)
    return np.array([np.sum(u * dark), np.sum(v * dark)]) / np.sum(dark)


def test_the_image_agrees_with_the_projected_corners():
    """In the image of a fast, turning body the opening of a gate is at its projection, with each error."""
    yaw = geometry.quaternion_from_yaw(TRACK.yaws[0])
    away = geometry.rotate(yaw, np.array([-3.5, 0.4, 0.9]))
    v_world, omega_body = geometry.rotate(yaw, np.array([9.0, 2.0, 1.0])), np.array([2.0, 1.0, 6.0])
    body = Moving(TRACK.positions[0] + away, yaw, v_world, omega_body)
    along = np.linspace(0.0, 1.0, 40, endpoint=False)[:, None]
    corners = TRACK.corners[0]
    edge = np.concatenate([a + along * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])
    planted = terms(
        rolling_shutter={"readout": 0.02},
        camera_extrinsic={"rotation": [0.03, -0.02, 0.04], "position": [0.02, 0.0, 0.01]},
        camera_focal={"scale": 0.02, "centre_px": [1.0, -2.0]},
        camera_exposure={"delay": 0.008},
    )
    sharp = replace(CAMERA, exposure_s=1e-6)
    camera, errors = flown_camera(sharp, planted), image_errors(planted)

    def middle(lens_used, image):
        u, v = np.moveaxis(project_corners(lens_used, image, body, edge)[0], -1, 0)
        du, dv = np.roll(u, -1) - u, np.roll(v, -1) - v
        area = np.sum(u * dv - v * du) / 2  # Green's theorem: centroid of the area inside the edge
        cross = u * np.roll(v, -1) - np.roll(u, -1) * v
        return np.array([np.sum((2 * u + du) * cross), np.sum((2 * v + dv) * cross)]) / (6 * area)

    exact, bent = middle(sharp, ImageErrors()), middle(camera, errors)
    assert opening(picture(sharp, None, body), exact) == pytest.approx(exact, abs=0.1)
    assert opening(picture(camera, errors, body), bent) == pytest.approx(bent, abs=0.1)
    assert np.linalg.norm(bent - exact) > 5.0

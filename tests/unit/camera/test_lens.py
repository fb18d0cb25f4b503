"""Lenses: projections agree with OpenCV, invert exactly, and cover the image of cameras that others have calibrated."""

from dataclasses import replace
from pathlib import Path

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from swift_ros import configuration, geometry
from swift_ros.camera import lens as lenses
from swift_ros.camera.model import Camera, project, unproject
from swift_ros.errors import UsageError

CONFIG = Path(__file__).parents[3] / "config"
T265 = configuration.load(Camera, CONFIG / "camera.yaml")
# As published: EuRoC's left camera (radial-tangential), a wide OpenCV calibration with a rational polynomial, TUM-VI's
# left camera (Kannala-Brandt), and the double sphere of the same lens by Usenko, Demmel and Cremers (2018).
EUROC = (752, 480, 458.654, 457.296, 367.215, 248.375), "pinhole", (-0.28340811, 0.07395907, 0.00019359, 1.76187e-05)
RATIONAL = (1280, 720, 790.0, 792.0, 650.1, 355.7), "pinhole", (5.2, 2.1, 4e-4, -3e-4, 0.06, 5.6, 3.4, 0.35)
FIVE = (640, 480, 420.0, 421.0, 322.0, 239.0), "pinhole", (-0.31, 0.12, -8e-4, 6e-4, 0.005)
TUM_VI = (512, 512, 190.98, 190.97, 254.93, 256.90), "kannala_brandt", (0.0034, 0.0007, -0.0021, 0.0002)
SPHERE = (512, 512, 156.27, 156.30, 254.88, 256.83), "double_sphere", (-0.1815, 0.5909)
PLAIN = (640, 480, 268.5, 268.5, 319.5, 239.5), "pinhole", ()
LENSES = {"EuRoC": EUROC, "rational": RATIONAL, "five": FIVE, "TUM-VI": TUM_VI, "sphere": SPHERE, "plain": PLAIN}


def camera(name) -> Camera:
    (width, height, fx, fy, cx, cy), model, distortion = LENSES[name]
    size = {"width": width, "height": height, "fx": fx, "fy": fy, "cx": cx, "cy": cy}
    return replace(T265, **size, model=model, distortion=distortion, image_circle_deg=None)


def grid(seen: Camera) -> np.ndarray:
    """Return pixels (n, 2) all over the image."""
    u, v = np.meshgrid(np.linspace(0, seen.width - 1, 25), np.linspace(0, seen.height - 1, 19))
    return np.stack([u, v], axis=-1).reshape(-1, 2)


@pytest.mark.parametrize("name", LENSES)
def test_every_pixel_has_a_ray_that_is_imaged_there(name):
    seen = camera(name)
    pixels = grid(seen)
    rays = unproject(seen, pixels)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=-1), 1.0, atol=1e-12)
    again, theta = project(seen, 7.0 * rays)
    np.testing.assert_allclose(again, pixels, atol=1e-5)
    assert theta.max() <= seen.half_angle + 1e-3


@pytest.mark.parametrize("name", ["EuRoC", "rational", "five", "plain"])
def test_a_pinhole_lens_is_that_of_opencv(name):
    seen = camera(name)
    rays = unproject(seen, grid(seen))
    matrix = np.array([[seen.fx, 0, seen.cx], [0, seen.fy, seen.cy], [0, 0, 1]])
    expected, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), matrix, np.array(seen.distortion or [0.0] * 4))
    np.testing.assert_allclose(project(seen, rays)[0], expected[:, 0], atol=1e-6)


def test_a_kannala_brandt_lens_is_the_fisheye_of_opencv():
    seen = camera("TUM-VI")
    rays = unproject(seen, grid(seen))
    rays = rays[rays[:, 2] > 0.02]  # OpenCV divides by z
    matrix = np.array([[seen.fx, 0, seen.cx], [0, seen.fy, seen.cy], [0, 0, 1]])
    expected, _ = cv2.fisheye.projectPoints(
        rays[:, None], np.zeros((3, 1)), np.zeros((3, 1)), matrix, np.array(seen.distortion)
    )
    np.testing.assert_allclose(project(seen, rays)[0], expected[:, 0], atol=1e-6)


def test_a_double_sphere_is_that_of_its_paper():
    seen = camera("sphere")
    xi, alpha = seen.distortion
    p = unproject(seen, grid(seen))
    d1 = np.linalg.norm(p, axis=-1)
    shifted = xi * d1 + p[:, 2]
    d2 = np.sqrt(p[:, 0] ** 2 + p[:, 1] ** 2 + shifted**2)
    depth = alpha * d2 + (1 - alpha) * shifted
    expected = np.stack([seen.fx * p[:, 0] / depth + seen.cx, seen.fy * p[:, 1] / depth + seen.cy], axis=-1)
    np.testing.assert_allclose(project(seen, p)[0], expected, atol=1e-6)
    assert 180 < np.degrees(2 * seen.half_angle) < 250  # to the corners of the image; this lens sees 195 degrees across


@pytest.mark.parametrize(("name", "most"), [("plain", 8), ("EuRoC", 60)])
def test_the_inverse_of_a_pinhole_lens_ends_when_it_has_converged(monkeypatch, name, most):
    """It was 420 evaluations in each of five calls for an image with two gates: 30 ms from image to command."""
    seen, evaluated = camera(name), []
    assert seen.half_angle  # its search has evaluations of its own
    lens = lenses.LENSES[lenses.PINHOLE]
    counted = replace(lens, radius=lambda *arguments: evaluated.append(1) or lens.radius(*arguments))
    monkeypatch.setitem(lenses.LENSES, lenses.PINHOLE, counted)
    unproject(seen, grid(seen))
    assert len(evaluated) < most


@pytest.mark.parametrize("name", LENSES)
def test_rays_beyond_the_image_are_imaged_outside_of_it_at_finite_pixels(name):
    seen = camera(name)
    rng = np.random.default_rng(4)
    rays = geometry.normalize(rng.normal(size=(2000, 3)))
    pixels, theta = project(seen, rays)
    outside = theta > seen.half_angle + 0.02
    assert np.isfinite(pixels).all() and outside.sum() > 200
    low, high = pixels[outside] < -0.5, pixels[outside] > np.array([seen.width, seen.height]) - 0.5
    assert (low | high).any(axis=-1).all()


@pytest.mark.parametrize("name", LENSES)
def test_slopes_are_the_derivatives_of_the_radius(name):
    seen = camera(name)
    angle = np.linspace(0.01, seen.half_angle, 50)
    step = 1e-6
    lens, k = seen.lens, seen.distortion
    numeric = (lens.radius(angle + step, k) - lens.radius(angle - step, k)) / (2 * step)
    np.testing.assert_allclose(lens.slope(angle, k), numeric, rtol=1e-6)


@pytest.mark.parametrize("name", LENSES)
def test_numpy_and_jax_agree(name):
    seen = camera(name)
    with jax.enable_x64(True):
        rays = unproject(seen, grid(seen))
        np.testing.assert_allclose(unproject(seen, jnp.asarray(grid(seen))), rays, atol=1e-9)
        np.testing.assert_allclose(project(seen, jnp.asarray(rays))[0], project(seen, rays)[0], atol=1e-9)


def test_a_mount_is_turned_by_yaw_pitch_and_roll():
    turned = replace(T265, pitch_deg=20.0, yaw_deg=90.0, roll_deg=0.0)
    axis = geometry.rotate(turned.q_body_camera, np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(axis, [0.0, np.cos(np.radians(20)), np.sin(np.radians(20))], atol=1e-12)
    rolled = replace(T265, pitch_deg=0.0, roll_deg=30.0)
    right = geometry.rotate(rolled.q_body_camera, np.array([1.0, 0.0, 0.0]))
    np.testing.assert_allclose(right, [0.0, -np.cos(np.radians(30)), -0.5], atol=1e-12)


@pytest.mark.parametrize(
    ("model", "distortion", "sentence"),
    [
        ("fisheye", (0.0,) * 4, "must be one of kannala_brandt, pinhole, double_sphere, not 'fisheye'"),
        ("pinhole", (0.1, 0.2, 0.3), "has 0 or 4 or 5 or 8 values, not 3"),
        ("double_sphere", (), "has 2 values, not 0"),
    ],
)
def test_a_wrong_lens_is_named(tmp_path, model, distortion, sentence):
    path = tmp_path / "camera.yaml"
    text = (CONFIG / "camera.yaml").read_text().replace("distortion: [-0.004, 0.037, -0.036, 0.006]", "distortion: X")
    path.write_text(text.replace("X", str(list(distortion))) + f"model: {model}\n")
    with pytest.raises(UsageError, match=sentence):
        configuration.load(Camera, path)


def test_the_edge_of_a_lens_is_where_its_radius_no_longer_rises():
    lens = lenses.LENSES["pinhole"]
    edge = lenses.edge_angle(lens, (-0.5, 0.0, 0.0, 0.0), 100.0)  # t - t^3 / 2 falls beyond t = sqrt(2 / 3)
    assert edge == pytest.approx(np.arctan(np.sqrt(2 / 3)), abs=2e-3)

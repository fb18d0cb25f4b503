"""Examples of composed images: gates of many looks through a random lens, in the panorama of that lens."""

import numpy as np

from swift_ros import geometry
from swift_ros.camera.lens import DOUBLE_SPHERE, KANNALA_BRANDT, LENSES, PINHOLE
from swift_ros.camera.model import Camera, Intrinsics
from swift_ros.perception.upright import UprightView
from swift_sim_bridge.gate_detector.images.composites.composer import Composer
from swift_sim_bridge.gate_detector.images.targets import (
    Example,
    GateLabels,
    estimated_attitude,
    example_of,
    large_in_panorama,
)
from swift_sim_bridge.labels.folder import level_camera

LONG_SIDE_PX = (360, 640)
MOST_ASPECT = 16 / 9
UPRIGHT_SHARE = 0.15  # images that are higher than wide
PINHOLE_FOV_DEG, FISHEYE_FOV_DEG = (40.0, 110.0), (120.0, 200.0)
PINHOLE_SHARE, DOUBLE_SPHERE_SHARE = 0.6, 0.15
CIRCLE_SHARE = 0.5  # fisheye lenses whose image circle lies within the image
BARREL = (-0.12, 0.06)  # k1 of a pinhole lens, times the squared radius of its corners, up to which the radius rises
CENTRE_SHARE = 0.03  # of the image's side: standard deviation of the principal point
HIDDEN_SHARE = 1e-3  # error of the labels: what hides a corner has soft edges, its label none; see `GateLabels`


class ComposedExamples:
    """A source of composed examples.

    Args:
        settings: `DetectorTraining`.
        composer: of the images.
    """

    def __init__(self, settings, composer: Composer):
        self._settings, self._composer = settings, composer

    def draw(self, rng) -> Example:
        """Return the next example."""
        camera = random_camera(rng)
        composition = self._composer.compose(camera, rng)
        q_world_camera = geometry.quaternion_from_matrix(composition.r_world_camera)
        r_world_camera = estimated_attitude(q_world_camera, self._settings.attitude_error_deg, rng)
        view, limits = UprightView(camera, self._settings.panorama), self._settings.judged
        counts = limits.hold(composition.side_px, composition.oblique_deg, composition.distance)
        labels = GateLabels(
            rays_camera=composition.rays_camera,
            state=composition.state,
            counts=counts & large_in_panorama(view, composition.rays_camera, r_world_camera, limits.least_side_px),
            side_px=composition.side_px,
            oblique_deg=composition.oblique_deg,
            distance=composition.distance,
            error_share=HIDDEN_SHARE,
        )
        return example_of(view, composition.image, labels, r_world_camera)


def random_camera(rng) -> Camera:
    """Return a camera with a random lens, size and principal point, level and at the body's origin."""
    width = int(rng.integers(*LONG_SIDE_PX, endpoint=True))
    height = int(width / rng.uniform(1.0, MOST_ASPECT))
    if rng.random() < UPRIGHT_SHARE:
        width, height = height, width
    kind = rng.random()
    model = PINHOLE if kind < PINHOLE_SHARE else KANNALA_BRANDT
    model = DOUBLE_SPHERE if kind > 1.0 - DOUBLE_SPHERE_SHARE else model
    half_angle = 0.5 * np.radians(rng.uniform(*(PINHOLE_FOV_DEG if model == PINHOLE else FISHEYE_FOV_DEG)))
    within_image = model != PINHOLE and rng.random() < CIRCLE_SHARE
    if model == PINHOLE:
        reach_px, distortion = 0.5 * width, _barrel(half_angle, width, height, rng)
    else:
        reach_px = 0.5 * (min(width, height) if within_image else np.hypot(width, height))
        distortion = _bent(model, rng)
    focal_px = reach_px / float(LENSES[model].radius(half_angle, distortion))
    cx, cy = rng.normal(0.0, CENTRE_SHARE, 2) * min(width, height)
    lens = Intrinsics(
        width=width,
        height=height,
        fx=focal_px,
        fy=focal_px * rng.uniform(0.99, 1.01),
        cx=0.5 * (width - 1) + float(cx),
        cy=0.5 * (height - 1) + float(cy),
        distortion=distortion,
    )
    return level_camera(lens, model, float(np.degrees(2.0 * half_angle)) if within_image else None)


def _barrel(half_angle: float, width: int, height: int, rng) -> tuple[float, ...]:
    """Return coefficients of a pinhole lens with a horizontal half angle, rad, whose radius rises up to its corners."""
    corner = np.tan(half_angle) * np.hypot(width, height) / width
    if rng.random() < 0.3:
        return ()
    return (float(rng.uniform(*BARREL) / corner**2), 0.0, *(float(p) for p in rng.normal(0.0, 5e-4, 2)))


def _bent(model: str, rng) -> tuple[float, ...]:
    """Return coefficients of a fisheye lens, as calibrations find them."""
    if model == DOUBLE_SPHERE:
        return float(rng.uniform(-0.3, 0.1)), float(rng.uniform(0.52, 0.62))
    return (*(float(k) for k in rng.uniform((-0.03, -0.006), (0.04, 0.006))), 0.0, 0.0)

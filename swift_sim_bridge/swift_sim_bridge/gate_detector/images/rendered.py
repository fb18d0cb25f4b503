"""Labelled images of rendered scenes: random tracks, clutter, surfaces and poses.

A scene is rendered and its image turned upright. Labels are exact: a corner is IGNORED within a few pixels of being
hidden, and hidden beyond.
"""

import numpy as np

from swift_ros import geometry
from swift_ros.camera import model as lens
from swift_sim_bridge.gate_detector.corner_states import BORDER_PX, HIDDEN, IGNORED, VISIBLE
from swift_sim_bridge.gate_detector.images import race_poses
from swift_sim_bridge.gate_detector.images.targets import (
    Example,
    GateLabels,
    GateLimits,
    estimated_attitude,
    example_of,
)
from swift_sim_bridge.rendering import scene as scenes
from swift_sim_bridge.rendering.scene import Looks, Plates


def _corners_as_seen(plates: Plates, count: int, eye):
    """Return the inner corners (count, 4, 3) of the gates in the world, m, in the order as seen from `eye` (3,)."""
    signs = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
    normal = plates.rotation[:count, :, 0]
    front = np.sum(normal * (eye - plates.centre[:count]), axis=-1) < 0
    left = np.where(front, 1.0, -1.0)[:, None] * signs[:, 0] * plates.half_inner[:count, :1]
    up = signs[:, 1] * plates.half_inner[:count, 1:]
    axes = plates.rotation[:count]
    return plates.centre[:count, None] + left[..., None] * axes[:, None, :, 1] + up[..., None] * axes[:, None, :, 2]


def _cover(plates: Plates, gates: int, eye, corners, margin):
    """Return (gates, 4) bool: another plate, enlarged by `margin` rad, is in front of the corner."""
    towards = corners - eye
    away = np.linalg.norm(towards, axis=-1)
    hidden = np.zeros(corners.shape[:2], bool)
    for j in range(len(plates.centre)):
        axes, offset = plates.rotation[j], eye - plates.centre[j]
        slope = towards @ axes[:, 0]
        share = -(offset @ axes[:, 0]) / np.where(np.abs(slope) < 1e-9, 1e-9, slope)
        point = offset + share[..., None] * towards
        left, up = np.abs(point @ axes[:, 1]), np.abs(point @ axes[:, 2])
        outer, inner, grown = plates.half_outer[j], plates.half_inner[j], margin * share * away
        solid = (left < outer[0] + grown) & (up < outer[1] + grown)
        solid &= ~((left < inner[0] - grown) & (up < inner[1] - grown))
        before = solid & (share > 0.0) & (share < 0.998)
        if j < gates:
            before[j] = False
        hidden |= before
    return hidden


def label_gates(camera, plates: Plates, gates: int, p_world, q_world_body, limits: GateLimits) -> GateLabels:
    """Return the labels of the gates in an image.

    Args:
        camera: the lens and its mount.
        plates: of the scene; the first `gates` are gates.
        gates: number of gates.
        p_world, q_world_body: (3,) m and (4,), pose of the body.
        limits: which gates count.
    """
    eye = np.asarray(p_world) + geometry.rotate(np.asarray(q_world_body), camera.p_body_camera)
    corners = _corners_as_seen(plates, gates, eye)
    distance = np.linalg.norm(plates.centre[:gates] - eye, axis=-1)
    towards = (plates.centre[:gates] - eye) / distance[:, None]
    cosine = np.abs(np.sum(towards * plates.rotation[:gates, :, 0], axis=-1))
    rays = lens.world_to_camera(camera, np.asarray(p_world), np.asarray(q_world_body), corners)
    pixels, theta = lens.project(camera, rays)
    side = np.linalg.norm(pixels - np.roll(pixels, -1, axis=1), axis=-1).min(axis=1)
    border = BORDER_PX / camera.fx
    state = np.where(_cover(plates, gates, eye, corners, border), IGNORED, VISIBLE)
    state[_cover(plates, gates, eye, corners, -border)] = HIDDEN
    within = np.minimum((camera.half_angle - theta) / border, lens.inside_px(camera, pixels) / BORDER_PX)
    state[(np.abs(within) < 1.0) & (state == VISIBLE)] = IGNORED
    state[within < -1.0] = HIDDEN
    oblique = np.degrees(np.arccos(cosine))
    return GateLabels(rays, state, limits.hold(side, oblique, distance), side, oblique, distance)


def clutter(count: int, eye, aim, bounds, looks: Looks, rng) -> Plates:
    """Return plates that are no gates: panels, posts and frames of other shapes; a third of them has size zero.

    Args:
        count: number of plates.
        eye, aim: (3,) m, camera and a gate; some plates lie between the two.
        bounds: corners (3,) and (3,) m of the flight volume.
        looks: ranges of the surfaces.
        rng: generator.
    """
    low, high = bounds
    half_outer, half_inner = np.full((count, 2), -1.0), np.full((count, 2), -1.0)
    centre = rng.uniform(low, high, (count, 3))
    for i in range(count):
        kind = rng.integers(0, 6)
        if kind < 2:
            half_outer[i] = rng.uniform(0.2, 1.2, 2)
        elif kind == 2:
            half_outer[i] = rng.uniform(0.05, 0.25), rng.uniform(0.8, 3.0)
        elif kind == 3:
            half_outer[i] = rng.uniform(0.3, 0.8), rng.uniform(1.2, 2.0)
            half_outer[i] = half_outer[i][:: rng.choice([1, -1])]
            half_inner[i] = half_outer[i] - rng.uniform(0.05, 0.25)
        if kind < 3 and rng.random() < 0.4:
            centre[i] = eye + rng.uniform(0.15, 0.95) * (aim - eye) + rng.uniform(-0.8, 0.8, 3)
    yaw = rng.uniform(-np.pi, np.pi, count)
    return Plates(
        centre=centre.astype(np.float32),
        rotation=geometry.rotation_matrix(geometry.quaternion_from_yaw(yaw)).astype(np.float32),
        half_outer=half_outer.astype(np.float32),
        half_inner=half_inner.astype(np.float32),
        texture=rng.integers(0, looks.textures, count).astype(np.int32),
        tone=rng.uniform(*looks.surface_tone, count).astype(np.float32),
        contrast=rng.uniform(*looks.contrast, count).astype(np.float32),
    )


class RenderedExamples:
    """A source of labelled images, which depend on the random generator only."""

    def __init__(self, settings, camera, view, track, circle):
        """Make a source.

        Args:
            settings: `train.DetectorTraining`.
            camera: the lens and its mount.
            view: the UprightView.
            track: of the images that do not show a random track.
            circle: the CircleRenderer.
        """
        self.settings, self.camera, self.view, self.track, self.circle = settings, camera, view, track, circle

    def draw(self, rng) -> Example:
        """Return the next example."""
        settings = self.settings
        track = self.track if rng.random() < settings.own_track_share else race_poses.random_track(self.track, rng)
        pose = race_poses.draw(track, self.camera, settings.racing_share, rng)
        gates = scenes.gate_plates(track, settings.looks, rng)
        count = len(track.gates)
        aim = track.positions[rng.integers(0, count)]
        bounds = (track.bounds_min, track.bounds_max)
        others = clutter(settings.plates - count, pose.p_world, aim, bounds, settings.looks, rng)
        surroundings = scenes.room(*bounds, settings.looks, rng)
        scene = scenes.exposed(scenes.join(gates, others), surroundings, settings.looks, rng)
        return self.label(scene, count, pose, rng)

    def label(self, scene, gates: int, pose, rng) -> Example:
        """Return the example of a scene, whose first `gates` plates are gates, from a pose (BodyMotion)."""
        settings = self.settings
        image = self.circle.render(scene, pose, settings.looks.blur_poses, rng)
        q_world_camera = geometry.quaternion_multiply(pose.q_world_body, self.camera.q_body_camera)
        r_world_camera = estimated_attitude(q_world_camera, settings.attitude_error_deg, rng)
        labels = label_gates(self.camera, scene.plates, gates, pose.p_world, pose.q_world_body, settings.judged)
        return example_of(self.view, image, labels, r_world_camera)

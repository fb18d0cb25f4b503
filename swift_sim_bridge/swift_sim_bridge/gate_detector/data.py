"""Labelled images for the gate detector: random tracks, clutter, surfaces and poses.

A scene is rendered, the image turned upright into a panorama, and its labels drawn as maps. Labels lie in the panorama,
which is the network's input. A corner is VISIBLE, HIDDEN (outside the image, its circle or the panorama, or behind
an object: no peak is expected), or IGNORED in training and scores: within a few pixels of being hidden, or of a gate
that is too small, too oblique or too far away.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from swift_ros import geometry
from swift_ros.camera import model as lens
from swift_ros.configuration import within
from swift_sim_bridge.gate_detector import race_poses
from swift_sim_bridge.gate_detector.model import STRIDE
from swift_sim_bridge.rendering import scene as scenes
from swift_sim_bridge.rendering.scene import Looks, Plates

HIDDEN, VISIBLE, IGNORED = 0, 1, 2
BORDER_PX = 2.5  # a corner this near to an occluder or to the edge of the image circle is ignored
# In pixels of the network's output; each is STRIDE pixels of the panorama. A wider Gaussian or field has more pixels to
# learn from and locates a corner or an edge less exactly.
HEAT_SIGMA_PX = 2.0 / STRIDE  # standard deviation of a corner's Gaussian
HEAT_REACH_PX = 4  # of a corner's Gaussian; it is below 0.001 beyond
EDGE_WIDTH_PX = 3  # of an affinity field
ARC_STEPS = 12  # straight pieces that approximate the curved image of an edge
MAX_PIECE_PX = 40  # a longer piece leaves the panorama on one side and enters on the other


@dataclass(frozen=True)
class GateLimits:
    """Which gates count in training and scores; corners of the others are ignored.

    Attributes:
        least_side_px: shortest side in the published image.
        most_oblique_deg: angle between the line of sight and the gate's normal.
        most_distant: m.
    """

    least_side_px: float = within(1.0, 1000.0)
    most_oblique_deg: float = within(1.0, 90.0)
    most_distant: float = within(0.5, 200.0)


@dataclass(frozen=True)
class GateLabels:
    """The labels of the gates of a scene from one pose; corners in the order TL, TR, BR, BL as seen from the camera.

    Attributes:
        rays_camera: (n, 4, 3) m, corners in the optical frame.
        state: (n, 4), HIDDEN, VISIBLE or IGNORED.
        counts: (n,) bool, the gate is within the limits.
        side_px: (n,), shortest side in the published image.
        oblique_deg: (n,), angle between the line of sight and the gate's normal.
        distance: (n,) m.
    """

    rays_camera: np.ndarray
    state: np.ndarray
    counts: np.ndarray
    side_px: np.ndarray
    oblique_deg: np.ndarray
    distance: np.ndarray


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
    counts = (side >= limits.least_side_px) & (oblique < limits.most_oblique_deg) & (distance <= limits.most_distant)
    return GateLabels(rays, state, counts, side, oblique, distance)


def panorama_labels(view, labels: GateLabels, r_world_camera):
    """Return the corners (n, 4, 2) in the panorama, px, and their states (n, 4).

    Corners outside the panorama are HIDDEN; those of gates that do not count are IGNORED.

    Args:
        view: the UprightView that turns images.
        labels: of the image.
        r_world_camera: (3, 3), attitude by which the image is turned.
    """
    points = view.from_rays(labels.rays_camera, r_world_camera)
    state = np.where(labels.counts[:, None] | (labels.state == HIDDEN), labels.state, IGNORED)
    side = view.panorama.side
    return points, np.where(((points > 2) & (points < side - 3)).all(axis=-1), state, HIDDEN)


def _stamp(heat, point):
    """Add a Gaussian of height one at a point (output px) to a corner map, as the maximum of both."""
    h, w = heat.shape
    x0, y0 = np.floor(point).astype(int) - HEAT_REACH_PX
    x = np.arange(max(x0, 0), min(x0 + 2 * HEAT_REACH_PX + 2, w))
    y = np.arange(max(y0, 0), min(y0 + 2 * HEAT_REACH_PX + 2, h))
    if len(x) and len(y):
        bump = np.exp(-((x - point[0]) ** 2 + (y[:, None] - point[1]) ** 2) / (2 * HEAT_SIGMA_PX**2))
        patch = heat[y[0] : y[-1] + 1, x[0] : x[-1] + 1]
        np.maximum(patch, bump, out=patch)


def _arc(view, ray_a, ray_b, r_world_camera):
    """Return points (ARC_STEPS + 1, 2) px of the panorama along the image of the straight edge between two corners."""
    share = np.linspace(0, 1, ARC_STEPS + 1)[:, None]
    return view.from_rays(ray_a + share * (ray_b - ray_a), r_world_camera)


def _draw_edge(field, mask, arc, drawn: bool):
    """Draw the direction of an edge into a field (h, w, 2), or mark the edge as ignored in `mask`."""
    for a, b in zip(arc[:-1], arc[1:], strict=True):
        length = np.hypot(*(b - a))
        if not 1e-6 < length < MAX_PIECE_PX:
            continue
        ends = [tuple(int(round(v)) for v in end * 16) for end in (a, b)]
        if drawn:
            cv2.line(field, *ends, ((b - a) / length).tolist(), EDGE_WIDTH_PX, cv2.LINE_8, 4)
        else:
            cv2.line(mask, *ends, 0.0, EDGE_WIDTH_PX + 4, cv2.LINE_8, 4)


def rasterize(view, labels: GateLabels, points, state, r_world_camera):
    """Return the target of the network's output, and where it counts.

    Args:
        view: the UprightView that turned the image.
        labels: of the image.
        points, state: corners in the panorama, see `panorama_labels`.
        r_world_camera: (3, 3), attitude by which the image was turned.

    Returns:
        target: (s, s, 12) float32, s = panorama side / STRIDE: maps of TL, TR, BR, BL, then the fields of the edges
            TL-TR, TR-BR, BR-BL, BL-TL as unit vectors (right, down).
        mask: (s, s, 2) float32, 0 where corner maps and where fields are ignored, else 1.
    """
    side = view.panorama.side // STRIDE
    heat = np.zeros((4, side, side), np.float32)
    fields = [np.zeros((side, side, 2), np.float32) for _ in range(4)]
    mask = [np.ones((side, side), np.float32) for _ in range(2)]
    shrunk = (points - (STRIDE - 1) / 2) / STRIDE
    for gate in np.argsort(-labels.distance):
        for k in range(4):
            if state[gate, k] == VISIBLE:
                _stamp(heat[k], shrunk[gate, k])
            elif state[gate, k] == IGNORED:
                cv2.circle(mask[0], tuple(int(v) for v in np.clip(shrunk[gate, k], -99, 999)), 4, 0.0, -1)
            pair = state[gate, [k, (k + 1) % 4]]
            if HIDDEN in pair and not (pair != HIDDEN).any():
                continue
            rays = labels.rays_camera[gate, [k, (k + 1) % 4]]
            arc = (_arc(view, *rays, r_world_camera) - (STRIDE - 1) / 2) / STRIDE
            _draw_edge(fields[k], mask[1], arc, bool((pair == VISIBLE).all()))
    target = np.concatenate([np.moveaxis(heat, 0, -1), *fields], axis=-1)
    return target, np.stack(mask, axis=-1)


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


@dataclass(frozen=True)
class Example:
    """One labelled image.

    Attributes:
        image: (H, W) uint8, as published.
        panorama: (side, side) uint8, the network's input.
        r_world_camera: (3, 3), by the odometry with its error.
        labels: of the gates.
        points, state: (n, 4, 2) px and (n, 4), corners in the panorama.
        target, mask: see `rasterize`.
    """

    image: np.ndarray
    panorama: np.ndarray
    r_world_camera: np.ndarray
    labels: GateLabels
    points: np.ndarray
    state: np.ndarray
    target: np.ndarray
    mask: np.ndarray


class Examples:
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
        error = np.radians(settings.attitude_error_deg) * rng.standard_normal(3)
        q_estimate = geometry.quaternion_multiply(geometry.quaternion_from_rotation_vector(error), q_world_camera)
        r_world_camera = geometry.rotation_matrix(q_estimate)
        labels = label_gates(self.camera, scene.plates, gates, pose.p_world, pose.q_world_body, settings.judged)
        points, state = panorama_labels(self.view, labels, r_world_camera)
        target, mask = rasterize(self.view, labels, points, state, r_world_camera)
        panorama = self.view.warp(image, r_world_camera)
        return Example(
            image=image,
            panorama=panorama,
            r_world_camera=r_world_camera,
            labels=labels,
            points=points,
            state=state,
            target=target,
            mask=mask,
        )

"""Backgrounds: halls, landscapes, dark rooms, water, and photographs."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from swift_ros.perception.upright import r_upright_camera
from swift_sim_bridge.gate_detector.images.composites import paint, walls
from swift_sim_bridge.gate_detector.images.composites.panels import Panel, opaque, upright_panel, with_opacity

FORWARD, LEFT = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True)
class Surroundings:
    """A background.

    Attributes:
        image: (H, W) float32, its brightness.
        haze_m: distance after which a third of the contrast is left.
        haze_tone: brightness of the haze.
        light: on gates and other objects.
        dark: lamps stand out.
    """

    image: np.ndarray
    haze_m: float
    haze_tone: float
    light: float
    dark: bool


@dataclass(frozen=True)
class Room:
    """The space that gates and camera need.

    Attributes:
        floor: m, height of the ground below the camera, negative.
        top: m, height of the highest gate above the camera; no ceiling is lower than it and the camera.
        radius: m, no wall is nearer.
    """

    floor: float
    top: float
    radius: float


def photograph(view, picture, rng) -> Surroundings:
    """Return a photograph (h, w) float32 as background, with its horizon near that of the view.

    Its middle keeps its shape (stereographic projection); beyond its edges it continues mirrored.
    """
    height, width = picture.shape
    upright = cv2.transform(view.rays, r_upright_camera(view.r_world_camera))
    ahead, left, up = cv2.split(upright)
    share = 2.0 / np.maximum(1.0 + ahead, 0.02)
    half_angle = min(view.camera.half_angle, 1.6)
    focal = rng.uniform(0.5, 1.1) * width / (4 * np.tan(half_angle / 2) * 0.8)
    shift = rng.uniform(-0.15, 0.15, 2)
    x = (0.5 + shift[0]) * width - focal * left * share * rng.choice([1, -1])
    y = (0.5 + shift[1]) * height - focal * up * share
    second: Any = None
    points = np.clip(cv2.merge([x.astype(np.float32), y.astype(np.float32)]), -4e3, 8e3)
    image = cv2.remap(picture, points, second, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101)
    return Surroundings(image, 200.0, float(image.mean()), rng.uniform(0.4, 1.2), dark=bool(image.mean() < 0.1))


def ground(room: Room, picture, tile: float) -> Panel:
    """Return the ground of a picture (h, w) of a tile, m."""
    return Panel(np.array([0, 0, room.floor]), FORWARD, LEFT, (tile, tile), opaque(picture), tiled=True)


def hall(view, room: Room, paints, rng) -> Surroundings:
    """Return a hall or room with floor, ceiling and four walls."""
    image = np.full(view.rays.shape[:2], 0.3, np.float32)
    height = max(room.top, 0.5) - room.floor + rng.uniform(0.2, 5.0)
    side, tile = 256, float(rng.uniform(1.0, 6.0))
    view.draw(image, ground(room, walls.floor((side, side), paints, rng), tile))
    ceiling = Panel(
        np.array([0, 0, room.floor + height]),
        FORWARD,
        -LEFT,
        (2 * tile, 2 * tile),
        opaque(walls.ceiling((side, side), paints, rng)),
        tiled=True,
    )
    view.draw(image, ceiling)
    turn = rng.uniform(-np.pi, np.pi)
    if rng.random() < 0.5:
        hang_lamps(view, image, room.floor + height, turn, rng)
    reach = room.radius * rng.uniform(1.05, 1.9, 4)
    same = rng.random() < 0.5
    tone = paints.tone()
    for k in np.argsort(-reach):
        yaw = turn + k * np.pi / 2
        wide = reach[(k + 1) % 4] + reach[(k - 1) % 4]
        shift = (reach[(k + 1) % 4] - reach[(k - 1) % 4]) / 2
        ahead, aside = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
        middle = (*(reach[k] * ahead + shift * aside), room.floor + height / 2)
        picture = walls.wall(wide, height, tone if same else paints.tone(), paints, rng)
        view.draw(image, upright_panel(middle, yaw, (wide, height), opaque(picture)))
    return Surroundings(image, 150.0, 0.4, rng.uniform(0.5, 1.3), dark=False)


def hang_lamps(view, image, height: float, turn: float, rng):
    """Paint rows of bright lamps under a ceiling of a height (m, over the camera)."""
    spacing = rng.uniform(2.0, 6.0)
    count = np.arange(-6, 7) * spacing
    x, y = (axis.ravel() for axis in np.meshgrid(count + rng.uniform(0, spacing), count * rng.uniform(0.5, 1.5)))
    turned = [np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y, np.full_like(x, height)]
    lamps = np.stack(turned, axis=-1)
    pixels, theta = view.project(lamps)
    size = rng.uniform(0.05, 0.3) * view.focal_px / np.linalg.norm(lamps, axis=-1)
    bright = float(rng.uniform(1.5, 6.0))
    for pixel, radius in zip(pixels[theta < 1.5], size[theta < 1.5], strict=True):
        if np.abs(pixel).max() < 2000:
            cv2.circle(image, tuple(int(v) for v in pixel), int(np.clip(radius, 1, 40)), bright, -1, cv2.LINE_AA)


def sky(view, paints, rng) -> np.ndarray:
    """Return a sky (H, W) with clouds, brighter towards the horizon."""
    up = cv2.transform(view.rays, view.r_world_camera[2:3])
    top, low = rng.uniform(0.3, 1.0), rng.uniform(0.6, 1.3)
    image = low + (top - low) * np.clip(up.reshape(view.rays.shape[:2]), 0, 1) ** 0.6
    clouds = paint.noise(image.shape, rng, (1.0, 5.0))
    return (image * (1 + rng.uniform(0.0, 0.6) * (clouds - 0.5))).astype(np.float32)


def outdoors(view, room: Room, paints, rng) -> Surroundings:
    """Return a meadow, yard or street under a sky, with trees, hills and houses at the horizon."""
    image = sky(view, paints, rng)
    view.draw(image, ground(room, walls.outdoor_ground((256, 256), paints, rng), float(rng.uniform(2.0, 8.0))))
    for _ in range(rng.integers(3, 14)):
        away, yaw = room.radius * rng.uniform(1.0, 5.0), rng.uniform(-np.pi, np.pi)
        kind = rng.random()
        if kind < 0.5:
            size, picture = walls.tree(rng)
        elif kind < 0.8:
            size = (rng.uniform(5, 25), rng.uniform(3, 12))
            picture = opaque(walls.wall(*size, paints.tone(), paints, rng))
        else:
            size, picture = (2.5 * away, 0.2 * away), walls.ridge((40, 500), rng.uniform(0.05, 0.5), rng)
        middle = (away * np.cos(yaw), away * np.sin(yaw), room.floor + size[1] / 2)
        view.draw(image, upright_panel(middle, yaw, size, picture), (0.3 * rng.random(), 0.8))
    return Surroundings(image, rng.uniform(60, 400), 0.8, rng.uniform(0.4, 1.3), dark=False)


def dark(view, room: Room, paints, rng) -> Surroundings:
    """Return a dark hall with lamps."""
    found = hall(view, room, paints, rng)
    image = found.image * rng.uniform(0.01, 0.15)
    for _ in range(rng.integers(0, 14)):
        x, y = rng.integers(0, image.shape[1]), rng.integers(0, image.shape[0])
        if rng.random() < 0.5:
            cv2.circle(image, (int(x), int(y)), int(rng.integers(1, 6)), float(rng.uniform(1.0, 6.0)), -1, cv2.LINE_AA)
        else:
            end = (int(x + rng.normal(0, 60)), int(y + rng.normal(0, 20)))
            cv2.line(image, (int(x), int(y)), end, float(rng.uniform(0.5, 3.0)), int(rng.integers(1, 5)), cv2.LINE_AA)
    return Surroundings(image, 150.0, 0.0, rng.uniform(0.02, 0.3), dark=True)


def underwater(view, room: Room, paints, rng) -> Surroundings:
    """Return a basin or the sea: bright above, hazy, with a tiled or sandy ground."""
    up = cv2.transform(view.rays, view.r_world_camera[2:3]).reshape(view.rays.shape[:2])
    tone = rng.uniform(0.15, 0.5)
    image = (tone * (1 + rng.uniform(0.2, 1.2) * up) + 0.02).astype(np.float32)
    bottom = image.copy()
    texture = (
        walls.floor((256, 256), paints, rng) if rng.random() < 0.6 else walls.outdoor_ground((256, 256), paints, rng)
    )
    caustics = np.abs(paint.noise((256, 256), rng, (1.0, 2.0)) - 0.5)
    texture = texture * (0.6 + rng.uniform(0.0, 1.0) * np.exp(-12 * caustics))
    view.draw(bottom, ground(room, texture.astype(np.float32), float(rng.uniform(2.0, 5.0))))
    clear = np.exp(room.floor / rng.uniform(2, 8) / np.maximum(-up, 0.02)) * (up < 0)
    image += clear * (bottom - image)
    image *= 1 + 0.15 * (paint.noise(image.shape, rng, (3.0, 8.0)) - 0.5)
    return Surroundings(image, rng.uniform(4.0, 15.0), float(tone), rng.uniform(0.4, 1.0), dark=False)


def plain(view, room: Room, paints, rng) -> Surroundings:
    """Return a smooth or blurred background, as of a screen, a cloth or mist."""
    shape = view.rays.shape[:2]
    tone = rng.uniform(0.05, 0.9)
    image = tone * (1 + rng.uniform(0, 1.0) * (paint.noise(shape, rng, (2.0, 10.0)) - 0.5))
    image = (image * np.linspace(*rng.uniform(0.7, 1.3, 2), shape[1])).astype(np.float32)
    if rng.random() < 0.7:
        view.draw(image, ground(room, walls.floor((256, 256), paints, rng), float(rng.uniform(1.0, 6.0))))
    return Surroundings(image, 80.0, tone, rng.uniform(0.4, 1.3), dark=False)


DRAW = {"hall": hall, "outdoors": outdoors, "dark": dark, "underwater": underwater, "plain": plain}


def draw_sun(rng) -> np.ndarray:
    """Return the direction (3,) of the sunlight, or of the light of lamps above."""
    elevation, azimuth = rng.uniform(0.45, 1.5), rng.uniform(-np.pi, np.pi)
    return -np.array([*(np.cos(elevation) * np.array([np.cos(azimuth), np.sin(azimuth)])), np.sin(elevation)])


def shadow(panel: Panel, light, floor: float, depth: float) -> Panel:
    """Return the shadow of a panel on the ground.

    Args:
        panel: that stands in the light.
        light: (3,), direction in which it falls.
        floor: m, height of the ground.
        depth: share of the light that is missing in the shadow.
    """

    def fallen(direction):
        return direction - light * (direction[2] / light[2])

    centre = panel.centre - light * ((panel.centre[2] - floor) / light[2])
    opacity = panel.picture[..., 1]
    picture = with_opacity(np.zeros_like(opacity), np.float32(depth) * opacity)
    return Panel(centre, fallen(panel.right), fallen(panel.down), panel.size, picture, solid=False)


def with_shadow(picture, rng):
    """Return a picture (h, w, 2) with the shadow of an edge or of a pole across it."""
    height, width = picture.shape[:2]
    angle = rng.uniform(0, np.pi)
    x, y = np.linspace(-1, 1, width, dtype=np.float32), np.linspace(-1, 1, height, dtype=np.float32)[:, None]
    across = x * np.cos(angle) + y * np.sin(angle) - rng.uniform(-0.8, 0.8)
    if rng.random() < 0.5:
        across = np.abs(across) - rng.uniform(0.05, 0.5)
    light = 1 - rng.uniform(0.2, 0.75) * np.clip(0.5 - across / rng.uniform(0.02, 0.3), 0, 1)
    return with_opacity(light, np.ones_like(light))[..., :1] * picture

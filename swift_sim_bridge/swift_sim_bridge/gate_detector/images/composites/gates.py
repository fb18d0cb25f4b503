"""Gates in space: their place before the camera, thickness, posts and light."""

import cv2
import numpy as np

from swift_sim_bridge.gate_detector.images.composites import frames, scenes
from swift_sim_bridge.gate_detector.images.composites.objects import Body
from swift_sim_bridge.gate_detector.images.composites.panels import Panel, opaque

GATE_ELEVATION = 0.35  # standard deviation of the sine of the elevation at which gates are seen
FAR_SIDE = 0.999  # distance of the posts over that of the gate


def attitude(looks, rng) -> np.ndarray:
    """Return the attitude (3, 3) of a camera in the world: of a racing drone, or held by hand."""
    level = rng.random() < looks.hand_held_share
    elevation, roll = np.radians(
        rng.normal(0, (4, 2)) if level else rng.normal(0, (looks.elevation_deg, looks.roll_deg))
    )
    elevation, yaw = np.clip(elevation, -1.3, 1.3), rng.uniform(-np.pi, np.pi)
    ahead = np.array([np.cos(elevation) * np.cos(yaw), np.cos(elevation) * np.sin(yaw), np.sin(elevation)])
    right = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
    down = np.cross(ahead, right)
    right, down = np.cos(roll) * right + np.sin(roll) * down, np.cos(roll) * down - np.sin(roll) * right
    return np.stack([right, down, ahead], axis=1)


def place(view, looks, rng, *, ahead: bool) -> tuple[np.ndarray, float, float]:
    """Return centre (3,) m, side of the opening (m) and its length in the image (px) of a gate in view.

    Args:
        view: of the image.
        looks: `CompositeLooks`.
        rng: generator.
        ahead: it is rather in the middle of the image, as the next gate of a race.
    """
    camera = view.camera
    size = np.array([camera.width - 1, camera.height - 1])
    short = min(camera.width, camera.height)
    for _ in range(40):
        low, high = np.log(looks.side_share)
        side_px, side = short * np.exp(rng.uniform(low, high)), rng.uniform(*looks.side)
        pixel = size * (np.clip(rng.normal(0.5, 0.2, 2), 0, 1) if ahead else rng.random(2))
        ray = view.directions(pixel)
        angle = np.arccos(np.clip(ray @ view.r_world_camera[:, 2], -1, 1))
        if angle < camera.half_angle and abs(ray[2]) < min(0.8, abs(rng.normal(0, GATE_ELEVATION))):
            break
    away = side * view.focal_px / side_px
    return ray * away, float(side), float(side_px)


def axes(towards, looks, rng) -> tuple[np.ndarray, np.ndarray]:
    """Return the directions to the right and down (3,) of a gate that is seen in a direction (3,)."""
    oblique = np.radians(looks.most_oblique_deg) * rng.choice([-1, 1]) * rng.beta(1.0, 1.6)
    yaw = np.arctan2(towards[1], towards[0]) + oblique
    normal, right = np.array([np.cos(yaw), np.sin(yaw), 0.0]), np.array([np.sin(yaw), -np.cos(yaw), 0.0])
    down = np.array([0.0, 0.0, -1.0])
    roll, pitch = np.radians(rng.normal(0, looks.tilt_deg, 2)) * (rng.random(2) < 0.4)
    down = np.cos(pitch) * down + np.sin(pitch) * normal
    return np.cos(roll) * right + np.sin(roll) * down, np.cos(roll) * down - np.sin(roll) * right


def body(face: frames.Face, centre, directions, looks, rng) -> Body:
    """Return a gate with its thickness.

    Args:
        face: its front.
        centre: (3,) m.
        directions: to the right and down, see `axes`.
        looks: `CompositeLooks`.
        rng: generator.
    """
    picture = face.picture if rng.random() < 0.6 else scenes.with_shadow(face.picture, rng)
    front = Panel(np.asarray(centre), *directions, face.size, picture)
    panels = []
    if rng.random() < looks.thick_share:
        panels = sides(front, face, rng)
    openings = front.at(face.openings)
    return Body(float(np.linalg.norm(centre)), (*panels, front), front, openings)


def sides(front: Panel, face: frames.Face, rng) -> list[Panel]:
    """Return the back and the lateral faces of a gate, as far as they are seen, from the farthest to the nearest."""
    normal = np.cross(front.right, front.down)
    normal = normal * np.sign(normal @ front.centre)  # away from the camera
    inner = face.openings[0]
    deep = float(rng.uniform(0.02, 0.15) * np.linalg.norm(inner[1] - inner[0]))
    back = Panel(front.centre + deep * normal, front.right, front.down, front.size, front.picture)
    found = [back]
    half = np.array(face.size) / 2
    whole = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * half
    for rectangle, outwards in ((whole, 1), *((opening, -1) for opening in face.openings)):
        for k in range(4):
            a, b = front.at(rectangle[k]), front.at(rectangle[(k + 1) % 4])
            along = (b - a) / np.linalg.norm(b - a)
            middle = (a + b) / 2 + deep / 2 * normal
            facing = outwards * ((a + b) / 2 - front.at(rectangle.mean(axis=0)))
            if facing @ middle < 0:
                tone = np.full((8, 8), face.tone * rng.uniform(0.3, 1.1), np.float32)
                found.append(Panel(middle, along, normal, (float(np.linalg.norm(b - a)), deep), opaque(tone)))
    return found


def marker(gate: Body, tones, rng) -> Panel:
    """Return a square code that is fixed to a gate beside a corner or above its middle, in its plane."""
    front = gate.front
    code = (rng.random((8, 8)) < 0.5).astype(np.float32)
    code[[0, -1]] = code[:, [0, -1]] = rng.integers(2)
    picture = cv2.resize(tones[0] + (tones[1] - tones[0]) * code, (64, 64), interpolation=cv2.INTER_NEAREST)
    side = float(rng.uniform(0.1, 0.35) * np.linalg.norm(gate.openings[0, 1] - gate.openings[0, 0]))
    across = rng.choice([-1.0, 0.0, 1.0]) * (front.size[0] + side) / 2
    centre = front.at((across, -front.size[1] / 2 + rng.choice([-0.5, 0.5 * abs(np.sign(across))]) * side))
    return Panel(centre, front.right, front.down, (side, side), opaque(picture))


def posts(gate: Body, floor: float, tone: float, rng) -> tuple[Panel, ...]:
    """Return one or two posts below a gate, down to the floor, and their feet."""
    front = gate.front
    low = front.at((0.0, front.size[1] / 2))
    tall = low[2] - floor
    if tall < 0.05:
        return ()
    found = []
    wide = float(rng.uniform(0.02, 0.1))
    down = np.array([0.0, 0.0, -1.0])
    right = np.array([front.right[0], front.right[1], 0.0])
    right /= np.linalg.norm(right)
    picture = opaque(np.full((8, 8), tone * rng.uniform(0.4, 1.0), np.float32))
    for share in (-0.45, 0.45) if rng.random() < 0.7 else (0.0,):
        top = front.at((share * front.size[0], front.size[1] / 2)) / FAR_SIDE
        found.append(Panel(top + tall / 2 * down, right, down, (wide, tall), picture))
        if rng.random() < 0.5:
            foot = top + (tall - 0.03) * down
            found.append(Panel(foot, right, down, (wide * float(rng.uniform(3, 10)), 0.06), picture))
    return tuple(found)

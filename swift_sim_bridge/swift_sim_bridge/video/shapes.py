"""Gates, vehicle, shadow and trail as faces in the world. Colors are BGR."""

import cv2
import numpy as np

from swift_ros import geometry
from swift_ros.track import CORNER_SIGNS, Track
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.video.flight import Path3
from swift_sim_bridge.video.painter import Faces

AMBER, STEEL, GREEN, RED = (40, 160, 255), (190, 165, 140), (110, 220, 90), (60, 60, 235)
CARBON, BATTERY, LENS, FRONT, REAR = (46, 42, 40), (60, 190, 250), (240, 240, 240), (40, 120, 255), (225, 225, 225)
LIGHT = np.array([0.35, 0.25, 0.90])  # direction to the light of the vehicle's faces
PIECES = 5  # of each side of a gate, light and dark in turn
ROLL_AWAY_M = 1.6  # a gate nearer to the camera than this fades, so that it does not hide the vehicle
TRAIL_S = 9.0  # s; more than a lap, so that the line of the last lap is seen ahead
TRAIL_STEP_S = 0.03
TRAIL_HALF_WIDTH_M = 0.03
RIM = 20  # corners of a circle
TURN_PER_S = 40.0  # rad/s at which propellers are drawn to turn: slow enough to be seen at 30 frames a second


def gates(track: Track, colors, p_camera) -> Faces:
    """Return the frames of all gates.

    Args:
        track: the track.
        colors: (g, 3) of the gates.
        p_camera: (3,) m.
    """
    u = np.linspace(0, 4, 4 * PIECES + 1)
    ring = np.stack([np.interp(u, range(5), CORNER_SIGNS[[0, 1, 2, 3, 0], i]) for i in range(3)], axis=-1)
    along = np.array([track.half_depth, 0.0, 0.0])
    outer, inner = (0.5 * sides[:, None, None] * ring for sides in (track.outer_sides, track.inner_sides))
    strips = ((outer - along, inner - along), (outer + along, inner + along))
    strips += ((inner - along, inner + along), (outer - along, outer + along))
    quads = np.stack([np.stack([a[:, :-1], a[:, 1:], b[:, 1:], b[:, :-1]], axis=2) for a, b in strips], axis=1)
    world = np.einsum("gij,gsnkj->gsnki", track.rotations, quads) + track.positions[:, None, None, None]
    tone = np.where(np.arange(4 * PIECES) % 2, 1.0, 0.78) * np.array([1.0, 1.0, 0.62, 0.5])[:, None]
    shaded = np.asarray(colors, float)[:, None, None] * tone[None, :, :, None]
    faces = world.reshape(-1, 4, 3)
    near = np.linalg.norm(faces.mean(axis=1) - p_camera, axis=1) / ROLL_AWAY_M
    return Faces(faces, shaded.reshape(-1, 3), np.clip(near - 0.35, 0.0, 1.0))


def vehicle(craft: Vehicle, p_world, q_world_body, t: float) -> list[Faces]:
    """Return a quadrotor with the arms and propellers of a vehicle at a pose; front propellers are orange."""
    hubs = np.array([rotor.position for rotor in craft.rotors])
    span = np.linalg.norm(hubs[:, :2], axis=1).mean()
    boxes = [
        (_box([0.95 * span, 0.34 * span, 0.22 * span]), CARBON),
        (_box([0.62 * span, 0.28 * span, 0.20 * span]) + [-0.08 * span, 0.0, 0.21 * span], BATTERY),
        (_box([0.16 * span, 0.22 * span, 0.20 * span]) + [0.52 * span, 0.0, 0.10 * span], LENS),
    ]
    for hub in hubs:
        length, yaw = np.hypot(hub[0], hub[1]), np.arctan2(hub[1], hub[0])
        arm = _box([length, 0.12 * span, 0.07 * span]) + [0.5 * length, 0.0, 0.0]
        boxes.append((geometry.rotate(np.broadcast_to(geometry.quaternion_from_yaw(yaw), (6, 4, 4)), arm), CARBON))
        boxes.append((_box([0.2 * span, 0.2 * span, 0.24 * span]) + hub + [0, 0, 0.08 * span], CARBON))
    body = np.concatenate([faces for faces, _ in boxes])
    base = np.concatenate([np.broadcast_to(np.array(color, float), (6, 3)) for _, color in boxes])
    rotation = geometry.rotation_matrix(q_world_body)
    light = 0.62 + 0.38 * _normals(body) @ (rotation.T @ LIGHT)
    return [
        _placed(Faces(body, base * light[:, None], np.ones(len(body))), p_world, rotation),
        *(_placed(faces, p_world, rotation) for faces in _propellers(craft, hubs + [0, 0, 0.22 * span], t)),
    ]


def _propellers(craft: Vehicle, hubs, t: float) -> list[Faces]:
    angle = np.linspace(0, 2 * np.pi, RIM, endpoint=False)
    circle = craft.rotor_radius * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    discs, blades, colors = [], [], []
    for hub, rotor in zip(hubs, craft.rotors, strict=True):
        discs.append(hub + circle)
        colors.append(FRONT if hub[0] > 0 else REAR)
        turn = rotor.spin * TURN_PER_S * t
        along = craft.rotor_radius * np.array([np.cos(turn), np.sin(turn), 0.0])
        across = 0.11 * np.array([-along[1], along[0], 0.0])
        blades.append(hub + np.stack([-along - across, along - across, along + across, across - along]))
    colors = np.array(colors, float)
    return [
        Faces(np.array(discs), colors, np.full(len(hubs), 0.38)),
        Faces(np.array(blades), 0.75 * colors, np.full(len(hubs), 0.8)),
    ]


def _box(size) -> np.ndarray:
    """Return the faces (6, 4, 3) of a box around the origin, their corners counter-clockwise seen from outside."""
    square = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    faces = []
    for axis in range(3):
        for side in (1.0, -1.0):
            ring = np.insert(square, 0, 1.0, axis=1)[:: int(side)] * [side, 1.0, 1.0]
            faces.append(np.roll(ring, axis, axis=1))
    return 0.5 * np.array(faces) * size


def _normals(faces) -> np.ndarray:
    return geometry.normalize(np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 1]))


def _placed(faces: Faces, p_world, rotation) -> Faces:
    return faces._replace(corners=faces.corners @ rotation.T + p_world)


def shadow(craft: Vehicle, p_world, floor_m: float) -> Faces:
    """Return the soft shadow of a vehicle straight below it, fainter the higher it flies."""
    angle = np.linspace(0, 2 * np.pi, RIM, endpoint=False)
    rim = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    height = max(p_world[2] - floor_m, 0.0)
    below = np.array([p_world[0], p_world[1], floor_m])
    sizes = craft.hull_radius * (1.0 + 0.15 * height) * np.array([1.25, 1.0, 0.75])
    faces = below + sizes[:, None, None] * rim
    return Faces(faces, np.zeros((3, 3)), np.full(3, 0.22 / (1.0 + 0.2 * height)))


def trail(path: Path3, t: float, p_camera, fastest: float) -> Faces:
    """Return the path flown before a time, coloured by speed (blue to yellow), fading with its age.

    Args:
        path: of the vehicle.
        t: s.
        p_camera: (3,) m; the band faces it.
        fastest: m/s, of the brightest color.
    """
    count = int(min(TRAIL_S, max(t - path.t[0], 0.0)) / TRAIL_STEP_S)
    times = t - TRAIL_STEP_S * np.arange(count + 1)
    times[1:] = np.floor(times[1:] / TRAIL_STEP_S) * TRAIL_STEP_S + TRAIL_STEP_S  # joints stay where they are
    flown = path.at(np.maximum(times, path.t[0]))
    p, speed = flown.p_world, np.linalg.norm(flown.v_world, axis=1)
    side = TRAIL_HALF_WIDTH_M * geometry.normalize(np.cross(p[:-1] - p[1:], p[1:] - p_camera))
    corners = np.stack([p[:-1] - side, p[:-1] + side, p[1:] + side, p[1:] - side], axis=1)
    fresh = 1.0 - (t - times[1:]) / TRAIL_S
    return Faces(corners, speed_colors(speed[1:], fastest), 0.85 * np.clip(fresh, 0.0, 1.0) ** 1.5)


def speed_colors(speed, fastest: float) -> np.ndarray:
    """Return the colors (n, 3) of speeds (n,) m/s."""
    levels = np.clip(40 + 215 * np.asarray(speed) / fastest, 0, 255).astype(np.uint8)
    return cv2.applyColorMap(levels[:, None], cv2.COLORMAP_VIRIDIS)[:, 0].astype(float)

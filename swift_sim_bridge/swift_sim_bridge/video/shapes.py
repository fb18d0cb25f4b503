"""Gates, vehicle, shadow and trail as faces in the world. Colors are BGR."""

import cv2
import numpy as np

from swift_ros import geometry
from swift_ros.track import CORNER_SIGNS, Track
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.video.flight import Path3
from swift_sim_bridge.video.painter import Faces

AMBER, STEEL, GREEN, RED = (40, 160, 255), (190, 165, 140), (110, 220, 90), (60, 60, 235)
BLUE = (255, 110, 60)  # differs from green and amber for colour-blind eyes too
CARBON, BATTERY, LENS, FRONT, REAR = (74, 68, 64), (60, 190, 250), (250, 250, 250), (40, 120, 255), (235, 235, 235)
SPEED_COLORS = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], cv2.COLORMAP_VIRIDIS)[:, 0].astype(float)
LIGHT = np.array([0.35, 0.25, 0.90])  # direction to the light of the vehicle's faces
PIECES = 5  # of each side of a gate, light and dark in turn
FADE_M = 1.6  # a gate or a trail nearer to the camera than this fades, so that it does not hide the vehicle
TRAIL_S = 9.0  # s; more than a lap, so that the line of the last lap is seen ahead
TRAIL_STEP_S = 0.03
TRAIL_HALF_WIDTH_M = 0.02
TRAIL_BEGIN_S = 0.08  # s behind the vehicle, which the trail must not hide
BLADE = 0.11  # width of a blade as a share of its length
TURN_PER_S = 40.0  # rad/s at which propellers are drawn to turn: slow enough to be seen at 30 frames a second
_ANGLES = np.linspace(0, 2 * np.pi, 20, endpoint=False)
RIM = np.stack([np.cos(_ANGLES), np.sin(_ANGLES), 0 * _ANGLES], axis=-1)  # a circle of radius 1


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
    near = np.linalg.norm(faces.mean(axis=1) - p_camera, axis=1) / FADE_M
    return Faces(faces, shaded.reshape(-1, 3), np.clip(near - 0.35, 0.0, 1.0))


class Craft:
    """A quadrotor with the arms and propellers of a vehicle; its front propellers are orange."""

    def __init__(self, vehicle: Vehicle):
        """Make its faces in the body frame, sized by the distance of its rotors from the centre."""
        self._vehicle = vehicle
        hubs = np.array([rotor.position for rotor in vehicle.rotors])
        span = np.linalg.norm(hubs[:, :2], axis=1).mean()
        boxes = [
            (_box([0.95 * span, 0.34 * span, 0.22 * span]), CARBON),
            (_box([0.62 * span, 0.28 * span, 0.20 * span]) + [-0.08 * span, 0.0, 0.21 * span], BATTERY),
            (_box([0.16 * span, 0.22 * span, 0.20 * span]) + [0.52 * span, 0.0, 0.10 * span], LENS),
        ]
        for hub in hubs:
            length, yaw = np.hypot(hub[0], hub[1]), np.arctan2(hub[1], hub[0])
            turn = geometry.rotation_matrix(geometry.quaternion_from_yaw(yaw))
            arm = _box([length, 0.12 * span, 0.07 * span]) + [0.5 * length, 0.0, 0.0]
            boxes.append((arm @ turn.T, CARBON))
            boxes.append((_box([0.2 * span, 0.2 * span, 0.24 * span]) + hub + [0.0, 0.0, 0.08 * span], CARBON))
        self._body = np.concatenate([faces for faces, _ in boxes])
        self._colors = np.repeat(np.array([color for _, color in boxes], float), 6, axis=0)
        self._normals = geometry.normalize(
            np.cross(self._body[:, 1] - self._body[:, 0], self._body[:, 2] - self._body[:, 1])
        )
        self._hubs = hubs + [0.0, 0.0, 0.22 * span]
        self._propeller_colors = np.array([FRONT if hub[0] > 0 else REAR for hub in hubs], float)

    def faces(self, p_world, q_world_body, t: float) -> list[Faces]:
        """Return the faces in the world at a pose and a time (s), which turns the propellers."""
        rotation = geometry.rotation_matrix(q_world_body)
        light = 0.62 + 0.38 * self._normals @ (rotation.T @ LIGHT)
        body = Faces(self._body, self._colors * light[:, None], np.ones(len(self._body)))
        return [faces._replace(corners=faces.corners @ rotation.T + p_world) for faces in (body, *self._propellers(t))]

    def _propellers(self, t: float) -> tuple[Faces, Faces]:
        """Return their blurred discs, and the blades."""
        radius, count = self._vehicle.rotor_radius, len(self._hubs)
        turn = TURN_PER_S * t * np.array([rotor.spin for rotor in self._vehicle.rotors])
        along = radius * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=-1)
        across = BLADE * along[:, [1, 0, 2]] * [-1.0, 1.0, 1.0]
        blades = np.stack([-along - across, along - across, along + across, across - along], axis=1)
        discs = self._hubs[:, None] + radius * RIM
        return (
            Faces(discs, self._propeller_colors, np.full(count, 0.45)),
            Faces(self._hubs[:, None] + blades, 0.75 * self._propeller_colors, np.full(count, 0.8)),
        )


def _box(size) -> np.ndarray:
    """Return the faces (6, 4, 3) of a box around the origin, their corners counter-clockwise seen from outside."""
    square = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    faces = []
    for axis in range(3):
        for side in (1.0, -1.0):
            ring = np.insert(square, 0, 1.0, axis=1)[:: int(side)] * [side, 1.0, 1.0]
            faces.append(np.roll(ring, axis, axis=1))
    return 0.5 * np.array(faces) * size


def shadow(vehicle: Vehicle, p_world, floor_m: float) -> Faces:
    """Return the soft shadow of a vehicle straight below it, fainter the higher it flies."""
    height = max(p_world[2] - floor_m, 0.0)
    below = np.array([p_world[0], p_world[1], floor_m])
    sizes = vehicle.hull_radius * (1.0 + 0.15 * height) * np.array([1.25, 1.0, 0.75])
    faces = below + sizes[:, None, None] * RIM
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
    age = t - times[1:]
    opacity = 0.85 * np.clip(1.0 - age / TRAIL_S, 0.0, 1.0) ** 1.5 * np.clip(age / TRAIL_BEGIN_S, 0.0, 1.0)
    near = np.linalg.norm(p[1:] - p_camera, axis=1) / FADE_M
    return Faces(corners, speed_colors(speed[1:], fastest), opacity * np.clip(near, 0.0, 1.0))


def speed_colors(speed, fastest: float) -> np.ndarray:
    """Return the colors (n, 3) of speeds (n,) m/s."""
    return SPEED_COLORS[np.clip(40 + 215 * np.asarray(speed) / fastest, 0, 255).astype(np.uint8)]

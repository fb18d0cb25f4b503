"""Random tracks and camera poses for the detector's training images.

Most poses are racing poses: on a smooth line through two consecutive gates, with the attitude whose thrust gives the
line its curvature (tilted by 30 to 105 degrees) and the nose roughly along the flight. The others are anywhere.
"""

from dataclasses import replace

import numpy as np

from swift_ros import geometry
from swift_ros.track import Gate
from swift_sim_bridge.rendering.motion import BodyMotion

GRAVITY = 9.81  # m/s^2; not `vehicle.GRAVITY`, so that the drawn images stay the same
MAX_OFF_AXIS_DEG = 75.0  # a gate this far from the optical axis is still inside the image circle
MAX_DISTANCE_M = 16.0  # beyond, gates do not count


def random_track(track, rng, most_gates: int = 7):
    """Return a copy of `track` with 1 to `most_gates` gates at random places in its volume, at least 2.5 m apart."""
    low, high = np.array(track.bounds_min), np.array(track.bounds_max)
    low, high = low + [1.5, 1.5, 0.8], high - [1.5, 1.5, 1.5]
    places = []
    count = rng.integers(1, most_gates + 1)
    while len(places) < count:
        place = rng.uniform(low, high)
        if rng.random() < 0.6:
            place[2] = low[2] + rng.exponential(0.6)  # most gates of a track stand on the floor
        place[2] = min(place[2], high[2])
        if all(np.linalg.norm(place - other) > 2.5 for other in places):
            places.append(place)
    return replace(track, gates=tuple(Gate(tuple(place), rng.uniform(-180, 180)) for place in places))


def _attitude(up, nose):
    """Return q_world_body with z along `up` and x as close to `nose` as possible."""
    up = geometry.normalize(up)
    forward = nose - up * np.dot(nose, up)
    if np.linalg.norm(forward) < 1e-3:
        forward = np.cross(up, [0.31, 0.52, 0.79])
    forward = geometry.normalize(forward)
    return geometry.quaternion_from_matrix(np.stack([forward, np.cross(up, forward), up], axis=1))


def _hermite(u, p0, p1, m0, m1):
    """Return position, first and second derivative at u (0..1) of the cubic with ends p0, p1 and end slopes m0, m1."""
    p = (2 * u**3 - 3 * u**2 + 1) * p0 + (u**3 - 2 * u**2 + u) * m0 + (3 * u**2 - 2 * u**3) * p1 + (u**3 - u**2) * m1
    d = 6 * (u**2 - u) * p0 + (3 * u**2 - 4 * u + 1) * m0 - 6 * (u**2 - u) * p1 + (3 * u**2 - 2 * u) * m1
    dd = (12 * u - 6) * p0 + (6 * u - 4) * m0 - (12 * u - 6) * p1 + (6 * u - 2) * m1
    return p, d, dd


def racing_pose(track, rng) -> BodyMotion:
    """Return a pose on a fast line from a random gate of the track through the next."""
    count = len(track.gates)
    i = int(rng.integers(0, count))
    j = (i + 1) % count
    start = track.positions[i] if count > 1 else rng.uniform(track.bounds_min, track.bounds_max)
    leave, arrive = track.rotations[i][:, 0], track.rotations[j][:, 0]
    speed = rng.uniform(6.0, 19.0)
    duration = max(np.linalg.norm(track.positions[j] - start) * rng.uniform(1.0, 1.3) / speed, 0.25)
    bend = speed * duration
    p, d, dd = _hermite(rng.uniform(0, 1), start, track.positions[j], bend * leave, bend * arrive)
    pull = dd / duration**2 + [0, 0, GRAVITY] + rng.normal(0, 3, 3)
    pull *= min(1.0, 45.0 / np.linalg.norm(pull))
    velocity = d / duration
    turn = geometry.quaternion_from_rotation_vector(geometry.normalize(pull) * np.radians(rng.normal(0, 45)))
    q = _attitude(pull, geometry.rotate(turn, geometry.normalize(velocity)))
    place = np.clip(p + rng.normal(0, 0.3, 3), np.add(track.bounds_min, 0.2), np.subtract(track.bounds_max, 0.2))
    return BodyMotion(place, q, velocity, np.clip(rng.normal(0, 4, 3), -10, 10))


def random_pose(track, rng) -> BodyMotion:
    """Return a pose at a random distance and side of a random gate, with a random tilt."""
    gate = rng.integers(0, len(track.gates))
    normal = track.rotations[gate][:, 0] * rng.choice([-1.0, 1.0])
    direction = geometry.normalize(normal + rng.normal(0, 0.6, 3) * [1, 1, 0.4])
    place = track.positions[gate] + direction * np.exp(rng.uniform(*np.log([0.7, 16.0])))
    place = np.clip(place, np.add(track.bounds_min, 0.2), np.subtract(track.bounds_max, 0.2))
    tilt, bearing = np.radians(rng.uniform(0, 105)), rng.uniform(-np.pi, np.pi)
    up = np.array([np.sin(tilt) * np.cos(bearing), np.sin(tilt) * np.sin(bearing), np.cos(tilt)])
    nose = track.positions[gate] - place + rng.normal(0, 3, 3)
    velocity = rng.normal(0, 6, 3)
    return BodyMotion(place, _attitude(up, geometry.normalize(nose)), velocity, np.clip(rng.normal(0, 3, 3), -10, 10))


def draw(track, camera, racing_share: float, rng, tries: int = 6) -> BodyMotion:
    """Return a random pose with a gate in view; after `tries` draws without one, the last draw.

    Args:
        track: of the gates.
        camera: the lens and its mount.
        racing_share: share of racing poses.
        rng: generator.
        tries: largest number of draws.
    """
    for _ in range(tries):
        pose = racing_pose(track, rng) if rng.random() < racing_share else random_pose(track, rng)
        q_world_camera = geometry.quaternion_multiply(pose.q_world_body, camera.q_body_camera)
        axis = geometry.rotation_matrix(q_world_camera)[:, 2]
        towards = geometry.normalize(track.positions - pose.p_world)
        near = np.linalg.norm(track.positions - pose.p_world, axis=-1) < MAX_DISTANCE_M
        if np.any(near & (towards @ axis > np.cos(np.radians(MAX_OFF_AXIS_DEG)))):
            break
    return pose

"""A race without a simulator, for the tests of the estimator: a smooth path through the gates, odometry with the drift
of a T265, and the corners that a detector finds in each image."""

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from swift_ros import configuration, geometry
from swift_ros.camera.model import Camera, project, world_to_camera
from swift_ros.corner_rays import ORDER_FROM_BEHIND
from swift_ros.estimation.estimator import StateEstimator
from swift_ros.estimation.settings import EstimatorSettings
from swift_ros.perception.gate_pose import GatePoses, GatePoseSettings
from swift_ros.track import Track
from swift_ros.types import GateCorners, Odometry

CONFIG = Path(__file__).resolve().parents[2] / "config"
CAMERA = configuration.load(Camera, CONFIG / "camera.yaml")
TRACK = configuration.load(Track, CONFIG / "track.yaml")
GRAVITY = np.array([0.0, 0.0, -9.81])
RATE = 100
LATENCY_NS = round(CAMERA.processing_latency * 1e9)


def settings(section: str, settings_type, **changes):
    """Return the shipped settings of a node with some changes."""
    content = configuration.read_yaml(CONFIG / "nodes.yaml")[section]
    return replace(configuration.build(settings_type, content, section), **changes)


@dataclass(frozen=True)
class Truth:
    """A flight in ticks of 10 ms: stamps_ns (n,), p_map (n, 3), q_map_body (n, 4), v_map (n, 3), omega_body (n, 3)."""

    stamps_ns: np.ndarray
    p_map: np.ndarray
    q_map_body: np.ndarray
    v_map: np.ndarray
    omega_body: np.ndarray

    def odometry(self, i: int) -> Odometry:
        v_body = geometry.rotate_inverse(self.q_map_body[i], self.v_map[i])
        return Odometry(int(self.stamps_ns[i]), self.p_map[i], self.q_map_body[i], v_body, self.omega_body[i])


@lru_cache
def race(laps: int = 1, speed: float = 13.0, at_rest_s: float = 1.0) -> Truth:
    """Return a flight from the podium through all gates: at rest, then along a spline at up to `speed` m/s."""
    points = [np.array(TRACK.start)]
    for _ in range(laps):
        for position, rotation in zip(TRACK.positions, TRACK.rotations, strict=True):
            points += [position - 1.2 * rotation[:, 0], position + 1.2 * rotation[:, 0]]
    points = np.array(points)
    chord = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    spline = CubicSpline(chord, points)
    fine = np.linspace(0.0, chord[-1], 4000 * laps)
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(spline(fine), axis=0), axis=1))])
    return _attitude_along(*_fly(spline, fine, length, speed, at_rest_s))


def _fly(spline, fine, length, speed, at_rest_s):
    """Return positions, velocities and accelerations along the path, slower where its curvature is large."""
    curvature = _smooth(np.linalg.norm(spline(fine, 2), axis=1), 60)
    allowed = np.minimum(speed, np.sqrt(22.0 / np.maximum(curvature, 1e-3)))
    allowed = _smooth(np.minimum(allowed, np.sqrt(2 * 12.0 * length + 0.01)), 40)
    time = np.concatenate([[0.0], np.cumsum(np.diff(length) / (0.5 * (allowed[1:] + allowed[:-1])))])
    ticks = np.arange(0.0, time[-1], 1 / RATE)
    flown = spline(np.interp(ticks, time, fine))
    rest = np.repeat(flown[:1], int(at_rest_s * RATE), axis=0)
    p = np.concatenate([rest, flown])
    for _ in range(2):
        p = np.stack([_smooth(p[:, axis], 9) for axis in range(3)], axis=1)
    v = np.gradient(p, 1 / RATE, axis=0)
    return p, v, np.gradient(v, 1 / RATE, axis=0)


def _smooth(values, width):
    padded = np.pad(values, width // 2, mode="edge")
    return np.convolve(padded, np.ones(width) / width, mode="same")[width // 2 : width // 2 + len(values)]


def _attitude_along(p, v, a) -> Truth:
    """Return the flight with the thrust along the body's z axis and the body's x axis along the track."""
    up = geometry.normalize(a + 0.3 * v - GRAVITY)
    ahead = v + 0.5 * np.array([np.cos(np.radians(TRACK.start_yaw_deg)), np.sin(np.radians(TRACK.start_yaw_deg)), 0.0])
    left = geometry.normalize(np.cross(up, ahead))
    for i in range(1, len(left)):  # no half turns of the heading where the path is parallel to the thrust
        if left[i] @ left[i - 1] < 0:
            left[i:] *= -1
    left = geometry.normalize(np.stack([_smooth(left[:, axis], 15) for axis in range(3)], axis=1))
    left = geometry.normalize(left - np.sum(left * up, axis=1, keepdims=True) * up)
    q = geometry.quaternion_from_matrix(np.stack([np.cross(left, up), left, up], axis=2))
    turn = geometry.quaternion_multiply(geometry.quaternion_conjugate(q[:-1]), q[1:])
    omega = geometry.rotation_vector_from_quaternion(turn) * RATE
    stamps = np.arange(len(p)) * 10_000_000
    return Truth(stamps, p, q, v, np.concatenate([omega, omega[-1:]]))


@dataclass(frozen=True)
class Drift:
    """Errors of odometry.

    Attributes:
        walk: m per square root of a metre of path; jumps of the position, which the velocity does not have.
        rate_share: velocity error as a share of the speed, in position and velocity.
        rate_memory_s: s, its correlation time.
        scale: standard deviation of the scale error.
        noise: m, white noise of the position.
        velocity_share: further, white noise of the velocity as a share of the speed.
        tilt_deg: deg, standard deviation of roll and pitch errors.
        tilt_memory_s: s, their correlation time.
        yaw_walk_deg: deg per square root of a second.
        start_yaw_deg: deg, standard deviation of the heading error at the start.
        coupled: whether a heading error also rotates the path, as in real odometry.
        rotation_ref: rad/s, body rate at which the variance of `walk` and `rate_share` is doubled.
    """

    walk: float = 0.019
    rate_share: float = 0.021
    rate_memory_s: float = 0.6
    scale: float = 0.0
    noise: float = 0.005
    velocity_share: float = 0.01
    tilt_deg: float = 0.5
    tilt_memory_s: float = 2.0
    yaw_walk_deg: float = 0.3
    start_yaw_deg: float = 0.5
    coupled: bool = False
    rotation_ref: float = np.inf


def odometry(truth: Truth, drift: Drift, seed: int) -> list[Odometry]:
    """Return odometry of the flight, in the map at the start."""
    rng = np.random.default_rng([seed, 1])
    count, dt = len(truth.p_map), 1 / RATE
    step = np.diff(truth.p_map, axis=0, prepend=truth.p_map[:1])
    path = np.linalg.norm(step, axis=1)
    tilt = _markov(rng, count, dt, np.radians(drift.tilt_deg), drift.tilt_memory_s, 3)
    yaw = np.radians(drift.start_yaw_deg) * rng.standard_normal() + np.cumsum(
        np.radians(drift.yaw_walk_deg) * np.sqrt(dt) * rng.standard_normal(count)
    )
    heading = geometry.quaternion_from_yaw(yaw)
    slow = _markov(rng, count, dt, drift.rate_share, drift.rate_memory_s, 3)
    growth = np.sqrt(1.0 + np.linalg.norm(truth.omega_body, axis=1, keepdims=True) / drift.rotation_ref)
    walk = growth * drift.walk * np.sqrt(path)[:, None] * rng.standard_normal((count, 3))
    scale = 1 + drift.scale * rng.standard_normal()
    moved = scale * step + walk + growth * slow * path[:, None]
    v = scale * truth.v_map + growth * slow * np.linalg.norm(truth.v_map, axis=1, keepdims=True)
    if drift.coupled:
        moved, v = geometry.rotate(heading, moved), geometry.rotate(heading, v)
    p = truth.p_map[0] + np.cumsum(moved, axis=0) + drift.noise * rng.standard_normal((count, 3))
    q = geometry.quaternion_multiply(geometry.quaternion_from_rotation_vector(tilt), truth.q_map_body)
    q = geometry.quaternion_multiply(heading, q)
    v = geometry.rotate_inverse(q, v)
    v = v + drift.velocity_share * np.linalg.norm(v, axis=1, keepdims=True) * rng.standard_normal((count, 3))
    return [
        Odometry(int(truth.stamps_ns[i]), p[i], geometry.normalize(q[i]), v[i], truth.omega_body[i])
        for i in range(count)
    ]


def _markov(rng, count, dt, sigma, memory, size):
    keep = np.exp(-dt / memory)
    values = np.empty((count, size))
    values[0] = sigma * rng.standard_normal(size)
    kicks = sigma * np.sqrt(1 - keep**2) * rng.standard_normal((count, size))
    for i in range(1, count):
        values[i] = keep * values[i - 1] + kicks[i]
    return values


def visible_gates(p_map, q_map_body) -> list[tuple[int, np.ndarray]]:
    """Return (index, corners (4, 2) px in their order in the image) of the gates that a detector can find.

    These are whole in the image, within 16 m, have sides of 9 px or more and are seen at less than 78 degrees.
    """
    seen = []
    for index, (corners, centre) in enumerate(zip(TRACK.corners, TRACK.positions, strict=True)):
        view = p_map - centre
        along = view @ TRACK.rotations[index][:, 0]
        distance = np.linalg.norm(view)
        if distance > 16.0 or abs(along) < np.cos(np.radians(78.0)) * distance:
            continue
        ordered = corners[ORDER_FROM_BEHIND] if along > 0 else corners
        pixels, theta = project(CAMERA, world_to_camera(CAMERA, p_map, q_map_body, ordered))
        inside = np.all((pixels > 1) & (pixels < [CAMERA.width - 2, CAMERA.height - 2]))
        sides = np.linalg.norm(pixels - np.roll(pixels, 1, axis=0), axis=1)
        if inside and theta.max() < CAMERA.half_angle and sides.min() >= 9.0:
            seen.append((index, pixels))
    return seen


@dataclass(frozen=True)
class Detector:
    """Errors of a detector.

    Attributes:
        sigma_px: px, noise of a corner.
        outliers: share of gates with one corner `outlier_px` off.
        outlier_px: px.
        found: share of gates that are detected.
        false_gates: share of images with a false gate.
        bias_px: px, standard deviation of an error of each corner that is the same in all images.
        blurred: share of gates whose corners have five times the noise.
        delay_s: s, from an image's stamp to its exposure.
        readout_s: s, from the exposure of the first row to that of the last one; the stamp is that of the middle.
    """

    sigma_px: float = 0.7
    outliers: float = 0.03
    outlier_px: float = 15.0
    found: float = 0.9
    false_gates: float = 0.01
    bias_px: float = 0.0
    blurred: float = 0.0
    delay_s: float = 0.0
    readout_s: float = 0.0

    def confidence(self, blur: float) -> np.ndarray:
        """Return that of four corners (4,) whose noise is `blur` times as large.

        In recorded races the standard deviation of a corner is 0.1 degrees / confidence^1.5.
        """
        sigma_deg = np.degrees(np.hypot(blur * self.sigma_px, self.bias_px) / CAMERA.fx)
        return np.full(4, min(1.0, (0.1 / sigma_deg) ** (2.0 / 3.0)))


def exposed(truth: Truth, i: int, gate: int, pixels, detector: Detector) -> np.ndarray:
    """Return the corners (4, 2) px of a gate when their rows are exposed; `pixels` (4, 2) are those at tick i."""
    if not detector.delay_s and not detector.readout_s:
        return pixels
    behind = (truth.p_map[i] - TRACK.positions[gate]) @ TRACK.rotations[gate][:, 0] > 0
    corners = TRACK.corners[gate][ORDER_FROM_BEHIND] if behind else TRACK.corners[gate]
    for _ in range(3):  # the time depends on the row, and the row on the time
        late_s = detector.delay_s + detector.readout_s * ((pixels[:, 1] + 0.5) / CAMERA.height - 0.5)
        places = truth.p_map[i] + late_s[:, None] * truth.v_map[i]
        turns = [geometry.integrate_quaternion(truth.q_map_body[i], truth.omega_body[i], dt) for dt in late_s]
        seen = [world_to_camera(CAMERA, *pose) for pose in zip(places, turns, corners, strict=True)]
        pixels = project(CAMERA, np.array(seen))[0]
    return pixels


def images(truth: Truth, detector: Detector, seed: int) -> dict[int, list[GateCorners]]:
    """Return the detected gates of each image by the index of its tick."""
    rng = np.random.default_rng([seed, 2])
    biases = detector.bias_px * np.random.default_rng([seed, 3]).standard_normal((len(TRACK.gates), 4, 2))
    answers = {}
    for i in range(len(truth.p_map)):
        if int(i * 0.3 + 1e-9) == int((i - 1) * 0.3 + 1e-9):
            continue
        gates = []
        for gate, pixels in visible_gates(truth.p_map[i], truth.q_map_body[i]):
            if rng.random() > detector.found:
                continue
            pixels = exposed(truth, i, gate, pixels, detector) + biases[gate]
            blur = 5.0 if detector.blurred and rng.random() < detector.blurred else 1.0
            pixels = pixels + blur * detector.sigma_px * rng.standard_normal((4, 2))
            if rng.random() < detector.outliers:
                angle = rng.uniform(0, 2 * np.pi)
                pixels[rng.integers(4)] += detector.outlier_px * np.array([np.cos(angle), np.sin(angle)])
            gates.append(GateCorners(pixels, detector.confidence(blur)))
        if rng.random() < detector.false_gates:
            side = rng.uniform(10, 60)
            square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * side / 2
            corners = rng.uniform(100, 280, 2) + square + rng.standard_normal((4, 2))
            gates.append(GateCorners(corners, detector.confidence(1.0)))
        answers[i] = gates
    return answers


def gate_poses(camera: Camera = CAMERA) -> GatePoses:
    return GatePoses(settings("gate_pose", GatePoseSettings), camera, TRACK.inner_side)


@lru_cache
def poses_seen(detector: Detector, seed: int, camera: Camera = CAMERA, at_rest_s: float = 1.0) -> dict:
    """Return the gate poses of each image of the one-lap race by the index of its tick, for an assumed camera."""
    truth, core = race(at_rest_s=at_rest_s), gate_poses(camera)
    found = images(truth, detector, seed)
    return {i: core.locate(int(truth.stamps_ns[i]), gates)[0] for i, gates in found.items()}


@dataclass(frozen=True)
class Flown:
    """The estimated one-lap race.

    Attributes:
        states: of each tick.
        updates: of each gate.
        errors: (n, 3) m, of the position.
        attitude_errors: (n,) rad.
        raw_rmse: m, RMS position error of the odometry.
    """

    states: list
    updates: list
    errors: np.ndarray
    attitude_errors: np.ndarray
    raw_rmse: float

    @property
    def rmse(self) -> float:
        return float(np.sqrt(np.mean(np.sum(self.errors**2, axis=1))))

    @property
    def nees(self) -> float:
        """Mean squared error in units of the estimated covariance; 3 for a consistent filter."""
        covariances = np.array([state.covariance_pose[:3, :3] for state in self.states])
        weighted = np.linalg.solve(covariances, self.errors[..., None])[..., 0]
        return float(np.mean(np.sum(self.errors * weighted, axis=1)))


def estimate(drift=Drift(), detector=Detector(), seed: int = 1, late_ns: int = 0, ticks=None, **changes) -> Flown:
    """Return the one-lap race by the estimator in lockstep.

    Args:
        drift: of the odometry.
        detector: of the gates.
        seed: of all errors.
        late_ns: added to the stamps of the images.
        ticks: length of the flight; None for the whole lap.
        changes: of the estimator's settings.
    """
    truth = race()
    raw, seen = odometry(truth, drift, seed), poses_seen(detector, seed)
    core = StateEstimator(settings("state_estimator", EstimatorSettings, **changes), TRACK, CAMERA, lockstep=True)
    outputs = []
    for i, sample in enumerate(raw[:ticks]):
        outputs.append(core.odometry(sample))
        if i in seen:
            outputs.append(core.gates(sample.stamp_ns + late_ns, seen[i]))
    states = [state for output in outputs for state in output.states]
    updates = [update for output in outputs for _, group in output.updates for update in group]
    turn = geometry.quaternion_multiply(
        geometry.quaternion_conjugate(truth.q_map_body[: len(states)]),
        np.array([state.q_world_body for state in states]),
    )
    return Flown(
        states,
        updates,
        np.array([state.p_world for state in states]) - truth.p_map[: len(states)],
        np.linalg.norm(geometry.rotation_vector_from_quaternion(turn), axis=1),
        float(np.sqrt(np.mean(np.sum((np.array([o.p_world for o in raw]) - truth.p_map) ** 2, axis=1)))),
    )

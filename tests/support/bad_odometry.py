"""Odometry that fails in flight or at rest: noise, jumps, ramps, frozen and replayed samples, then true ones."""

from dataclasses import dataclass, replace

import numpy as np
from synthetic_flight import GRAVITY, RATE, Drift, Truth, odometry, race

from swift_ros import geometry
from swift_ros.types import ImuSample, Odometry

TICK_NS = 10_000_000
KINDS = (
    "noise of the position",
    "noise of everything",
    "a jump and back",
    "jumps between two places",
    "a ramp of the position",
    "a ramp with its velocity",
    "frozen",
    "frozen without motion",
    "replayed",
    "replayed and shifted",
    "another scale",
    "turned axes",
    "an absurd position",
)


@dataclass(frozen=True)
class BadFlight:
    """A flight whose odometry fails from tick `begin` to tick `end`.

    Attributes:
        kind: one of KINDS.
        true: odometry without the failure.
        given: odometry with it.
        imu: samples at the same stamps.
        begin: first bad tick.
        end: first good tick after it.
    """

    kind: str
    true: list[Odometry]
    given: list[Odometry]
    imu: list[ImuSample]
    begin: int
    end: int


def imu_samples(truth: Truth, seed: int) -> list[ImuSample]:
    """Return IMU samples of a flight: rates and specific forces with noise and constant errors."""
    rng = np.random.default_rng([seed, 2])
    a_map = np.gradient(truth.v_map, 1 / RATE, axis=0)
    force = geometry.rotate_inverse(truth.q_map_body, a_map - GRAVITY) + rng.normal(0.0, 0.15, 3)
    force = force + rng.normal(0.0, 0.3, force.shape)
    omega = 0.5 * (truth.omega_body + np.roll(truth.omega_body, 1, axis=0))  # those of the truth are of the next tick
    rate = omega + rng.normal(0.0, 0.01, 3) + rng.normal(0.0, 0.02, truth.omega_body.shape)
    return [ImuSample(int(t), w, f) for t, w, f in zip(truth.stamps_ns, rate, force, strict=True)]


def bad_flight(seed: int) -> BadFlight:
    """Draw a failure in flight or, in every third draw, at rest."""
    rng = np.random.default_rng([seed, 3])
    truth = race(laps=1, at_rest_s=6.0)
    true = odometry(
        truth, Drift(walk=0.028, rate_share=0.0072, velocity_share=0.006, coupled=True), seed
    )  # of simulation.yaml
    first = 100 if seed % 3 == 0 else 750
    begin = int(rng.integers(first, first + (200 if seed % 3 == 0 else len(true) - 1150)))
    end = begin + int(rng.integers(5, 150))
    kind = KINDS[int(rng.integers(len(KINDS)))]
    bad = _failed(kind, true, begin, end, rng)
    return BadFlight(kind, true, true[:begin] + bad + true[end:], imu_samples(truth, seed), begin, end)


def _failed(kind: str, true: list[Odometry], begin: int, end: int, rng) -> list[Odometry]:
    """Return the failed samples of the ticks from `begin` to `end`."""
    size, way = 10.0 ** rng.uniform(0.0, 1.3), rng.normal(size=3)
    way, rows, stamps = way / np.linalg.norm(way), true[begin:end], [row.stamp_ns for row in true[begin:end]]
    if kind == "noise of the position":
        return [replace(row, p_world=row.p_world + rng.uniform(-size, size, 3)) for row in rows]
    if kind == "noise of everything":
        return [_noisy(row, size, rng) for row in rows]
    if kind == "a jump and back":
        return [replace(row, p_world=row.p_world + size * way) for row in rows]
    if kind == "jumps between two places":
        return [replace(row, p_world=row.p_world + (i // 7 % 2) * size * way) for i, row in enumerate(rows)]
    if kind == "a ramp of the position":
        return [replace(row, p_world=row.p_world + size * way * i / RATE) for i, row in enumerate(rows)]
    if kind == "a ramp with its velocity":
        # slower ones are within the errors of dead reckoning at racing speed; gates correct them
        return [_sliding(row, max(size, 2.5) * way, i / RATE) for i, row in enumerate(rows)]
    if kind == "frozen":
        return [replace(true[begin - 1], stamp_ns=stamp) for stamp in stamps]
    if kind == "frozen without motion":
        still = replace(true[begin - 1], v_body=np.zeros(3), omega_body=np.zeros(3))
        return [replace(still, stamp_ns=stamp) for stamp in stamps]
    if kind in ("replayed", "replayed and shifted"):
        back = int(rng.integers(5, min(begin, 300)))
        old = [replace(true[i - back], stamp_ns=true[i].stamp_ns) for i in range(begin, end)]
        shift = true[begin].p_world - old[0].p_world if kind != "replayed" else np.zeros(3)
        return [replace(row, p_world=row.p_world + shift) for row in old]
    if kind == "another scale":
        scale, origin = rng.choice([0.0, 0.5, 2.0]), rows[0].p_world
        return [replace(r, p_world=origin + scale * (r.p_world - origin), v_body=scale * r.v_body) for r in rows]
    if kind == "turned axes":
        return [replace(row, p_world=row.p_world[[1, 0, 2]], v_body=row.v_body[[1, 0, 2]]) for row in rows]
    return [replace(row, p_world=way * 10.0 ** rng.uniform(3, 308)) for row in rows]


def _noisy(row: Odometry, size: float, rng) -> Odometry:
    q = geometry.normalize(rng.normal(size=4))
    v_body, omega_body = rng.uniform(-size, size, (2, 3))
    return Odometry(row.stamp_ns, row.p_world + rng.uniform(-size, size, 3), q, v_body, omega_body)


def _sliding(row: Odometry, v_world, time_s: float) -> Odometry:
    v_body = row.v_body + geometry.rotate_inverse(row.q_world_body, v_world)
    return replace(row, p_world=row.p_world + time_s * v_world, v_body=v_body)

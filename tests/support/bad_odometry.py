"""Odometry that fails in flight or at rest: noise, jumps, ramps, frozen and replayed samples, then true ones."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from synthetic_flight import CONFIG, GRAVITY, RATE, Truth, race

from swift_ros import configuration, geometry
from swift_ros.types import ImuSample, Odometry
from swift_sim_bridge.sensors.vio import Vio, VioSettings

TICK_NS = 10_000_000
DRAWS = 40  # flights from which the spread of good odometry is computed
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


def good_odometry(truth: Truth, seed: int) -> list[Odometry]:
    """Return the simulator's odometry of a flight."""
    sensor = Vio(_simulated(), np.random.default_rng([seed, 1]))
    rows = [truth.odometry(i) for i in range(len(truth.p_map))]
    return [
        sensor.measure(row.stamp_ns, row.p_world, row.q_world_body, v_map, row.omega_body)
        for row, v_map in zip(rows, truth.v_map, strict=True)
    ]


@cache
def _simulated() -> VioSettings:
    return configuration.load_section(VioSettings, CONFIG / "simulation.yaml", "vio")


def bad_flight(seed: int) -> BadFlight:
    """Draw a failure in flight or, in every third draw, at rest."""
    rng = np.random.default_rng([seed, 3])
    truth = race(laps=1, at_rest_s=6.0)
    true = good_odometry(truth, seed)
    first = 100 if seed % 3 == 0 else 750
    begin = int(rng.integers(first, first + (200 if seed % 3 == 0 else len(true) - 1150)))
    end = begin + int(rng.integers(5, 150))
    kind = KINDS[int(rng.integers(len(KINDS)))]
    bad = _failed(kind, true, begin, end, rng)
    return BadFlight(kind, true, true[:begin] + bad + true[end:], imu_samples(truth, seed), begin, end)


@dataclass(frozen=True)
class Check:
    """What a guard did with a flight.

    Attributes:
        refused_good: good samples before the failure that were refused.
        off_m: distance of each believed sample of the failure from the true one, m, by tick.
        rejoined_s: from the first good sample to the first believed one, s; infinite without one.
        after_m: largest distance of a believed sample after the failure, m.
    """

    refused_good: int
    off_m: dict[int, float]
    rejoined_s: float
    after_m: float


def checked(flown: BadFlight, guard) -> Check:
    """Return what a new guard, with the IMU, does with a flight."""
    off_m = {}
    for i, (sample, imu) in enumerate(zip(flown.given, flown.imu, strict=True)):
        guard.imu(imu)
        odometry = guard.check(sample).odometry
        if odometry is not None:
            off_m[i] = float(np.linalg.norm(odometry.p_world - flown.true[i].p_world))
    after = {i: off for i, off in off_m.items() if i >= flown.end}
    return Check(
        refused_good=sum(i not in off_m for i in range(flown.begin)),
        off_m={i: off for i, off in off_m.items() if flown.begin <= i < flown.end},
        rejoined_s=(min(after) - flown.end) / RATE if after else np.inf,
        after_m=max(after.values(), default=np.inf),
    )


def drift_m(begin: int, tick: int) -> float:
    """Return the standard deviation of good odometry's drift along one axis from one tick to another, m."""
    errors = _errors()
    return float(np.sqrt(np.mean((errors[:, tick] - errors[:, begin]) ** 2)))


@cache
def _errors() -> np.ndarray:
    """Return the position errors (DRAWS, ticks, 3) of good odometry, m."""
    truth = race(laps=1, at_rest_s=6.0)
    return np.array([[row.p_world for row in good_odometry(truth, seed)] for seed in range(DRAWS)]) - truth.p_map


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

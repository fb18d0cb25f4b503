"""Visual-inertial odometry: its drift, and the terms that increase it."""

from dataclasses import dataclass

import numpy as np

from swift_ros import geometry
from swift_ros.configuration import setting, within
from swift_ros.types import Odometry
from swift_sim_bridge.effects import VIO_CHANNELS, Effect, TermSpecification, scalar_parameter, vector_parameters
from swift_sim_bridge.sensors.attitude import tilted
from swift_sim_bridge.sensors.clock import Delay
from swift_sim_bridge.sensors.coloured_noise import ColouredNoise


@dataclass(frozen=True)
class VioSettings:
    """Section `vio` of simulation.yaml; its comments give source and unit of each key."""

    walk: float = within(0.0, 1.0)
    rate_share: float = within(0.0, 0.3)
    rate_memory_s: float = within(0.001, 10_000.0)
    rotation_ref: float = within(0.001, 10_000.0)
    scale: float = setting("relative error, of visual-inertial odometry 0.002 to 0.05", 0.0, 0.3)
    velocity_share: float = within(0.0, 0.3)
    velocity_memory_s: float = within(0.001, 10_000.0)
    velocity_noise: float = within(0.0, 3.0)
    position_noise: float = within(0.0, 1.0)
    tilt_deg: float = within(0.0, 20.0)
    tilt_memory_s: float = within(0.001, 10_000.0)
    yaw_walk_deg: float = within(0.0, 20.0)
    rate_noise: float = within(0.0, 3.0)


@dataclass(frozen=True)
class VioScale:
    """Scale error of distance and velocity, in addition to the random one of the flight.

    Attributes:
        scale: relative error, 0.01 to 0.05.
    """

    scale: float


@dataclass(frozen=True)
class VioDrift:
    """Drift proportional to the speed.

    Attributes:
        share: (3,) of the speed, forward, left and up of the heading, 0.005 to 0.02.
    """

    share: tuple[float, float, float]


@dataclass(frozen=True)
class VioBlur:
    """Drift by motion blur: the variance of the drift grows by (body rate / rate_ref)^power.

    Attributes:
        rate_ref: rad/s, 1 to 5: three to ten times the variance at 10 rad/s.
        power: exponent.
    """

    rate_ref: float
    power: float = 1.0

    def __post_init__(self):
        if not self.rate_ref > 0:
            raise ValueError("'rate_ref' must be positive, in rad/s")


TERMS = {
    "vio_scale": TermSpecification(
        VioScale,
        idle={"scale": 0.0},
        example={"scale": 0.03},
        effects=(
            Effect(
                id="vio_scale",
                layer="vio",
                parameters=(scalar_parameter("scale", "", "vio_scale", step=5e-3, low=-0.5, high=0.5),),
                equation="v_vio = (1 + s) v",
                sentence="distances of VIO are {scale:~.2%} too {scale:long|short}",
                manoeuvre="straight passes at several speeds",
                channels=VIO_CHANNELS,
            ),
        ),
    ),
    "vio_drift": TermSpecification(
        VioDrift,
        idle={"share": [0.0, 0.0, 0.0]},
        example={"share": [0.01, -0.005, 0.002]},
        effects=(
            Effect(
                id="vio_drift",
                layer="vio",
                parameters=vector_parameters("share", "", "vio_drift", step=2e-3, bounds=(-0.3, 0.3)),
                equation="v_vio = v + |v| share, in the heading's frame",
                sentence="VIO drifts by {values} (shares of the speed)",
                manoeuvre="laps in both directions",
                channels=VIO_CHANNELS,
            ),
        ),
    ),
    "vio_blur": TermSpecification(
        VioBlur,
        idle={"rate_ref": 1e100},  # its ratio to any rate is zero; a vehicle file holds no infinite number
        example={"rate_ref": 2.0, "power": 2.0},
        units={"rate_ref": "rad/s", "power": ""},
    ),
    "vio_latency": TermSpecification(Delay, idle={"delay": 0.0}, example={"delay": 0.03}, units={"delay": "s"}),
}


def steady_drift(q_world_body, v_world, coefficients: VioDrift):
    """Return the velocity (..., 3) m/s, world frame, of a drift that is proportional to the speed."""
    heading = geometry.quaternion_from_yaw(geometry.yaw_of(q_world_body))
    speed = np.linalg.norm(v_world, axis=-1)[..., None]
    return geometry.rotate(heading, speed * np.array(coefficients.share))


class Vio:
    """Visual-inertial odometry: exact at the first measurement, then drifting, in a frame aligned there.

    The drift is a random walk over the path flown, plus a coloured velocity error proportional to the speed; both grow
    with rotation. The heading walks with the angle turned and the scale has a constant error; both deform the path.

    Args:
        settings: of the drift.
        rng: draws it.
        terms: the vehicle's sensor terms, of which those of `TERMS` are used; the caller applies `vio_latency`.
    """

    def __init__(self, settings: VioSettings, rng: np.random.Generator, terms: dict | None = None):
        self._settings = settings
        self._rng = rng
        self._terms = terms or {}
        self._scale = 1.0 + settings.scale * rng.standard_normal()
        if "vio_scale" in self._terms:
            self._scale += self._terms["vio_scale"].scale
        self._rate = ColouredNoise(3, settings.rate_memory_s, rng)
        self._velocity = ColouredNoise(3, settings.velocity_memory_s, rng)
        self._tilt = ColouredNoise(2, settings.tilt_memory_s, rng)
        self._yaw, self._turn = 0.0, geometry.quaternion_from_yaw(np.zeros(()))
        self._p_odom: np.ndarray | None = None
        self._last = (0, np.zeros(3))

    def measure(self, stamp_ns: int, p_world, q_world_body, v_world, omega_body) -> Odometry:
        """Return odometry in the frame of the first measurement, its twist in the body frame."""
        p_world, v_world, omega_body = (np.asarray(value) for value in (p_world, v_world, omega_body))
        if self._p_odom is None:
            self._p_odom, self._last = p_world.copy(), (stamp_ns, p_world)
        steady = None
        if "vio_drift" in self._terms:
            steady = steady_drift(np.asarray(q_world_body), v_world, self._terms["vio_drift"])
        self._drift(stamp_ns, p_world, v_world, omega_body, steady)
        s, noise = self._settings, self._rng.standard_normal((3, 3))
        q_odom_body = geometry.quaternion_multiply(self._turn, tilted(self._tilt.value, q_world_body))
        v_odom = self._scale * geometry.rotate(self._turn, v_world) + self._rate.value + self._velocity.value
        if steady is not None:
            v_odom = v_odom + geometry.rotate(self._turn, steady)
        return Odometry(
            stamp_ns=stamp_ns,
            p_world=self._p_odom + s.position_noise * noise[0],
            q_world_body=q_odom_body,
            v_body=geometry.rotate_inverse(q_odom_body, v_odom + s.velocity_noise * noise[1]),
            omega_body=omega_body + s.rate_noise * noise[2],
        )

    def _drift(self, stamp_ns: int, p_world, v_world, omega_body, steady) -> None:
        """Advance position, heading and velocity errors to `stamp_ns`; `steady` is of `steady_drift`, or None."""
        s, (last_ns, p_last) = self._settings, self._last
        dt = 1e-9 * (stamp_ns - last_ns)
        self._last = (stamp_ns, p_world)
        if dt <= 0:
            return
        moved = p_world - p_last
        speed, turning, length = (np.sqrt(value @ value) for value in (v_world, omega_body, moved))
        growth = 1.0 + turning / s.rotation_ref
        if blur := self._terms.get("vio_blur"):
            growth += (turning / blur.rate_ref) ** blur.power
        rate = self._rate.step(dt, s.rate_share * speed * np.sqrt(growth))
        self._velocity.step(dt, s.velocity_share * speed)
        self._tilt.step(dt, np.radians(s.tilt_deg))
        walk = s.walk * np.sqrt(length * growth) * self._rng.standard_normal(3)
        self._p_odom = self._p_odom + self._scale * geometry.rotate(self._turn, moved) + rate * dt + walk
        if steady is not None:
            self._p_odom = self._p_odom + geometry.rotate(self._turn, steady) * dt
        self._yaw += np.radians(s.yaw_walk_deg) * np.sqrt(turning * dt) * self._rng.standard_normal()
        self._turn = geometry.quaternion_from_yaw(np.asarray(self._yaw))

"""What stays the same in a training: the track, the vehicle and the settings, as arrays and numbers."""

from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from swift_ros.camera.model import Camera
from swift_ros.track import Track
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.flight_controller.configuration.vehicle_profile import profile_from_vehicle
from swift_sim_bridge.flight_controller.rate_loop.profile import RateLoopProfile
from swift_sim_bridge.physics import motors
from swift_sim_bridge.physics.state import Parameters, parameters_from_vehicle
from swift_sim_bridge.pilot import judging


@dataclass(frozen=True)
class EnvironmentSettings:
    """Section `policy.environment` of config/training.yaml, which says what each key means."""

    episode_s: float
    stuck_s: float
    missed_window_m: float
    opening_half_width_m: float
    podium_share: float
    bank_size: int
    bank_straight: int
    perturb_position_m: float
    perturb_attitude_rad: float
    perturb_velocity_m_s: float
    perturb_omega_rad_s: float
    podium_position_m: float
    podium_yaw_rad: float
    grace_s: float


class World(NamedTuple):
    """Everything that stays the same in a training: arrays of the track, limits, physics constants, settings."""

    gates: judging.Gates
    corners: jnp.ndarray  # (g, 4, 3)
    start: tuple  # position (3,), yaw
    camera_axis: jnp.ndarray  # (3,) optical axis in the body frame
    max_thrust: float  # m/s^2
    max_rates: jnp.ndarray  # (3,) rad/s
    passages: int
    vehicle: Vehicle
    parameters: Parameters  # nominal, float32
    profile: RateLoopProfile  # the flight controller's
    idle_speed: float  # rad/s, rotors of an armed vehicle on the podium
    settings: EnvironmentSettings


def make_world(track: Track, vehicle: Vehicle, camera: Camera, settings: EnvironmentSettings) -> World:
    """Return the constants of a training on a track, in float32."""
    single = lambda values: jnp.asarray(np.asarray(values), jnp.float32)  # noqa: E731
    pitch = np.radians(camera.pitch_deg)
    parameters = parameters_from_vehicle(vehicle, jnp.float32)
    profile = profile_from_vehicle(vehicle, jnp.float32)
    full = parameters.battery.open_circuit_full
    idle_speed = motors.steady_speed(profile.motor_idle[None], full, parameters.motors)
    return World(
        gates=judging.make_gates(track, vehicle),
        corners=single(track.corners),
        start=(single(track.start), float(np.radians(track.start_yaw_deg))),
        camera_axis=single([np.cos(pitch), 0.0, np.sin(pitch)]),
        max_thrust=vehicle.max_thrust / vehicle.mass,
        max_rates=single(vehicle.rates.max),
        passages=track.passages,
        vehicle=vehicle,
        parameters=parameters,
        profile=profile,
        idle_speed=float(idle_speed[0]),
        settings=settings,
    )

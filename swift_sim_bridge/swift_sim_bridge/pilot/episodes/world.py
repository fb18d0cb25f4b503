"""What stays the same in a training: the track, the vehicle and the settings, as arrays and numbers."""

from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from swift_ros.camera.model import Camera
from swift_ros.configuration import refuse_larger, within
from swift_ros.track import Track
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.flight_controller.configuration.vehicle_profile import profile_from_vehicle
from swift_sim_bridge.flight_controller.rate_loop.profile import RateLoopProfile
from swift_sim_bridge.physics import contact, motors
from swift_sim_bridge.physics.state import Parameters, parameters_from_vehicle
from swift_sim_bridge.pilot.episodes import judging
from swift_sim_bridge.pilot.episodes.randomization import EstimateErrors
from swift_sim_bridge.pilot.episodes.time_optimal import Guide


@dataclass(frozen=True)
class EnvironmentSettings:
    """Section `policy.environment` of config/training.yaml: length and start of episodes.

    Attributes:
        episode_s: after this time an episode ends without a penalty.
        stuck_s: an episode without a passage for so long ends as a crash.
        missed_window_m: the next gate is missed if its plane is crossed outside the opening, but nearer than this in
            y and z to its centre.
        opening_half_width_m: progress is measured to the nearest point of a square of this half width in the opening.
        podium_share: episodes that start on the podium; the rest start around a state of the bank.
        bank_size: states of each gate in the bank.
        bank_fixed: of them, states which are never replaced: straight behind the gate, or with a guide along its lap.
        guide_speed: with a guide, slowest and fastest speeds of these states, as shares of those of its lap.
        guide_free_m: distance from the guide up to which it costs nothing.
        perturb_position_m, perturb_attitude_rad, perturb_velocity_m_s, perturb_omega_rad_s: largest offset from a
            state of the bank, an axis.
        podium_position_m, podium_yaw_rad: largest offset on the podium, of x, of y and of the yaw.
        grace_s: frames cannot be hit so long after the start of an episode, which may begin close to a frame.
        command_delay_s: largest time from a state to the moment in which its command is in force.
        vehicle_spread: factor on the ranges in which the parameters of the vehicle are drawn (`randomization`): 1 for a
            vehicle of a list of parts, less for one that `swiftros identify` measured.
        used_charge: largest share of the battery's capacity that is used before an episode.
    """

    episode_s: float = within(0.1, 3600.0)
    stuck_s: float = within(0.1, 3600.0)
    missed_window_m: float = within(0.1, 1000.0)
    opening_half_width_m: float = within(0.0, 10.0)
    podium_share: float = within(0.0, 1.0)
    bank_size: int = within(1, 100_000)
    bank_fixed: int = within(1, 100_000)
    guide_speed: tuple[float, float] = within(0.1, 1.5)
    guide_free_m: float = within(0.0, 100.0)
    perturb_position_m: float = within(0.0, 10.0)
    perturb_attitude_rad: float = within(0.0, 3.15)
    perturb_velocity_m_s: float = within(0.0, 30.0)
    perturb_omega_rad_s: float = within(0.0, 30.0)
    podium_position_m: float = within(0.0, 10.0)
    podium_yaw_rad: float = within(0.0, 3.15)
    grace_s: float = within(0.0, 10.0)
    command_delay_s: float = within(0.0, 0.02)
    vehicle_spread: float = within(0.0, 3.0)
    used_charge: float = within(0.0, 1.0)

    def __post_init__(self):
        refuse_larger(("bank_size", self.bank_size), bank_fixed=self.bank_fixed)
        refuse_larger(("episode_s", self.episode_s), stuck_s=self.stuck_s, grace_s=self.grace_s)


class World(NamedTuple):
    """Everything that stays the same in a training.

    Attributes:
        gates: frames, flight volume and hull, for the rules.
        supports: ground and podium, for the physics: a hull that stands on them cannot turn yet.
        corners: (g, 4, 3) m, inner corners of the gates in the map.
        start: position (3,) m and yaw (rad) of the podium.
        camera_axis: (3,) optical axis in the body frame.
        max_thrust: m/s^2.
        max_rates: (3,) rad/s.
        passages: gate passages of a whole race.
        vehicle: the vehicle file.
        parameters: nominal physics, float32.
        profile: of the flight controller.
        idle_speed: rad/s, rotors of an armed vehicle on the podium.
        settings: of the episodes.
        errors: of the state estimate.
        guide: time-optimal lap, None without one.
    """

    gates: judging.Gates
    supports: contact.World
    corners: jnp.ndarray
    start: tuple
    camera_axis: jnp.ndarray
    max_thrust: float
    max_rates: jnp.ndarray
    passages: int
    vehicle: Vehicle
    parameters: Parameters
    profile: RateLoopProfile
    idle_speed: float
    settings: EnvironmentSettings
    errors: EstimateErrors
    guide: Guide | None = None


def make_world(
    track: Track,
    vehicle: Vehicle,
    camera: Camera,
    settings: EnvironmentSettings,
    errors: EstimateErrors,
    guide: Guide | None = None,
) -> World:
    """Return the world of a track, a vehicle and a camera, with a guide or without; arrays are float32."""

    def single(values):
        return jnp.asarray(np.asarray(values), jnp.float32)

    pitch = np.radians(camera.pitch_deg)
    parameters = parameters_from_vehicle(vehicle, jnp.float32)
    profile = profile_from_vehicle(vehicle, jnp.float32)
    full = parameters.battery.open_circuit_full
    idle_speed = motors.steady_speed(profile.motor_idle[None], full, parameters.motors)
    return World(
        gates=judging.make_gates(track, vehicle),
        supports=contact.supports_of_track(track, vehicle.hull_height, jnp.float32),
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
        errors=errors,
        guide=guide,
    )

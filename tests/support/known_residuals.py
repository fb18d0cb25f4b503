"""The residual model of a motion in closed form, to whose residuals tests add what they want to be found."""

from functools import cache

import numpy as np
from known_motion import motion, specific_force

from swift_ros.configuration import configuration_folder, load
from swift_ros.recording.flight_table import FlightTable, Samples
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.recording.recording import read_recording
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel


@cache
def vehicle() -> Vehicle:
    return load(Vehicle, configuration_folder() / "drone.yaml")


@cache
def residual_model() -> ResidualModel:
    """Return 12 s of the motion, with rotor speeds that give its thrust in uneven shares."""
    t = np.arange(0.0, 12.0, 0.004)
    moving, force = motion(t), specific_force(t)
    thrust = vehicle().mass * np.maximum(force[:, 2], 3.0) / 4
    share = 1.0 + 0.1 * np.sin(np.array([3.0, 4.1, 5.3, 6.7]) * t[:, None])
    channels = {
        "p_world": moving.p_world,
        "q_world_body": moving.q_world_body,
        "v_world": moving.v_world,
        "gyro_body": moving.omega_body,
        "specific_force_body": force,
        "rotor_speed": np.sqrt(thrust[:, None] * share / vehicle().thrust_coefficient),
    }
    table = FlightTable("closed form", {name: Samples(t, values) for name, values in channels.items()})
    return ResidualModel(read_recording(table, vehicle()))

"""Flights along sines and in a hover, flown by the gap tool's own controller, with effects of the simulator."""

from dataclasses import replace
from functools import cache

import jax
import numpy as np

from swift_ros.configuration import configuration_folder, load
from swift_ros.recording.flight_table import FlightTable
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.effects.catalogue import catalogue, draught, payload
from swift_sim_bridge.gap.effects.injection import inject
from swift_sim_bridge.gap.nominal import reference_flights

SECONDS, STEP_S, REFERENCE_FLIGHTS = 12.0, 0.005, 8
SHEET = {
    "position_m": 3e-4,
    "attitude_rad": 1.7e-3,
    "gyro_rad_s": 0.03,
    "accel_m_s2": 1.0,
    "rotor_relative": 0.005,
    "vbat_v": 0.02,
    "ibat_a": 0.5,
}


@cache
def vehicle() -> Vehicle:
    """Return the shipped vehicle with the noise of SHEET."""
    return replace(load(Vehicle, configuration_folder() / "drone.yaml"), sensors=SHEET)


@cache
def path() -> reference_flights.FlightPath:
    """Return sines at up to 14 m/s, with the thrust along the body's z axis."""
    t = np.arange(-1.0, SECONDS + 1.0, STEP_S)
    p = np.array([7.0, 6.0, 1.5]) * np.sin(np.array([1.5, 1.7, 1.3]) * t[:, None] + [0.0, 1.0, 2.0])
    p += 0.5 * np.sin(np.array([4.1, 3.7, 4.6]) * t[:, None])
    return flown(t, p, 0.8 * np.sin(0.9 * t) + 0.4 * np.sin(2.3 * t))


@cache
def hover() -> reference_flights.FlightPath:
    """Return a hover with a slow yaw motion: little moves except noise."""
    t = np.arange(-1.0, SECONDS + 1.0, STEP_S)
    return flown(t, np.tile([0.0, 0.0, 3.0], (len(t), 1)), 0.6 * np.sin(1.5 * t))


def flown(t, p_world, yaw) -> reference_flights.FlightPath:
    """Return a path from its second 0 on, without its last second, for REFERENCE_FLIGHTS vehicles.

    All batches have this size, so that the simulation is compiled once.
    """
    inside = slice(round(1 / STEP_S), round((1 + SECONDS) / STEP_S))
    parts = reference_flights.motion_along(p_world, yaw, STEP_S)
    batch = (np.repeat(part[inside][:, None], REFERENCE_FLIGHTS, axis=1) for part in parts)
    return reference_flights.FlightPath(t[inside] - t[inside][0], *batch)


def flight(
    seed: int, process_noise_std=reference_flights.NO_PROCESS_NOISE, along=path, equation=None, **planted
) -> FlightTable:
    """Record a flight of the vehicle with effects at these parameters.

    Args:
        seed: seed of process and measurement noise.
        process_noise_std: see `reference_flights.fly`.
        along: function that returns the path.
        equation: entry `equation` of the vehicle's terms, None for none.
        planted: values of effects by key.
    """
    truth, effects = vehicle(), {effect.key: effect for effect in (*catalogue(vehicle()), draught(), payload())}
    for key, values in planted.items():
        truth = inject(truth, effects[key], values)
    if equation:
        truth = replace(truth, terms={**truth.terms, "equation": equation})
    with jax.enable_x64(True):
        traces = reference_flights.fly(truth, along(), SHEET["gyro_rad_s"], seed, process_noise_std)
    noise = reference_flights.gyro_noise_samples(along(), SHEET["gyro_rad_s"], seed)[:, 0]
    return reference_flights.measure(along(), traces[0], noise, truth, np.random.default_rng(seed))

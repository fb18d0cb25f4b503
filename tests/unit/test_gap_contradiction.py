"""Recordings in another unit, order or frame than the flight table's: each is refused in a sentence that says which."""

from functools import cache

import numpy as np
import pytest

from swift_ros import geometry
from swift_ros.configuration import configuration_folder, load
from swift_ros.errors import UsageError
from swift_ros.flight_table import FlightTable, Samples
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap import check, twins

STEP_S, SECONDS = 0.01, 8.0
FRD = np.array([1.0, -1.0, -1.0])


@cache
def vehicle() -> Vehicle:
    return load(Vehicle, configuration_folder() / "drone.yaml")


def flight() -> dict[str, np.ndarray]:
    """Channels of a flight along sines, the thrust along the body's z axis, with a little noise."""
    t = np.arange(0.0, SECONDS, STEP_S)
    p = np.array([3.0, 2.0, 0.5]) * np.sin(np.array([1.5, 1.9, 1.3]) * t[:, None] + [0.0, 1.0, 2.0]) + [0.0, 0.0, 4.0]
    p, v, a, q, omega = twins.along(p, 0.8 * np.sin(0.9 * t), STEP_S)
    thrust = np.linalg.norm(a + [0.0, 0.0, 9.80665], axis=1)
    speed = np.sqrt(thrust * vehicle().mass / 4.0 / vehicle().thrust_coefficient)
    rng = np.random.default_rng(5)

    def noisy(values, sigma):
        return values + sigma * rng.standard_normal(values.shape)

    return {"t": t, "p_world": noisy(p, 3e-4), "v_world": noisy(v, 0.01), "q_world_body": q,
            "gyro_body": noisy(omega, 0.03), "omega_command_body": omega,
            "specific_force_body": noisy(np.outer(thrust, [0.0, 0.0, 1.0]), 0.5),
            "rotor_speed": np.repeat(speed[:, None], 4, axis=1)}


def read(channels: dict):
    t = channels.pop("t")
    return check.read(FlightTable("flight", {name: Samples(t, rows) for name, rows in channels.items()}), vehicle())


def scaled(name, factor):
    return lambda channels: channels.update({name: channels[name] * factor})


def without_velocity(change):
    def both(channels):
        change(channels)
        channels.pop("v_world")

    return both


def reordered(channels):
    channels.update(q_world_body=channels["q_world_body"][:, [3, 0, 1, 2]])


def of_the_body(channels):
    channels.update(v_world=geometry.rotate_inverse(channels["q_world_body"], channels["v_world"]))


def of_the_world(channels):
    channels.update(q_world_body=geometry.quaternion_conjugate(channels["q_world_body"]))


def test_what_agrees_is_read():
    assert read(flight()).has("p_world", "gyro_body", "specific_force_body", "rotor_speed")


@pytest.mark.parametrize(("mistake", "sentence"), [
    (reordered, "the quaternion's w stands first, not last"),
    (of_the_world, "the quaternion turns world into body"),
    (scaled("gyro_body", 180.0 / np.pi), "the gyro speaks of degrees, not radians"),
    (scaled("omega_command_body", 180.0 / np.pi), "the commands speak of degrees, not radians"),
    (scaled("gyro_body", FRD), "the gyro's axes are forward-right-down"),
    (of_the_body, "the velocity is the body's, not the world's"),
    (scaled("v_world", 3.6), "vx, vy, vz speak of km/h"),
    (scaled("p_world", 1000.0), "px, py, pz speak of millimetres"),
    (without_velocity(scaled("p_world", 1000.0)), "px, py, pz speak of millimetres"),
    (without_velocity(scaled("p_world", FRD)), "the world's axes are north-east-down"),
    (scaled("specific_force_body", 1.0 / 9.80665), "the accelerometer speaks of g, not m/s^2"),
    (scaled("rotor_speed", 60.0 / (2.0 * np.pi)), "the rotor speeds may be in rpm, not rad/s"),
    (scaled("rotor_speed", 3.0), "give the vehicle file of this flight"),
])  # fmt: skip
def test_a_mistake_is_told_by_what_would_make_the_channels_agree(mistake, sentence):
    channels = flight()
    mistake(channels)
    with pytest.raises(UsageError) as error:
        read(channels)
    assert sentence in str(error.value) and "\n" not in str(error.value)


def test_a_flight_of_two_seconds_is_too_short():
    with pytest.raises(UsageError, match="overlap for less than 5 s; fly for longer"):
        read({name: rows[:200] for name, rows in flight().items()})


def test_odometry_that_is_the_truth_played_again_is_none_also_where_its_end_was_torn_off():
    channels = flight()
    t = channels.pop("t")
    samples = {name: Samples(t, rows) for name, rows in channels.items()}
    echo = {"p_vio": Samples(t[:-1], channels["p_world"][:-1]), "q_vio_body": Samples(t, channels["q_world_body"])}
    assert not check.read(FlightTable("flight", samples | echo), vehicle()).has("p_vio")

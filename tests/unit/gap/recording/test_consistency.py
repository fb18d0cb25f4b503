"""Recordings in another unit, order or frame than the flight table's are refused, and the mistake is named."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from swift_ros import geometry
from swift_ros.configuration import configuration_folder, load
from swift_ros.errors import UsageError
from swift_ros.recording.flight_table import FlightTable, Samples
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.nominal import reference_flights, rotor_speed_model
from swift_sim_bridge.gap.recording.recording import read_recording

STEP_S, SECONDS = 0.01, 8.0
FRD = np.array([1.0, -1.0, -1.0])


@cache
def vehicle() -> Vehicle:
    return load(Vehicle, configuration_folder() / "drone.yaml")


def flight() -> dict[str, np.ndarray]:
    """Channels of a flight along sines, the thrust along the body's z axis, with a little noise."""
    t = np.arange(0.0, SECONDS, STEP_S)
    p = np.array([3.0, 2.0, 0.5]) * np.sin(np.array([1.5, 1.9, 1.3]) * t[:, None] + [0.0, 1.0, 2.0]) + [0.0, 0.0, 4.0]
    p, v, a, q, omega = reference_flights.motion_along(p, 0.8 * np.sin(0.9 * t), STEP_S)
    thrust = np.linalg.norm(a + [0.0, 0.0, 9.80665], axis=1)
    speed = np.sqrt(thrust * vehicle().mass / 4.0 / vehicle().thrust_coefficient)
    rng = np.random.default_rng(5)

    def noisy(values, sigma):
        return values + sigma * rng.standard_normal(values.shape)

    return {
        "t": t,
        "p_world": noisy(p, 3e-4),
        "v_world": noisy(v, 0.01),
        "q_world_body": q,
        "gyro_body": noisy(omega, 0.03),
        "omega_command_body": omega,
        "specific_force_body": noisy(np.outer(thrust, [0.0, 0.0, 1.0]), 0.5),
        "rotor_speed": np.repeat(speed[:, None], 4, axis=1),
    }


def read(channels: dict):
    t = channels.pop("t")
    return read_recording(FlightTable("flight", {name: Samples(t, rows) for name, rows in channels.items()}), vehicle())


def scaled(name, factor):
    return lambda channels: channels.update({name: channels[name] * factor})


def without_velocity(change):
    def both(channels):
        change(channels)
        channels.pop("v_world")

    return both


def reordered(channels):
    channels.update(q_world_body=channels["q_world_body"][:, [3, 0, 1, 2]])


def velocity_in_body(channels):
    channels.update(v_world=geometry.rotate_inverse(channels["q_world_body"], channels["v_world"]))


def inverted_attitude(channels):
    channels.update(q_world_body=geometry.quaternion_conjugate(channels["q_world_body"]))


def test_consistent_channels_are_accepted():
    assert read(flight()).has("p_world", "gyro_body", "specific_force_body", "rotor_speed")


@pytest.mark.parametrize(
    ("mistake", "sentence"),
    [
        (reordered, "the quaternion has w first, not last"),
        (inverted_attitude, "the quaternion rotates world into body vectors"),
        (scaled("gyro_body", 180.0 / np.pi), "the gyro is in degrees/s, not rad/s"),
        (scaled("omega_command_body", 180.0 / np.pi), "the commands are in degrees/s, not rad/s"),
        (scaled("gyro_body", FRD), "the gyro's axes are forward-right-down"),
        (velocity_in_body, "the velocity is in the body frame, not in the world"),
        (scaled("v_world", 3.6), "vx, vy, vz are in km/h"),
        (scaled("p_world", 1000.0), "px, py, pz are in millimetres"),
        (without_velocity(scaled("p_world", 1000.0)), "px, py, pz are in millimetres"),
        (scaled("p_world", 0.001), "px, py, pz are in kilometres"),
        (without_velocity(scaled("p_world", 0.001)), "px, py, pz are in kilometres"),
        (scaled("v_world", 0.001), "vx, vy, vz in km/s"),
        (scaled("v_world", 1000.0), "vx, vy, vz are in mm/s"),
        (without_velocity(scaled("p_world", FRD)), "the world's axes are north-east-down"),
        (scaled("specific_force_body", 1.0 / 9.80665), "the accelerometer is in g, not m/s^2"),
        (scaled("rotor_speed", 60.0 / (2.0 * np.pi)), "the rotor speeds may be in rpm, not rad/s"),
        (scaled("rotor_speed", 3.0), "give the vehicle file of this flight"),
    ],
)
def test_a_mistake_is_named_when_its_correction_makes_the_channels_agree(mistake, sentence):
    channels = flight()
    mistake(channels)
    with pytest.raises(UsageError) as error:
        read(channels)
    assert sentence in str(error.value) and "\n" not in str(error.value)


def turned(order, signs=(1.0, 1.0, 1.0)):
    return lambda channels: channels.update(gyro_body=channels["gyro_body"][:, order] * signs)


@pytest.mark.parametrize(
    ("mistake", "rates"),
    [
        (turned([1, 0, 2]), "wy, wx, wz"),
        (turned([2, 0, 1]), "wy, wz, wx"),
        (turned([0, 1, 2], [1, -1, 1]), "wx, -wy, wz"),
        (turned([0, 1, 2], [1, 1, -1]), "wx, wy, -wz"),
        (turned([1, 0, 2], [-1, 1, 1]), "wy, -wx, wz"),
    ],
)
def test_a_gyro_with_swapped_or_inverted_axes_is_refused_with_the_right_order(mistake, rates):
    channels = flight()
    mistake(channels)
    with pytest.raises(UsageError, match=f"they agree if the rates about forward, left and up are {rates}$"):
        read(channels)


def test_a_gyro_of_another_flight_is_refused_and_a_bad_one_is_not():
    channels, rng = flight(), np.random.default_rng(6)
    gyro, rows = channels["gyro_body"], len(channels["gyro_body"])
    stray = np.sin(np.outer(channels["t"], [4.0, 5.3, 6.1]) + [0.3, 1.0, 2.0])
    with pytest.raises(UsageError, match="disagree about the rotation; check the axes"):
        read(flight() | {"gyro_body": 2.0 * stray})
    turn = geometry.quaternion_from_rotation_vector(np.array([0.0, 0.0, 0.4]))
    misaligned = geometry.rotate(np.broadcast_to(turn, (rows, 4)), 1.3 * gyro)
    for bad in (gyro + 3.0 * rng.standard_normal((rows, 3)), np.roll(gyro, 25, axis=0), misaligned):
        assert read(flight() | {"gyro_body": bad}).has("gyro_body")


def resting(share):
    """Change a flight to one that rests with idling rotors for the last share of its time."""

    def rest(channels):
        begin = round((1.0 - share) * len(channels["t"]))
        for name in ("p_world", "q_world_body"):
            channels[name][begin:] = channels[name][begin]
        for name in ("v_world", "gyro_body", "omega_command_body"):
            channels[name][begin:] *= 0.01
        up = geometry.rotate_inverse(channels["q_world_body"][begin], np.array([0.0, 0.0, 9.8]))
        channels["specific_force_body"][begin:] = up
        channels["rotor_speed"][begin:] = 500.0

    return rest


def test_time_on_the_ground_is_not_compared_with_the_thrust_of_the_file():
    channels = flight()
    resting(0.55)(channels)
    assert read(channels).has("rotor_speed")
    channels = flight()
    resting(0.5)(channels)
    scaled("rotor_speed", 2.0)(channels)
    with pytest.raises(UsageError, match="give the vehicle file of this flight, and rotor speeds in rad/s"):
        read(channels)


def test_a_wrong_thrust_from_motor_commands_alone_is_reported_as_one_of_commands():
    channels = flight()
    t = channels.pop("t")
    channels.pop("rotor_speed")
    table = FlightTable("flight", {name: Samples(t, rows) for name, rows in channels.items()})
    loud = replace(table, channels=dict(table.channels) | {"motor_command": Samples(t, np.full((len(t), 4), 0.9))})
    with pytest.raises(
        UsageError,
        match=r"the motor commands \(u_1 ..\) the vehicle file gives a thrust of .*; give the vehicle file of this",
    ):
        read_recording(rotor_speed_model.with_modelled_rotor_speeds(loud, vehicle()), vehicle())


@pytest.mark.parametrize(
    ("volts", "amperes", "sentence"),
    [
        (15.5, 20.0, None),
        (15.5, 0.0, None),
        (0.0, 20.0, None),
        (0.0155, 20.0, "vbat is in kilovolts, not volts"),
        (15.5, 2e4, "ibat is in milliamperes, not amperes"),
        (15.5, 0.02, "ibat is in kiloamperes, not amperes"),
    ],
)
def test_voltage_or_current_in_a_unit_of_a_thousand_is_refused_and_constant_zero_is_not(volts, amperes, sentence):
    channels = flight()
    rows = len(channels["t"])
    channels |= {"voltage": np.full(rows, volts), "current": np.full(rows, amperes)}
    if sentence is None:
        assert read(channels).has("voltage", "current")
        return
    with pytest.raises(UsageError, match=sentence):
        read(channels)


def test_a_flight_of_two_seconds_is_too_short():
    with pytest.raises(UsageError, match="were recorded together for 2.0 s, less than 5 s; fly for longer"):
        read({name: rows[:200] for name, rows in flight().items()})


def test_odometry_that_copies_the_pose_is_ignored_even_when_it_ends_earlier():
    channels = flight()
    t = channels.pop("t")
    samples = {name: Samples(t, rows) for name, rows in channels.items()}
    copied = {"p_vio": Samples(t[:-1], channels["p_world"][:-1]), "q_vio_body": Samples(t, channels["q_world_body"])}
    assert not read_recording(FlightTable("flight", samples | copied), vehicle()).has("p_vio")

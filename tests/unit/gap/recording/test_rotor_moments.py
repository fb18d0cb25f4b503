"""A vehicle file with rotors in another order, or with propellers that spin the other way, is refused and corrected."""

from dataclasses import replace
from functools import cache

import numpy as np
import planted_flight
import pytest

from swift_ros.errors import UsageError
from swift_ros.recording.flight_table import FlightTable, Samples
from swift_sim_bridge.gap.nominal.rotor_speed_model import with_modelled_rotor_speeds
from swift_sim_bridge.gap.recording.recording import read_recording

POSE_AND_COMMANDS = "p_world", "q_world_body", "motor_command"


@cache
def flight(size=1.0) -> FlightTable:
    return planted_flight.record(planted_flight.shipped(), size=size)


def only(table: FlightTable, channels, step=1) -> FlightTable:
    """Return some channels of a flight, every `step`-th row of them."""
    kept = {name: Samples(table[name].t[::step], table[name].values[::step]) for name in channels}
    return FlightTable(table.name, kept)


def with_rotors(order=(0, 1, 2, 3), spin=1):
    """Return the vehicle file with its rotors in another order, all spins times `spin`."""
    vehicle = planted_flight.shipped()
    rotors = tuple(replace(vehicle.rotors[i], spin=spin * vehicle.rotors[i].spin) for i in order)
    return replace(vehicle, rotors=rotors)


def read(table: FlightTable, vehicle):
    return read_recording(with_modelled_rotor_speeds(table, vehicle), vehicle)


@pytest.mark.parametrize("size", [1.0, 0.0])
def test_the_file_of_the_vehicle_that_flew_is_accepted(size):
    assert read(flight(size), with_rotors()).has("single_rotor_speeds")
    assert read(only(flight(size), POSE_AND_COMMANDS), with_rotors()).driven


@pytest.mark.parametrize("channels", [None, POSE_AND_COMMANDS])
@pytest.mark.parametrize(
    ("order", "spin", "sentence"),
    [
        ((0, 1, 2, 3), -1, "the motors yaw against the vehicle file; its propellers spin the other way"),
        ((1, 0, 3, 2), 1, "its motors 1, 2, 3, 4 are the rotors 2, 1, 4, 3 of the file"),
        ((2, 0, 3, 1), 1, "its motors 1, 2, 3, 4 are the rotors 2, 4, 1, 3 of the file"),
        ((3, 1, 2, 0), -1, "are the rotors 4, 2, 3, 1 of the file, and its propellers spin the other way"),
    ],
)
def test_another_order_or_spin_is_named(channels, order, spin, sentence):
    table = only(flight(), channels) if channels else flight()
    with pytest.raises(UsageError) as error:
        read(table, with_rotors(order, spin))
    assert sentence in str(error.value) and "\n" not in str(error.value)


def test_slow_rows_show_it_too():
    with pytest.raises(UsageError, match="spin the other way"):
        read(only(flight(), POSE_AND_COMMANDS, step=10), with_rotors(spin=-1))


def test_a_flight_that_shows_no_rotation_is_accepted():
    """Motors that answer noise do not show an order: it is not guessed."""
    rng = np.random.default_rng(3)
    table = only(flight(0.0), POSE_AND_COMMANDS)
    command = table["motor_command"]
    stray = 0.02 * rng.standard_normal(command.values.shape)
    still = Samples(command.t, command.values.mean(axis=1, keepdims=True) + stray)
    channels = {name: table[name] for name in POSE_AND_COMMANDS} | {"motor_command": still}
    assert read(FlightTable(table.name, channels), with_rotors(spin=-1)).driven

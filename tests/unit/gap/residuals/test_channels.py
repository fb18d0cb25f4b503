"""Residual channels have stable identifiers, which reports and searches use in place of their readable names."""

from types import SimpleNamespace

import numpy as np

from swift_sim_bridge.gap.residuals.channels import residual_groups


def with_every_signal() -> SimpleNamespace:
    """Return a recording from which every residual can be computed."""
    everything = SimpleNamespace(has=lambda *_: True, motor_record=object(), command_link=object(), rate_loop=object())
    everything.rotor_speed, everything.has_motion = np.zeros((10, 4)), True
    return everything


def channels() -> list:
    return [channel for group in residual_groups(with_every_signal()).values() for channel in group]


def test_every_channel_has_its_own_identifier_and_name():
    identifiers, names = [channel.id for channel in channels()], [channel.name for channel in channels()]
    assert len(set(identifiers)) == len(set(names)) == len(identifiers)
    assert all(identifier.replace("_", "").isalnum() and identifier.islower() for identifier in identifiers)
    assert {"specific_force_x", "rotor_speed_4", "voltage", "rate_command_yaw", "throttle_command"} <= set(identifiers)


def test_only_components_of_body_vectors_have_an_axis():
    with_axis = {channel.quantity for channel in channels() if channel.axis}
    assert with_axis == {"specific_force", "angular_acceleration", "accelerometer", "gyro", "vio_velocity"}
    for quantity in with_axis:
        assert [channel.axis for channel in channels() if channel.quantity == quantity] == ["x", "y", "z"]

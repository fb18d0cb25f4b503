"""Channels of a flight table: their columns in a file, units and possible values. No ROS."""

from dataclasses import dataclass

import numpy as np

TIME = "t"  # column of the times, s
MAX_ROTORS = 12  # largest number of a rotor in the name of a column


@dataclass(frozen=True)
class ChannelSpec:
    """Specification of one channel: one sensor, one command, or one estimate.

    Attributes:
        columns: names in a table; `rotor_#` stands for rotor_1, rotor_2 and so on.
        unit: of the values.
        low: smallest possible value.
        high: largest possible value.
        measured: by a sensor; its values are then checked for straight lines and clipping.
        noisy: a sensor that never repeats exactly the same values, not even at rest.
        min_range: no such sensor has a smaller measurement range; infinite when unknown.
    """

    columns: tuple[str, ...]
    unit: str
    low: float
    high: float
    measured: bool = True
    noisy: bool = False
    min_range: float = np.inf


# A motor command holds from its time until the next one, except in tables with `skips_commands`.
CHANNELS = {
    "p_world": ChannelSpec(("px", "py", "pz"), "m", -1e5, 1e5),
    "v_world": ChannelSpec(("vx", "vy", "vz"), "m/s", -120.0, 120.0),
    "q_world_body": ChannelSpec(("qx", "qy", "qz", "qw"), "", -1.05, 1.05),
    "gyro_body": ChannelSpec(("wx", "wy", "wz"), "rad/s", -70.0, 70.0, noisy=True, min_range=4.0),
    "specific_force_body": ChannelSpec(("ax", "ay", "az"), "m/s^2", -400.0, 400.0, True, True, 19.0),
    "rotor_speed": ChannelSpec(("rotor_#",), "rad/s", 0.0, 2e4),
    "motor_command": ChannelSpec(("u_#",), "", -1e-6, 1.0 + 1e-6),
    "thrust_command": ChannelSpec(("cmd_thrust",), "m/s^2", -20.0, 400.0, measured=False),
    "omega_command_body": ChannelSpec(("cmd_wx", "cmd_wy", "cmd_wz"), "rad/s", -70.0, 70.0, measured=False),
    "feedforward_body": ChannelSpec(("ff_x", "ff_y", "ff_z"), "", -20.0, 20.0, measured=False),
    "voltage": ChannelSpec(("vbat",), "V", 1e-3, 120.0),
    "current": ChannelSpec(("ibat",), "A", -200.0, 2000.0),
    "p_vio": ChannelSpec(("vio_px", "vio_py", "vio_pz"), "m", -1e5, 1e5),
    "q_vio_body": ChannelSpec(("vio_qx", "vio_qy", "vio_qz", "vio_qw"), "", -1.05, 1.05),
}
POSE = ("p_world", "q_world_body")
ACTUATION = ("rotor_speed", "motor_command", "thrust_command")  # a flight needs at least one of these


def known_columns() -> list[str]:
    """Return the names of all columns that a flight table can have."""
    return [TIME, *(column for spec in CHANNELS.values() for column in numbered_columns(spec, MAX_ROTORS))]


def numbered_columns(spec: ChannelSpec, count: int) -> list[str]:
    """Return the columns of a channel, for `count` rotors where there is one column for each rotor."""
    if "#" not in spec.columns[0]:
        return list(spec.columns)
    return [spec.columns[0].replace("#", str(i + 1)) for i in range(count)]

"""Channels of a recording as a pilot reads them, each with its columns of a flight table."""

from swift_sim_bridge.effects import Effect

PHYSICS = ("motor", "force", "moment")  # layers of effects for which other channels may stand in for missing ones
NAMES_WITH_COLUMNS = {
    "p_world": "position (px py pz)",
    "v_world": "velocity (vx vy vz)",
    "q_world_body": "attitude (qx qy qz qw)",
    "gyro_body": "gyro (wx wy wz)",
    "current": "the pack's current (ibat)",
    "feedforward_body": "feed-forward (ff_x ff_y ff_z)",
    "specific_force_body": "accelerometer (ax ay az)",
    "rotor_speed": "rotor speeds (rotor_1 ..)",
    "single_rotor_speeds": "each rotor's own speed (rotor_1 ..)",
    "motor_command": "motor commands (u_1 ..)",
    "every_motor_command": "all motor commands that the motors received: it has some of a faster loop's (the flight "
    "controller's own log has more: `swiftros import FLIGHT.bbl --align BAG`)",
    "omega_command_body": "commanded rates (cmd_wx cmd_wy cmd_wz)",
    "thrust_command": "commanded thrust (cmd_thrust)",
    "voltage": "the pack's voltage (vbat)",
    "p_vio": "VIO's position (vio_px ..)",
    "q_vio_body": "VIO's attitude (vio_qx ..)",
    "gate_observations": "gates in images",
    "rate_loop": "gyro, setpoint and motor commands of the flight controller's own log (`swiftros import FLIGHT.bbl`)",
}


def names_with_columns(channels) -> str:
    """Return the readable names of channels, separated by commas, each channel once."""
    named = dict.fromkeys(channels)
    if "single_rotor_speeds" in named:
        named.pop("rotor_speed", None)
    return ", ".join(NAMES_WITH_COLUMNS.get(name, name) for name in named)


def missing_channels(effect: Effect, recordings) -> list[str]:
    """Return the channels that an effect needs and that a recording lacks, if no other channel stands in for them.

    Args:
        effect: the effect.
        recordings: `recording.Recording` objects.
    """
    return [
        name
        for name in effect.channels
        if not all(one.has(name) or (effect.layer in PHYSICS and name in one.stand_ins) for one in recordings)
    ]


def unmeasured(missing, recordings) -> list[str]:
    """Return missing channels as the name of what was not measured.

    Motor commands may be recorded and still be listed as missing: where they replace rotor speeds, single rotor speeds
    are missing; where a bag has only some of a faster loop's commands, all of them are.

    Args:
        missing: names of channels.
        recordings: `recording.Recording` objects.
    """
    lacking = "motor_command"
    if any(one.skips_commands for one in recordings):
        lacking = "every_motor_command"
    if any(one.rotor_speed_modelled for one in recordings):
        lacking = "single_rotor_speeds"
    return [lacking if name == "motor_command" else name for name in missing]

"""The mapping of PX4's topics, in a ULog file or in a bag.

PX4's world is north-east-down, its body forward-right-down, and its quaternions have w first and rotate body vectors
into the world. A pose comes from simulation or motion capture where logged, else from PX4's own filter.
"""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from swift_ros.recording.log_formats.log import Log
from swift_ros.recording.log_mapping.mapping import MAX_ROTORS, ChannelSource
from swift_ros.recording.log_mapping.mapping import Mapping as LogMapping
from swift_ros.recording.log_mapping.quantities import RANGES, lowest_rate_hz

ORDER = (
    "motors have PX4's order; on its quadrotor x that is front right, rear left, front left, rear right, the first two "
    "with counter-clockwise propellers: list the rotors of the vehicle file, or these columns, accordingly"
)
COLLECTIVE = (
    "motor commands were logged {} times a second; each motor has their mean here, the thrust set point, which differs "
    "from theirs by {:.1g} (RMS): differences between the motors are not in this log"
)
OWN_ESTIMATE = "the pose is the estimate of PX4's own filter, which uses the same gyro and accelerometer"
LOGGED_RATES = "for 50 rows a second and more, add 'high rate' and 'system identification' to SDLOG_PROFILE (24)"
Q = tuple(f"q[{i}]" for i in (1, 2, 3, 0))
XYZ, VELOCITY = ("x", "y", "z"), ("vx", "vy", "vz")
POSITION = tuple(f"position[{i}]" for i in range(3))
GYRO, FORCE = (tuple(f"{name}[{i}]" for i in range(3)) for name in ("gyro_rad", "accelerometer_m_s2"))

# Candidates of each channel: topic and columns, in the order of preference. Of a pose, those of one source together.
POSES = (
    (("vehicle_local_position_groundtruth", XYZ), ("vehicle_attitude_groundtruth", Q)),
    (("vehicle_mocap_odometry", POSITION), ("vehicle_mocap_odometry", Q)),
    (("vehicle_mocap_odometry", XYZ), ("vehicle_mocap_odometry", Q)),
    (("att_pos_mocap", XYZ), ("att_pos_mocap", Q)),
    (("vehicle_local_position", XYZ), ("vehicle_attitude", Q)),
    (("vehicle_odometry", POSITION), ("vehicle_odometry", Q)),
    (("vehicle_odometry", XYZ), ("vehicle_odometry", Q)),
)
OWN = ("vehicle_local_position", "vehicle_attitude", "vehicle_odometry")
VELOCITIES = {"vehicle_local_position_groundtruth": VELOCITY, "vehicle_local_position": VELOCITY}
GYROS = (("sensor_combined", GYRO), ("vehicle_angular_velocity", tuple(f"xyz[{i}]" for i in range(3))))
FORCES = (("sensor_combined", FORCE), ("vehicle_acceleration", tuple(f"xyz[{i}]" for i in range(3))))
VISION = (("vehicle_visual_odometry", POSITION), ("vehicle_visual_odometry", XYZ))
RATES = ("vehicle_rates_setpoint", ("roll", "pitch", "yaw"))
THRUST, DOWN = "vehicle_thrust_setpoint", "xyz[2]"
VOLTAGES = (("battery_status", ("voltage_v",)), ("battery_status", ("voltage_filtered_v",)))
CURRENTS = (("battery_status", ("current_a",)), ("battery_status", ("current_filtered_a",)))


def guess(log: Log, names: Mapping[str, str]) -> LogMapping:
    """Return the mapping of PX4's topics.

    Args:
        log: the log.
        names: topics of the log by their uORB names.
    """
    channels: dict[str, ChannelSource] = {}
    notes: list[str] = []

    def source(topic: str, columns: Sequence[str], **keys) -> ChannelSource | None:
        present = names.get(topic)
        if present is None or any(column not in log.topics[present].columns for column in columns):
            return None
        varies = any(np.any(log.topics[present].columns[column] != 0) for column in columns)
        return ChannelSource(tuple(columns), present, **keys) if varies else None

    def first(channel: str, candidates, **keys) -> None:
        found = next(filter(None, (source(*candidate, **keys) for candidate in candidates)), None)
        if found:
            channels[channel] = found

    for position, attitude in POSES:
        p, q = source(*position, world="NED"), source(*attitude, world="NED", body="FRD")
        if p or (q and attitude[0] in OWN):
            channels |= {"p_world": p} if p else {}
            channels |= {"q_world_body": q} if q else {}
            if position[0] in VELOCITIES:
                first("v_world", [(position[0], VELOCITIES[position[0]])], world="NED")
            notes += [OWN_ESTIMATE] if position[0] in OWN else []
            break
    first("gyro_body", GYROS, body="FRD")
    first("specific_force_body", FORCES, body="FRD")
    channels |= _motors(log, names)
    first("omega_command_body", [RATES], body="FRD")
    first("p_vio", VISION, world="NED")
    if "p_vio" in channels:
        first("q_vio_body", [("vehicle_visual_odometry", Q)], world="NED", body="FRD")
    first("voltage", VOLTAGES)
    first("current", CURRENTS)
    if collective := _collective(log, names, channels.get("motor_command")):
        channels["motor_command"], note = collective
        notes.append(note)
    elif "motor_command" in channels or "rotor_speed" in channels:
        notes.append(ORDER)
    return LogMapping(channels, notes=tuple(notes))


def uorb_names(topics) -> dict[str, str]:
    """Return topics by their uORB names, from the names of PX4's topics in a bag: /fmu/out/vehicle_odometry_v1."""
    found = {}
    for topic in topics:
        last = topic.rsplit("/", 1)[-1]
        head, separator, version = last.rpartition("_v")
        found[head if separator and version.isdecimal() else last] = topic
    return found


def _motors(log: Log, names: Mapping[str, str]) -> dict[str, ChannelSource]:
    """Return the sources of motor commands and rotor speeds."""
    found = {}
    if commands := _used(log, names.get("actuator_motors"), "control[{}]"):
        found["motor_command"] = ChannelSource(commands, names["actuator_motors"])
    else:
        found |= {"motor_command": output} if (output := _outputs(log, names)) else {}
    if speeds := _used(log, names.get("esc_status"), "esc[{}].esc_rpm"):
        found["rotor_speed"] = ChannelSource(speeds, names["esc_status"], "rpm")
    return found


def _collective(log: Log, names: Mapping[str, str], motors: ChannelSource | None) -> tuple[ChannelSource, str] | None:
    """Return the thrust set point as the command of each motor, with a note, where only this was logged often enough.

    PX4's allocation adds to it what turns the vehicle, so that it is the mean of the motors' commands, except of motors
    at their limits.
    """
    thrust = log.topics.get(names.get(THRUST, ""))
    if motors is None or motors.unit or thrust is None or DOWN not in thrust.columns:
        return None
    slow = log.topics[motors.topic]
    lowest = lowest_rate_hz("motor_command", {})
    if slow.rate_hz >= lowest or thrust.rate_hz < lowest:
        return None
    mean = np.mean([slow.columns[column] for column in motors.columns], axis=0)
    difference = mean + np.interp(slow.t, thrust.t, thrust.columns[DOWN])
    rms = float(np.sqrt(np.nanmean(difference**2)))
    source = ChannelSource((f"-{DOWN}",) * len(motors.columns), names[THRUST])
    return source, COLLECTIVE.format(round(slow.rate_hz), rms)


def _outputs(log: Log, names: Mapping[str, str]) -> ChannelSource | None:
    """Return the source of the motor commands in `actuator_outputs`: the first instance with four outputs that vary."""
    for topic in (name for uorb, name in names.items() if uorb.partition("[")[0] == "actuator_outputs"):
        columns = _used(log, topic, "output[{}]")
        if len(columns) < 3:
            continue
        values = np.stack([log.topics[topic].columns[column] for column in columns])
        if np.nanmax(values) <= 1.0 and np.nanmin(values) >= -1.0:  # a simulator's
            return ChannelSource(columns, topic)
        low, high = (_limit(log, end, pulse) for end, pulse in zip(("MIN", "MAX"), RANGES["us"], strict=True))
        in_range = np.nanmax(values) > 0.5 * RANGES["us"][0] and low < high
        return ChannelSource(columns, topic, "us" if in_range else "DShot", range=(low, high) if in_range else None)
    return None


def _limit(log: Log, end: str, pulse_us: float) -> float:
    """Return the pulse that means 0 or 1, us, by the parameters PWM_MAIN_MIN .. or PWM_MIN .., else the usual one."""
    return next(
        (log.parameters[name] for name in (f"PWM_MAIN_{end}", f"PWM_{end}") if name in log.parameters), pulse_us
    )


def _used(log: Log, topic: str | None, pattern: str) -> tuple[str, ...]:
    """Return the columns of the motors: the first ones of a topic, up to the first that never changes."""
    if topic is None:
        return ()
    return tuple(_changing(log.topics[topic].columns, pattern))


def _changing(columns: Mapping[str, np.ndarray], pattern: str) -> Iterator[str]:
    for i in range(MAX_ROTORS):
        values = columns.get(pattern.format(i))
        if values is None or not np.isfinite(values).any() or np.nanmin(values) == np.nanmax(values):
            return
        yield pattern.format(i)

"""Reads flight tables from bags of this graph, and from those that `swiftros import` has written."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from swift_ros import geometry
from swift_ros.camera.model import Camera
from swift_ros.errors import UsageError
from swift_ros.graph.topic_table import full_name
from swift_ros.messages.control import from_command
from swift_ros.messages.gates import from_detections
from swift_ros.messages.motion import from_odometry
from swift_ros.messages.stamps import from_time
from swift_ros.messages.vectors import from_xyz
from swift_ros.recording import bags
from swift_ros.recording.checks import Rejection
from swift_ros.recording.flight_checks import checked_table
from swift_ros.recording.flight_table import DetectedGates, FlightTable, RowSampling, Samples
from swift_ros.recording.replay import find_bag
from swift_ros.track import Track

DETECTIONS = full_name("gates/detections")
IMPORTED, REJECTED = "imported", "rejected_data"  # custom data of a bag: topics of an importer, and its rejections
# Hz; cutoffs of the low-passes of the meters: Betaflight's vbat_display_lpf_period 30 and ibat_lpf_period 10
METER_CUTOFFS_HZ = {"voltage": 0.333, "current": 1.0}


def read(path: Path) -> FlightTable:
    """Return the flight in a bag, with times relative to the first stamp.

    Pose and velocity are those of the ground truth. Without it they are absent: an estimate must not be compared with
    itself.

    Topics that this graph recorded are corrected, those of an importer are not: motor commands are marked as incomplete
    (the flight controller runs faster than they are polled), the low-passes of the battery meters are inverted, and the
    velocity is removed, because the simulator's is half a step older than its position.

    Args:
        path: bag folder, folder with one bag below, or .mcap file.

    Raises:
        UsageError: there is no bag, or no flight in it.
    """
    bag = find_bag(path)
    readers = {full_name(topic): reader for topic, reader in _READERS.items()}
    rows: dict[str, list] = {}
    gates: list[tuple] = []
    for topic, message, _ in bags.read(bag, [*readers, DETECTIONS]):
        stamp_ns = from_time(message.header.stamp)
        if topic == DETECTIONS:
            gates += [(stamp_ns, gate.corners_px) for gate in from_detections(message)]
            continue
        for channel, value in readers[topic](message).items():
            rows.setdefault(channel, []).append((stamp_ns, value))
    if not rows:
        raise UsageError(f"{path} holds none of the topics {', '.join(_READERS)}; it is not a flight")
    begin_ns = min(channel[0][0] for channel in rows.values())
    raw = {channel: _samples(path, channel, values, begin_ns) for channel, values in rows.items()}
    custom = bags.custom_data(bag)
    imported = bags.stored_json(bag, IMPORTED, [])
    table = checked_table(
        bag.name,
        raw,
        _imported_rejections(bag),
        _detected_gates(gates, begin_ns, custom, bag),
        skips_commands="betaflight/rotors" not in imported,
    )
    channels = dict(table.channels)
    if "ground_truth/odometry" not in imported:
        channels.pop("v_world", None)
    if "battery" not in imported:
        meters = {name: hz for name, hz in METER_CUTOFFS_HZ.items() if name in table and len(table[name].t) > 2}
        channels |= {name: _without_low_pass(table[name], hz) for name, hz in meters.items()}
    at_their_stamps = {name: RowSampling("held") for name in channels if name != "motor_command"}
    return replace(table, channels=channels, sampling=at_their_stamps)


def is_of_another_graph(path: Path) -> bool:
    """Return whether a bag has none of this graph's topics of a flight. Raises UsageError when there is no bag."""
    return not {full_name(topic) for topic in _READERS} & set(bags.topics(find_bag(path)))


def _without_low_pass(samples: Samples, cutoff_hz: float) -> Samples:
    """Invert a first-order low-pass.

    Each result is the mean input over the step before a reading, weighted by the filter's response, at the mean time of
    those weights.
    """
    step, lag = np.diff(samples.t), 1.0 / (2 * np.pi * cutoff_hz)
    kept = np.exp(-step / lag)
    values = (samples.values[1:] - kept * samples.values[:-1]) / (1.0 - kept)
    return Samples(samples.t[1:] - lag + step * kept / (1.0 - kept), values)


def _detected_gates(rows: list[tuple], begin_ns: int, custom: dict[str, str], bag: Path) -> DetectedGates | None:
    """Return the detected gates of a bag; None without gates, or without a stored camera and track."""
    if not rows or not {"config/camera.yaml", "config/track.yaml"} <= set(custom):
        return None
    camera, track = bags.stored_record(bag, Camera, "camera.yaml"), bags.stored_record(bag, Track, "track.yaml")
    rows = sorted(rows, key=lambda row: row[0])
    t = np.array([stamp_ns - begin_ns for stamp_ns, _ in rows]) * 1e-9
    return DetectedGates(t, np.stack([corners for _, corners in rows]), camera, track)


def _samples(path: Path, channel: str, rows: list, begin_ns: int) -> Samples:
    if len({np.shape(value) for _, value in rows}) > 1:
        raise UsageError(
            f"{path}: {channel} changes its number of values in flight; the number of rotors must be constant"
        )
    t = np.array([stamp_ns - begin_ns for stamp_ns, _ in rows]) * 1e-9
    return Samples(t, np.array([value for _, value in rows], dtype=float))


def _imported_rejections(bag: Path) -> tuple[Rejection, ...]:
    """Return the rejections of the importer."""
    entries = bags.stored_json(bag, REJECTED, [])
    spans = ((entry, *entry["time"]) for entry in entries)
    return tuple(Rejection(begin_s, end_s, entry["channel"], entry["reason"]) for entry, begin_s, end_s in spans)


def _truth(message) -> dict:
    state = from_odometry(message)
    v_world = geometry.rotate(state.q_world_body, state.v_body)
    return {"p_world": state.p_world, "v_world": v_world, "q_world_body": state.q_world_body}


def _imu(message) -> dict:
    gyro, force = from_xyz(message.angular_velocity), from_xyz(message.linear_acceleration)
    return {"gyro_body": gyro, "specific_force_body": force}


def _rotors(message) -> dict:
    channels = {"rotor_speed": np.array(message.speed), "motor_command": np.array(message.motor)}
    return {channel: values for channel, values in channels.items() if values.size}


def _command(message) -> dict:
    command = from_command(message)
    return {"thrust_command": command.thrust, "omega_command_body": command.omega_body}


def _feedforward(message) -> dict:
    return {"feedforward_body": from_xyz(message.vector)}


def _battery(message) -> dict:
    return {"voltage": message.voltage, "current": -message.current}  # in ROS the current is negative while discharging


def _vio(message) -> dict:
    state = from_odometry(message)
    return {"p_vio": state.p_world, "q_vio_body": state.q_world_body}


_READERS = {
    "ground_truth/odometry": _truth,
    "imu/data_raw": _imu,
    "betaflight/rotors": _rotors,
    "betaflight/feedforward": _feedforward,
    "command/body_rate_thrust": _command,
    "battery": _battery,
    "vio/odometry": _vio,
}

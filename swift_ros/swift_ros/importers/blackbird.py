"""Importer of the Blackbird data set: flights of a 0.915 kg quadrotor under motion capture.

A recording is a folder with `data.hdf5` and the poses of the IMU. It uses the IMU's own axes: z down, yawed by 90
degrees relative to the airframe, so that the vehicle flies along -y. The airframe's forward-left-up axes are therefore
the IMU's -y, -x, -z.
"""

from pathlib import Path

import h5py
import numpy as np

from swift_ros import geometry
from swift_ros.errors import UsageError
from swift_ros.importers import flight
from swift_ros.importers.flight import (
    ChannelChecker,
    ForeignFlight,
    body_rates,
    imu_stream,
    odometry_stream,
    rotor_stream,
)
from swift_ros.recording.checks import SensorChannel, check_time
from swift_ros.text import excerpt

DATA, POSES = "data.hdf5", "stamped_groundtruth_imu.txt"
R_IMU_BODY = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
MASS = 0.915  # kg, published with the data set
THRUST_PER_RPM2 = 2.03e-8  # N/rpm^2 of one rotor, published with the data set
ROTORS = 4
# What h5py raises for a damaged file.
_DAMAGED = (OSError, RuntimeError, KeyError, ValueError, TypeError, AttributeError, OverflowError, MemoryError)

NOTES = {
    "source": "Blackbird data set (Antonini et al., MIT), quadrotor of 0.915 kg, MIT licence",
    "vio/odometry": "motion capture played as odometry: the recording has no on-board estimate",
    "ground_truth/odometry": "motion capture",
    "frames": "map = motion capture's world, z up; base_link = airframe forward-left-up (the IMU's -y, -x, -z); its "
    "origin is the tracked point, whose offset from the centre of mass is not published",
    "betaflight/rotors": "each speed is the root mean square of all four, from the published sum of their squares; "
    "motor commands and single speeds were not published",
}


def find(path: Path) -> list[Path]:
    """Return the folders of recordings at or below a path."""
    if path.is_file():
        return [path.parent] if path.name in (DATA, POSES) else []
    return sorted(file.parent for file in path.rglob(DATA))


def read(source: Path) -> ForeignFlight:
    """Return the recording in a folder. Raises UsageError when it is not one."""
    data, poses = _read_data(source / DATA), _read_poses(source / POSES)
    if len(poses) != len(data["ts"]) or np.abs(poses[:, 0] - data["ts"]).max(initial=0.0) > 1e-6:
        raise UsageError(f"{source}: the times of {DATA} and {POSES} differ; they must be from one recording")
    good_times, rejections = check_time(data["ts"])
    t, poses = data["ts"][good_times], poses[good_times]
    if len(t) < 2:
        raise UsageError(f"{source} has fewer than two rows with increasing times; it is not a flight")
    gyro_imu, force_imu, thrust_imu = (data[name][good_times] for name in ("gyro_raw", "accel_raw", "thrust"))
    checker = ChannelChecker(t, rejections)
    pose_good = checker.good(SensorChannel("motion capture position", poses[:, 1:4], -1000.0, 1000.0, "m"))
    pose_good &= checker.unit_quaternions("motion capture attitude", poses[:, 4:8])
    pose_good &= checker.good(SensorChannel("motion capture velocity", poses[:, 8:11], -60.0, 60.0, "m/s"))
    imu_good = checker.good(SensorChannel("gyro", gyro_imu, -35.0, 35.0, "rad/s"))
    imu_good &= checker.good(SensorChannel("accelerometer", force_imu, -160.0, 160.0, "m/s^2"))
    thrust = -thrust_imu[:, 2]
    thrust_good = checker.good(SensorChannel("thrust", thrust, 0.0, 80.0, "m/s^2", noisy=False))

    q_world_body = geometry.quaternion_multiply(poses[:, 4:8], geometry.quaternion_from_matrix(R_IMU_BODY))
    omega_body = body_rates(t, geometry.normalize(q_world_body))
    pose = (pose_good, poses[:, 1:4], q_world_body, poses[:, 8:11], omega_body)
    streams = (
        odometry_stream("ground_truth/odometry", *pose),
        odometry_stream("vio/odometry", *pose),
        imu_stream(imu_good, gyro_imu @ R_IMU_BODY, force_imu @ R_IMU_BODY),
        rotor_stream(thrust_good, rotor_speed(thrust), np.zeros((len(t), 0))),
    )
    notes = NOTES | flight.ALIGNED_WITH_MAP
    name = f"blackbird-{source.resolve().name}"
    return ForeignFlight(name, t, streams, notes, tuple(checker.rejections))


def rotor_speed(thrust) -> np.ndarray:
    """Return the root-mean-square rotor speed (n, 4) rad/s for a mass-normalised thrust (n,) m/s^2."""
    rpm = np.sqrt(np.maximum(thrust, 0.0) * MASS / THRUST_PER_RPM2 / ROTORS)
    return np.repeat(rpm[:, None] * (2.0 * np.pi / 60.0), ROTORS, axis=1)


def _read_data(path: Path) -> dict[str, np.ndarray]:
    dimensions_by_name = {"ts": 1, "gyro_raw": 2, "accel_raw": 2, "thrust": 2}
    try:
        with h5py.File(path, "r") as file:
            missing = [name for name in dimensions_by_name if name not in file]
            if missing:
                raise UsageError(f"{path} is not a Blackbird recording: it lacks {missing[0]}")
            data = {name: np.asarray(file[name], dtype=float) for name in dimensions_by_name}
    except _DAMAGED as error:
        raise UsageError(f"{path} cannot be read as HDF5: {excerpt(str(error))}") from error
    n = len(data["ts"])
    for name, dimensions in dimensions_by_name.items():
        if data[name].shape != (n, 3)[:dimensions]:
            raise UsageError(f"{path}: {name} has the shape {data[name].shape}, not {(n, 3)[:dimensions]}")
    return data


def _read_poses(path: Path) -> np.ndarray:
    try:
        poses = np.loadtxt(path, ndmin=2)
    except (OSError, ValueError) as error:
        raise UsageError(f"{path} cannot be read: {excerpt(str(error))}") from error
    if poses.shape[1] != 11:
        raise UsageError(f"{path} has {poses.shape[1]} columns, not 11: time, position, quaternion, velocity")
    return poses

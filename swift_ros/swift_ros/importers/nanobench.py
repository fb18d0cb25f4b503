"""Importer of the NanoBench data set: flights of a Crazyflie 2.1 with brushed motors under Vicon motion capture.

A recording is a pair of files `NAME.csv.gz` and `NAME_metadata.yaml`. The table is on the clock of the motion capture.
The vehicle's own channels were sent by radio at about 40 Hz and resampled to that clock: straight lines fill the gaps
and the time after the end of the log.
"""

from pathlib import Path

import numpy as np

from swift_ros.errors import UsageError
from swift_ros.importers import flight
from swift_ros.importers.flight import (
    ChannelChecker,
    ForeignFlight,
    battery_stream,
    imu_stream,
    odometry_stream,
    rotor_stream,
)
from swift_ros.recording.checks import SensorChannel, check_time
from swift_ros.recording.table_formats import csv_rows
from swift_ros.vehicle import GRAVITY

SUFFIX = ".csv.gz"
FULL_PWM = 65535.0  # motor command at full throttle
BATTERY_EVERY_S = 0.1  # s; the battery was logged at 10 Hz

POSITION, ATTITUDE, VELOCITY = ("px", "py", "pz"), ("qx", "qy", "qz", "qw"), ("vx", "vy", "vz")
RATES = ("wx_vicon", "wy_vicon", "wz_vicon")
GYRO, FORCE_G = (tuple(f"imu_{kind}_{axis}" for axis in "xyz") for kind in ("gyro", "acc"))
MOTORS = tuple(f"motor_motor_m{i}" for i in range(1, 5))
OWN_POSITION, OWN_VELOCITY = (tuple(f"est_stateEstimate_{v}{axis}" for axis in "xyz") for v in ("", "v"))
OWN_ATTITUDE = tuple(f"att_stateEstimate_q{axis}" for axis in "xyzw")
VOLTAGE = "pwr_pm_vbat"
COLUMNS = (
    *POSITION,
    *ATTITUDE,
    *VELOCITY,
    *RATES,
    *GYRO,
    *FORCE_G,
    *MOTORS,
    *OWN_POSITION,
    *OWN_VELOCITY,
    *OWN_ATTITUDE,
    VOLTAGE,
)

NOTES = {
    "source": "NanoBench: Crazyflie 2.1 (brushed) under Vicon, BSD-3-Clause",
    "vio/odometry": "the vehicle's own estimate (on-board Kalman filter, which used the motion capture); no camera",
    "ground_truth/odometry": "Vicon motion capture",
    "frames": "map = Vicon's world, z up; base_link = Crazyflie's body, forward-left-up",
    "betaflight/rotors": "motor = PWM / 65535 in the Crazyflie's order M1 to M4 (front right, rear right, rear left, "
    "front left); speeds were not measured",
}


def find(path: Path) -> list[Path]:
    """Return the recordings at a file or in a folder."""
    if path.is_file():
        return [path] if path.name.endswith(SUFFIX) else []
    return sorted(path.rglob(f"*{SUFFIX}"))


def read(source: Path) -> ForeignFlight:
    """Return one recording. Raises UsageError when the file is not one."""
    columns = read_table(source)
    good_times, rejections = check_time(columns["t"])
    t = columns["t"][good_times]
    if len(t) < 2:
        raise UsageError(f"{source} has fewer than two rows with increasing times; it is not a flight")
    checker = ChannelChecker(t, rejections)

    def values_of(names) -> np.ndarray:
        return np.stack([columns[name][good_times] for name in names], axis=-1)

    pose_good = checker.good(SensorChannel("motion capture position", values_of(POSITION), -1000.0, 1000.0, "m"))
    pose_good &= checker.unit_quaternions("motion capture attitude", values_of(ATTITUDE))
    pose_good &= checker.good(SensorChannel("motion capture velocity", values_of(VELOCITY), -60.0, 60.0, "m/s"))
    pose_good &= checker.good(SensorChannel("motion capture rates", values_of(RATES), -60.0, 60.0, "rad/s"))
    gyro_good = checker.good(SensorChannel("gyro", values_of(GYRO), -35.0, 35.0, "rad/s"))
    force_good = checker.good(SensorChannel("accelerometer", values_of(FORCE_G), -24.0, 24.0, "g"))
    own_good = checker.good(SensorChannel("own position", values_of(OWN_POSITION), -1000.0, 1000.0, "m"))
    own_good &= checker.good(SensorChannel("own velocity", values_of(OWN_VELOCITY), -60.0, 60.0, "m/s"))
    own_good &= checker.unit_quaternions("own attitude", values_of(OWN_ATTITUDE))
    motor_good = checker.good(SensorChannel("motors", values_of(MOTORS), 0.0, FULL_PWM, "PWM", noisy=False))
    voltage = values_of((VOLTAGE,))[:, 0]
    voltage_good = checker.good(SensorChannel("battery", voltage, 2.5, 4.4, "V", noisy=False))
    tenth = np.floor((t - t[0]) / BATTERY_EVERY_S)
    voltage_good &= np.diff(tenth, prepend=-1.0) > 0

    truth = (values_of(names) for names in (POSITION, ATTITUDE, VELOCITY, RATES))
    own = (values_of(names) for names in (OWN_POSITION, OWN_ATTITUDE, OWN_VELOCITY, GYRO))
    streams = (
        odometry_stream("ground_truth/odometry", pose_good, *truth),
        odometry_stream("vio/odometry", own_good & gyro_good, *own),
        imu_stream(gyro_good & force_good, values_of(GYRO), GRAVITY * values_of(FORCE_G)),
        rotor_stream(motor_good, np.full((len(t), 4), np.nan), values_of(MOTORS) / FULL_PWM),
        battery_stream(voltage_good, voltage),
    )
    name = source.name.removesuffix(SUFFIX)
    notes = NOTES | flight.ALIGNED_WITH_MAP | _metadata(source, name)
    return ForeignFlight(name, t, streams, notes, tuple(checker.rejections))


def read_table(source: Path) -> dict[str, np.ndarray]:
    """Return the columns (n,) by name, NaN where a cell is empty. Raises UsageError, and warns, as `csv_rows.read`."""
    columns = csv_rows.read(source, "t")
    missing = [name for name in ("t", *COLUMNS) if name not in columns]
    if missing:
        raise UsageError(f"{source} is not a NanoBench recording: it lacks the column {missing[0]}")
    return columns


def _metadata(source: Path, name: str) -> dict[str, str]:
    path = source.with_name(f"{name}_metadata.yaml")
    return {path.name: path.read_text(encoding="utf-8", errors="replace")} if path.is_file() else {}

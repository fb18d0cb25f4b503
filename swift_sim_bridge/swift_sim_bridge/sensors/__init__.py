"""Sensors of the simulated vehicle, and the errors that a vehicle file enables by its `terms`.

The errors are functions on arrays of a whole flight; classes around them hold the state between ticks. Constants of the
shipped sensors stand in `config/simulation.yaml`.

Modules:
    clock: motion at past times, and delays.
    imu_calibration, imu_errors, imu: gyro and accelerometer.
    motion_capture: pose of the markers.
    vio, coloured_noise: visual-inertial odometry and its coloured errors.
    camera, world: camera and map.
    attitude: the flight controller's attitude estimate.
    terms: all terms of the sensors.
    suite: the sensors of one tick.
    recording: the flight table of a known flight.
"""

from swift_sim_bridge.sensors.attitude import AttitudeEstimate, AttitudeSettings
from swift_sim_bridge.sensors.imu import Imu, ImuSettings
from swift_sim_bridge.sensors.vio import Vio, VioSettings

__all__ = ["AttitudeEstimate", "AttitudeSettings", "Imu", "ImuSettings", "Vio", "VioSettings"]

"""Sensors of the simulated vehicle: what each measures of the truth, and the errors that a vehicle file switches on.

A sensor's errors are pure functions on arrays of a whole flight; the classes around them keep what one tick leaves to
the next. Constants of the sensors as they are shipped stand in `config/simulation.yaml`; `terms` lists the errors,
which are absent by default; `recording` makes the flight table that instruments would have written of a known flight.
"""

from swift_sim_bridge.sensors.attitude import AttitudeEstimate, AttitudeSettings
from swift_sim_bridge.sensors.imu import Imu, ImuSettings
from swift_sim_bridge.sensors.vio import Vio, VioSettings

__all__ = ["AttitudeEstimate", "AttitudeSettings", "Imu", "ImuSettings", "Vio", "VioSettings"]

"""Observer of the battery's voltage under a commanded thrust.

The flight controller's voltmeter is slow (Betaflight low-passes it with 0.33 Hz), but thrust makes the voltage sag at
once. The sag is therefore computed from the thrust with the vehicle file's battery, and the voltmeter corrects only
slow changes: the charge, and errors of the battery's parameters.
"""

import math

import numpy as np
from array_api_compat import array_namespace

from swift_ros.vehicle import Vehicle, rotor_speed_for_thrust


def voltage_under(thrust, source_voltage, vehicle: Vehicle):
    """Return the voltage at the battery's terminals under load.

    It solves U = source - R P/U with the power P of rotors and avionics.

    Args:
        thrust: (...) m/s^2, mass-normalised collective thrust that the rotors hold.
        source_voltage: (...) V behind the battery's resistance R.
        vehicle: vehicle file.

    Returns:
        (...) V.
    """
    xp = array_namespace(thrust)
    battery, rotors = vehicle.battery, len(vehicle.rotors)
    speed = rotor_speed_for_thrust(thrust, vehicle.mass, vehicle.thrust_coefficient, rotors)
    power = rotors * vehicle.torque_coefficient * speed**3 / battery.efficiency + battery.avionics_w
    discriminant = source_voltage * source_voltage - 4.0 * battery.resistance * power
    return 0.5 * (source_voltage + xp.sqrt(xp.clip(discriminant, 0.0, None)))


class PackObserver:
    """Observes the voltage behind the battery's resistance.

    The voltmeter's low-pass also runs on the predicted voltage. The difference between reading and prediction corrects
    `source_voltage` with twice the voltmeter's time constant, which converges with negligible overshoot.

    Attributes:
        source_voltage: V; None before the first reading.
    """

    def __init__(self, vehicle: Vehicle, meter_s: float):
        """Start without a reading; `meter_s` is the time constant of the flight controller's voltmeter, s."""
        self.source_voltage: float | None = None
        self._vehicle, self._meter_s = vehicle, max(meter_s, 1e-3)
        self._voltage = self._predicted_reading = math.nan
        self._time_s = 0.0

    def measure(self, reading: float, time_s: float) -> None:
        """Take a reading (V) of the voltmeter; zero and less are ignored."""
        if reading <= 0:
            return
        if self.source_voltage is None:
            # At rest only the avionics draw current; their sag is below the voltmeter's resolution.
            self.source_voltage = self._voltage = self._predicted_reading = reading
            self._measured_s = self._time_s = time_s
            return
        self._run_meter(time_s)
        share = -math.expm1(-(time_s - self._measured_s) / (2.0 * self._meter_s))
        self.source_voltage += share * (reading - self._predicted_reading)
        self._measured_s = time_s

    def predict(self, thrust: float, time_s: float) -> float | None:
        """Return the voltage (V) under a thrust (m/s^2) that is commanded from `time_s` on; None before a reading."""
        if self.source_voltage is None:
            return None
        self._run_meter(time_s)
        self._voltage = float(voltage_under(np.asarray(thrust), self.source_voltage, self._vehicle))
        return self._voltage

    def _run_meter(self, time_s: float) -> None:
        """Advance the voltmeter's low-pass on the predicted voltage to `time_s`."""
        gain = -math.expm1(-(time_s - self._time_s) / self._meter_s)
        self._predicted_reading += gain * (self._voltage - self._predicted_reading)
        self._time_s = time_s

"""The battery's voltage under the thrust about to be asked for.

The flight controller's meter is slow (Betaflight shows voltage through a low-pass of 0.33 Hz), and thrust makes the
voltage sag at once. So the sag is computed from the thrust, by the vehicle file's pack, and the meter only corrects
the slow rest: charge, and whatever the pack's figures get wrong.
"""

import math

import numpy as np
from array_api_compat import array_namespace

from swift_ros.vehicle import Vehicle, rotor_speed_for_thrust


def voltage_under(thrust, source_voltage, vehicle: Vehicle):
    """Return the pack's voltage (...) V while the rotors hold a collective thrust (...) m/s^2, mass-normalised.

    source_voltage: (...) V behind the pack's resistance R; U = source - R P/U with the power P of rotors and avionics.
    """
    xp = array_namespace(thrust)
    battery, rotors = vehicle.battery, len(vehicle.rotors)
    speed = rotor_speed_for_thrust(thrust, vehicle.mass, vehicle.thrust_coefficient, rotors)
    power = rotors * vehicle.torque_coefficient * speed**3 / battery.efficiency + battery.avionics_w
    inside = source_voltage * source_voltage - 4.0 * battery.resistance * power
    return 0.5 * (source_voltage + xp.sqrt(xp.clip(inside, 0.0, None)))


class Pack:
    """Observes the voltage behind the pack's resistance. meter_s: time constant of the flight controller's voltmeter.

    source: V, None before the first measurement. The same low-pass runs on the predicted voltage; what the meter shows
    beyond that moves `source`, twice as slowly as the meter, which settles without overshoot worth mention.
    """

    def __init__(self, vehicle: Vehicle, meter_s: float):
        self.source: float | None = None
        self._vehicle, self._meter_s = vehicle, max(meter_s, 1e-3)
        self._voltage = self._shown = math.nan
        self._time_s = 0.0

    def measure(self, shown: float, time_s: float) -> None:
        """Take a reading (V) of the voltmeter; one of zero or less is none."""
        if shown <= 0:
            return
        if self.source is None:
            # At rest only the avionics draw, whose sag is below what the meter resolves.
            self.source = self._voltage = self._shown = shown
            self._measured_s = self._time_s = time_s
            return
        self._run(time_s)
        share = -math.expm1(-(time_s - self._measured_s) / (2.0 * self._meter_s))
        self.source += share * (shown - self._shown)
        self._measured_s = time_s

    def load(self, thrust: float, time_s: float) -> float | None:
        """Return the voltage (V) under a thrust (m/s^2) that is asked for from `time_s` on; None before a reading."""
        if self.source is None:
            return None
        self._run(time_s)
        self._voltage = float(voltage_under(np.asarray(thrust), self.source, self._vehicle))
        return self._voltage

    def _run(self, time_s: float) -> None:
        """Let the meter follow the voltage up to `time_s`."""
        self._shown += -math.expm1(-(time_s - self._time_s) / self._meter_s) * (self._voltage - self._shown)
        self._time_s = time_s

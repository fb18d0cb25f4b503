"""Whether the rotors turn the vehicle the way its file says: their moments beside the angular acceleration.

A rotor in another place of the file, or a propeller that spins the other way, turns the sign of a moment. No parameter
of the vehicle does. A rate loop that answers disturbances, late as it is, does not turn it either, nor do rotors whose
own acceleration yaws the vehicle more than their drag: only an axis is against the file whose moments and accelerations
are opposed at all short delays.
"""

from itertools import permutations
from typing import NamedTuple

import numpy as np
from scipy import signal

from swift_ros.vehicle import Vehicle

BAND_HZ = 1.0, 12.0  # of the rotations that are compared: above trim and slow disturbances, below noise
MIN_RATE_HZ = 30.0  # of the recording
MAX_DELAY_S, DELAY_STEP_S = 0.06, 0.01  # between the moment of commands and the acceleration; measured speeds have none
MIN_CORRELATION = 0.3  # of moment and acceleration, from which their sign is certain
MIN_DEVIATIONS = 5.0  # the same in standard deviations of the correlation of unrelated signals
OPPOSED_SHARE = 0.5  # of that correlation, which opposed moments reach at every delay
MAX_ROTORS = 6  # of which all orders are tried
TINY = 1e-300  # of squares that are zero
AXES = "roll", "pitch", "yaw"


class _Products(NamedTuple):
    """Products of r thrusts and the angular acceleration, in a band.

    Attributes:
        thrusts: (r, r).
        acceleration: (3,).
        both: (d, r, 3) at d delays.
        least: smallest correlation whose sign is certain.
    """

    thrusts: np.ndarray
    acceleration: np.ndarray
    both: np.ndarray
    least: float

    def correlation(self, effect) -> np.ndarray:
        """Return by axis (3,) the largest correlation over the delays, 0 where it is negative at some of them alone.

        Args:
            effect: (r, 3) moment of the thrust of each rotor about roll, pitch and yaw, in any unit.
        """
        moments = np.einsum("ra,rs,sa->a", effect, self.thrusts, effect)
        found = np.einsum("ra,dra->da", effect, self.both) / np.sqrt(np.maximum(moments * self.acceleration, TINY))
        largest = found[np.abs(found).argmax(axis=0), np.arange(len(AXES))]
        opposed = np.max(found, axis=0) < -OPPOSED_SHARE * self.least
        return np.where((largest > 0) | opposed, largest, 0.0)


def contradiction(recording, vehicle: Vehicle) -> str | None:
    """Return a sentence about rotors in another order, or with other spins, than those of the vehicle file.

    Args:
        recording: a `recording.Recording`.
        vehicle: the vehicle as its file describes it.

    Returns:
        None where the moments agree, or where no order explains the disagreement.
    """
    found = _products(recording, vehicle)
    if found is None:
        return None
    effect = np.array([(one.position[1], -one.position[0], -one.spin) for one in vehicle.rotors])
    as_is = found.correlation(effect)
    against = [axis for axis, one in zip(AXES, as_is, strict=True) if one < -found.least]
    if not against:
        return None
    as_filed = tuple(range(len(effect)))
    orders = permutations(as_filed) if len(effect) <= MAX_ROTORS else [as_filed]
    tried = [(order, spin) for order in orders for spin in (1.0, -1.0)]
    agree = [found.correlation(_moved(effect, *one)) for one in tried]
    best = int(np.argmax([one.sum() for one in agree]))
    (order, spin), correlation = tried[best], agree[best]
    if min(correlation[:2]) < found.least or correlation[2] < 0:
        return None
    mistakes = []
    if order != as_filed:
        own, of_file = (", ".join(str(i + 1) for i in one) for one in (as_filed, order))
        mistakes.append(f"its motors {own} are the rotors {of_file} of the file")
    if spin < 0:
        mistakes.append("its propellers spin the other way")
    return f"the motors {' and '.join(against)} against the vehicle file; {', and '.join(mistakes)}"


def _moved(effect, order, spin: float) -> np.ndarray:
    """Return the effects (r, 3) with the rotors of the recording at other places of the file."""
    return effect[list(order)] * [1.0, 1.0, spin]


def _products(recording, vehicle: Vehicle) -> _Products | None:
    """Return the products, None where single rotors or rotations are unknown or hardly vary."""
    speed, rate_hz = recording.single_rotor_speeds, 1.0 / recording.dt
    if speed is None or recording.gyro_body is None or rate_hz < MIN_RATE_HZ:
        return None
    used = recording.good & recording.flown
    band = signal.butter(2, BAND_HZ, "bandpass", fs=rate_hz, output="sos")
    thrusts = signal.sosfiltfilt(band, vehicle.thrust_coefficient * speed**2, axis=0)
    acceleration = np.gradient(signal.sosfiltfilt(band, recording.gyro_body, axis=0), recording.dt, axis=0)
    longest_s = MAX_DELAY_S if recording.rotor_speed_modelled else DELAY_STEP_S
    delays = [round(delay / recording.dt) for delay in np.arange(0.0, longest_s, DELAY_STEP_S)]
    both = []
    for delay in delays:
        rows = used[: len(used) - delay] & used[delay:]
        both.append(thrusts[: len(used) - delay][rows].T @ acceleration[delay:][rows])
    independent = 2.0 * (BAND_HZ[1] - BAND_HZ[0]) * np.count_nonzero(used) * recording.dt
    squares = np.sum(acceleration[used] ** 2, axis=0)
    if not independent or not np.all(squares > 0):
        return None
    least = max(MIN_CORRELATION, MIN_DEVIATIONS / np.sqrt(independent))
    return _Products(thrusts[used].T @ thrusts[used], squares, np.stack(both), least)

"""The place and spin of each motor, from motor commands and the angular acceleration that they cause.

In the body frame a rotor on the left rolls to the right, a rotor behind pitches the nose down, and a counter-clockwise
propeller yaws to the right: for the moment of thrust T at (x, y) is (y T, -x T), and that of drag opposes the spin.
"""

from dataclasses import dataclass
from itertools import permutations

import numpy as np

from swift_ros.errors import UsageError
from swift_ros.recording.log_mapping.conversion import Signal
from swift_ros.vehicle import Vehicle

GRID_HZ = 100.0
BAND_HZ = 1.0, 12.0  # of the rotations that are compared: above bias and slow disturbances, below noise
MAX_LAG_S, LAG_STEP_S = 0.15, 0.01  # between command and angular acceleration: motors, filters, recording
MIN_RATE_HZ = 25.0  # of commands and gyro
MIN_SHARE = 0.3  # of the variance of roll and pitch acceleration that the commands must explain
MIN_EQUAL = 0.25  # smallest effect of a motor, as a share of the largest one
MIN_S, MAX_S = 4.0, 1e4  # s, of a log


@dataclass(frozen=True)
class MotorOrder:
    """Signs of the moments of each motor about forward, left and up (rotors, 3); 0 where they are not observable."""

    signs: np.ndarray

    def __str__(self) -> str:
        return ", ".join(f"{i} {_named(row)}" for i, row in enumerate(self.signs, start=1))


def estimate(command: Signal, gyro: Signal) -> MotorOrder | None:
    """Return the order of the motors, None where roll and pitch are not observable.

    Args:
        command: motor commands or rotor speeds (n, rotors).
        gyro: body rates (n, 3) rad/s.
    """
    from scipy import signal  # takes a second to import, and the class above is a part of every flight table

    begin, end = max(command.t[0], gyro.t[0]), min(command.t[-1], gyro.t[-1])
    slow = min(1.0 / np.median(np.diff(one.t)) for one in (command, gyro))
    if not MIN_S < end - begin < MAX_S or slow < MIN_RATE_HZ or command.values.shape[1] < 3:
        return None
    grid = np.arange(begin, end - MAX_LAG_S, 1.0 / GRID_HZ)
    band = signal.butter(2, np.array(BAND_HZ), "bandpass", fs=GRID_HZ, output="sos")

    def filtered(t, values) -> np.ndarray:
        even = np.stack([np.interp(grid, t, column) for column in values.T], axis=-1)
        return np.asarray(signal.sosfiltfilt(band, even, axis=0))

    # all motors together cause no moment: the mean command would only fit noise
    commands = filtered(command.t, command.values - command.values.mean(axis=1, keepdims=True))
    best: tuple[float, np.ndarray] = (0.0, np.zeros((command.values.shape[1], 3)))
    for lag in np.arange(0.0, MAX_LAG_S, LAG_STEP_S):
        acceleration = np.gradient(filtered(gyro.t - lag, gyro.values), 1.0 / GRID_HZ, axis=0)
        effect, *_ = np.linalg.lstsq(commands, acceleration, rcond=1e-3)
        rest = np.sum((acceleration - commands @ effect) ** 2, axis=0)
        shares = 1.0 - rest / np.maximum(np.sum(acceleration**2, axis=0), 1e-12)
        if min(shares[:2]) > best[0]:
            best = float(min(shares[:2])), effect
    share, effect = best
    largest = np.maximum(np.abs(effect).max(axis=0), 1e-12)
    clear = (np.abs(effect) > MIN_EQUAL * largest).all(axis=0)
    if share < MIN_SHARE or not clear[:2].all():
        return None
    return MotorOrder(np.where(clear, np.sign(effect), 0.0))


def refuse_another_order(name: str, found: MotorOrder, vehicle: Vehicle, columns: tuple[str, ...]) -> None:
    """Raise UsageError where the rotors of the vehicle file are in another order than the motors of a recording.

    Args:
        name: of the recording.
        found: order of its motors.
        vehicle: the vehicle.
        columns: names of the motors' columns.
    """
    expected = np.array([(np.sign(r.position[1]), -np.sign(r.position[0]), -r.spin) for r in vehicle.rotors])
    if len(expected) != len(found.signs):
        raise UsageError(
            f"{name} has {len(found.signs)} motors, the vehicle file {len(expected)} rotors; give the vehicle file of "
            "this flight"
        )
    observed = found.signs != 0
    if np.all((found.signs == expected) | ~observed) or len(expected) > 6:
        return
    start = f"{name}: by the gyro its motors are {found}, and the rotors of the vehicle file are {MotorOrder(expected)}"
    for order in permutations(range(len(expected))):
        if np.all((found.signs[list(order)] == expected) | ~observed[list(order)]):
            columns_in_order = ", ".join(columns[i] for i in order)
            raise UsageError(f"{start}; give its columns as [{columns_in_order}] in a mapping (--mapping FILE)")
    raise UsageError(f"{start}; give the vehicle file of this flight, with its spins")


def _named(signs) -> str:
    """Return the place and spin of a motor in words."""
    roll, pitch, yaw = signs
    spin = {1.0: ", clockwise", -1.0: ", counter-clockwise"}.get(float(yaw), "")
    return f"{'rear' if pitch > 0 else 'front'} {'left' if roll > 0 else 'right'}{spin}"

"""The level of an error in a flight: its slow part, from the flight's own past.

Accelerometer bias, trim, load and pack differ from flight to flight and change slowly in one. What flies estimates them
on the way, and so does a prediction that may use what the flight has measured so far.
"""

import numpy as np
from scipy import signal

TIME_S = 5.0  # after which the weight of an error has fallen by e: longer than a manoeuvre, shorter than a discharge
DELAY_S = 0.1  # age of the newest error that is used: its filter reaches 0.08 s on at most, none of what is predicted
PRIOR_S = 1.0  # duration of errors of zero before the first: a few errors are no level
TINY = 1e-30


def running_level(t, errors) -> np.ndarray:
    """Return at each time the weighted mean (n, k) of the errors before it.

    Args:
        t: (n,) times s on a uniform grid that may have gaps.
        errors: (n, k) at these times, NaN where nothing was measured.
    """
    if len(t) < 2:
        return np.zeros_like(errors)
    step = np.min(np.diff(t))
    index = np.round((t - t[0]) / step).astype(int)
    known = np.isfinite(errors)
    dense = np.zeros((2, index[-1] + 1, errors.shape[1]))
    dense[:, index] = known, np.where(known, errors, 0.0)
    delay = np.append(np.zeros(int(np.ceil(DELAY_S / step - 1e-6))), 1.0)
    weight, total = signal.lfilter(delay, [1.0, -np.exp(-step / TIME_S)], dense, axis=1)[:, index]
    prior = PRIOR_S / step * np.exp(-(t - t[0]) / TIME_S)
    return total / (weight + prior[:, None] + TINY)

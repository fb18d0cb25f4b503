"""Process noise that is too weak to be simulated, and what is slower than it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from swift_sim_bridge.gap.attribution.process_noise import window_squares_of_noise
from swift_sim_bridge.gap.attribution.unexplained import SLOW_RATIO
from swift_sim_bridge.gap.inference.null_distribution import difference_variance, window_squares
from swift_sim_bridge.gap.inference.sensitivity import Linearisation
from swift_sim_bridge.gap.nominal.reference_flights import unit_process_noise
from swift_sim_bridge.gap.residuals.filters import Filter, apply

DT, COUNT = 0.006, 5000  # a recording of 30 s


def lines(seed: int):
    """Return the angular acceleration of a gyro's noise, the same with weak process noise, and with a slow drift."""
    low, rng = Filter(COUNT, DT), np.random.default_rng(seed)
    gyro = apply(low.slope, rng.standard_normal((COUNT, 1)))
    t = low.rows * DT
    pushed = 0.6 * gyro.std() * apply(low.smooth, unit_process_noise((1, COUNT), DT, seed).T)
    drift = 0.6 * gyro.std() * np.sqrt(2.0) * np.sin(2.0 * np.pi * 0.3 * t)[:, None]
    plain = Linearisation(t, gyro, np.zeros((0, *gyro.shape)), np.ones(len(t), bool))
    return low, plain, replace(plain, residual=gyro + pushed), replace(plain, residual=gyro + drift)


def test_weak_process_noise_is_slow_beside_that_of_a_gyro_and_a_drift_is_slower():
    slow, allowed = [], []
    for seed in range(10):
        low, plain, pushed, drifting = lines(seed)
        recording = SimpleNamespace(t=np.arange(COUNT) * DT, dt=DT)
        model = SimpleNamespace(recording=recording, filter=low, channels=[SimpleNamespace(layer="moment")])
        usual, reference = window_squares(plain), difference_variance(plain)
        slow.append([window_squares(one) / usual for one in (pushed, drifting)])
        allowed.append([1.0 + window_squares_of_noise(model, one, reference) / usual for one in (pushed, drifting)])
    slow, allowed = np.array(slow)[..., 0], np.array(allowed)[..., 0]
    assert np.count_nonzero(slow[:, 0] > SLOW_RATIO) > 7, slow[:, 0]  # these would be unexplained
    assert np.all(slow[:, 0] < allowed[:, 0]), slow[:, 0] / allowed[:, 0]
    assert np.all(slow[:, 1] > SLOW_RATIO * allowed[:, 1]), slow[:, 1] / allowed[:, 1]

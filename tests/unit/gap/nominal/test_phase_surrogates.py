"""Surrogates of channels that no reference flight has."""

import numpy as np
import pytest

from swift_sim_bridge.gap.inference.sensitivity import Linearisation
from swift_sim_bridge.gap.nominal import phase_surrogates

ROWS, RATE = 1500, 50


def line_of(residual, sensitivity) -> Linearisation:
    return Linearisation(np.arange(len(residual)) / RATE, residual, sensitivity, np.ones(len(residual), bool))


def test_a_channel_that_no_reference_flight_has_gets_noise_with_the_spectrum_of_the_recording():
    rng = np.random.default_rng(3)
    sensitivity = np.cumsum(rng.standard_normal((ROWS, 1)), axis=0)[None]
    noise = np.convolve(rng.standard_normal(ROWS + 9), np.ones(10) / 10.0, "valid")[:, None]
    own = line_of(
        np.concatenate([np.zeros((ROWS, 1)), noise - 3.0 * sensitivity[0]], axis=1),
        np.concatenate([np.zeros((1, ROWS, 1)), sensitivity], axis=2),
    )
    flown = line_of(np.zeros((ROWS - 7, 1)), np.zeros((1, ROWS - 7, 1)))
    lines = [flown]
    phase_surrogates.add_surrogate_channels(lines, own, [np.ones((ROWS, 1))] * 2, 0)
    (reference,) = lines
    drawn = reference.residual[:, 1]
    assert drawn.std() == pytest.approx(noise.std(), rel=0.1)
    assert np.corrcoef(drawn[1:], drawn[:-1])[0, 1] == pytest.approx(0.9, abs=0.1)
    assert reference.sensitivity.shape == (1, ROWS - 7, 2)

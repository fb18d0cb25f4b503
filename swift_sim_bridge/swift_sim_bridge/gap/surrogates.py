"""Twins' share of what no twin flies: VIO and the commands' way, of whose noise the vehicle file knows nothing.

A twin borrows the recording's own: what is left of it beside all effects and quantities that show there, its phases
drawn anew (Theiler 1992): noise of the same colour that goes with no motion.
"""

from dataclasses import replace

import numpy as np

from swift_sim_bridge.gap.footprints import Linearisation
from swift_sim_bridge.gap.nulls import solve


def completed(twins: list[Linearisation], own: Linearisation, known: list[np.ndarray], seed: int
              ) -> list[Linearisation]:  # fmt: skip
    """Return the twins with the channels that the recording has beyond theirs, the last ones of its linearisation.

    known: for each channel of the recording quantities (m, q) by which it may go, so that this is no noise.
    """
    flown = twins[0].residual.shape[1]
    if own.residual.shape[1] == flown:
        return twins
    rng, left = np.random.default_rng([seed, 14]), _left(own, flown, known)
    return [_beside(twin, own.columns[:, :, flown:], _drawn(left, rng)) for twin in twins]


def _left(own: Linearisation, flown: int, known: list[np.ndarray]) -> np.ndarray:
    """Return what effects and quantities leave of the channels from `flown` on, each channel by itself (m, h)."""
    left = own.residual[:, flown:].copy()
    for channel in range(left.shape[1]):
        quantities = np.where(own.good[:, None], known[flown + channel], 0.0).T
        columns = np.concatenate([own.columns[:, :, flown + channel], quantities])
        columns = columns[np.any(columns != 0, axis=1)]
        left[:, channel] -= solve(columns @ columns.T, columns @ left[:, channel]) @ columns
    return left


def _drawn(values, rng) -> np.ndarray:
    spectrum = np.fft.rfft(values, axis=0)
    turn = np.exp(2j * np.pi * rng.random((len(spectrum), 1)))
    return np.fft.irfft(np.concatenate([spectrum[:1], (turn * spectrum)[1:]]), n=len(values), axis=0)


def _beside(twin: Linearisation, columns, residual) -> Linearisation:
    """Return the twin with more channels: columns (p, m, h) and residual (m, h), cut or continued with nothing."""
    def joined(of_twin, others):
        rows, flown = min(len(twin.t), len(residual)), of_twin.shape[-1]
        both = np.zeros((*of_twin.shape[:-1], flown + others.shape[-1]))
        both[..., :flown] = of_twin
        both[..., :rows, flown:] = others[..., :rows, :]
        both[..., ~twin.good, flown:] = 0.0
        return both

    return replace(twin, residual=joined(twin.residual, residual), columns=joined(twin.columns, columns))

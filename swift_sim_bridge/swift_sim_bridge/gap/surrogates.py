"""Twins' share of what no twin flies: VIO and the commands' way, of whose noise the vehicle file knows nothing.

A twin borrows the recording's own: what is left of it beside all effects and quantities that show there, its phases
drawn anew (Theiler 1992): noise of the same colour that goes with no motion. Of a detector it borrows the errors beside
all effects, gate by gate with a sign drawn anew (the wild bootstrap of Wu 1986): what a gate looks like misleads it for
as long as it looks so.
"""

from dataclasses import replace

import numpy as np

from swift_sim_bridge.gap.footprints import Linearisation
from swift_sim_bridge.gap.nulls import solve
from swift_sim_bridge.gap.residuals import Replayer
from swift_sim_bridge.gap.sightings import Sightings


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
    rows = len(twin.t)
    more = max(0, rows - len(residual))
    columns = np.pad(columns, ((0, 0), (0, more), (0, 0)))[:, :rows] * twin.good[:, None]
    residual = np.pad(residual, ((0, more), (0, 0)))[:rows] * twin.good[:, None]
    return replace(twin, residual=np.concatenate([twin.residual, residual], axis=1),
                   columns=np.concatenate([twin.columns, columns], axis=2))


def detector_errors(replayer: Replayer, own: Linearisation) -> np.ndarray:
    """Return what all effects together leave of the recording's corners (n, 4, 2) px; zero where none is compared."""
    seen = [c for c, channel in enumerate(replayer.channels) if channel.layer == "camera"]
    columns = own.columns[:, :, seen]
    columns = columns[np.any(columns != 0, axis=(1, 2))].reshape(-1, own.residual[:, seen].size)
    left = own.residual[:, seen].ravel()
    left = left - solve(columns @ columns.T, columns @ left) @ columns
    kept, row, slot = replayer.seen_at
    errors = np.zeros((len(replayer.recording.sightings.t), 8))
    errors[kept] = left.reshape(len(replayer.t), -1, 8)[row, slot]
    return errors.reshape(-1, 4, 2)


def drawn_errors(seen: Sightings, errors, rng) -> np.ndarray:
    """Return errors (n, 4, 2) px with signs drawn anew: one for a gate from one side, near and far."""
    size = np.linalg.norm(seen.corners[:, 0] - seen.corners[:, 2], axis=-1)
    view = 2 * seen.gate + seen.behind
    middle = np.array([np.median(size[view == one]) if np.any(view == one) else 0.0 for one in range(view.max() + 1)])
    sign = rng.choice([-1.0, 1.0], 2 * len(middle))
    return errors * sign[2 * view + (size > middle[view])][:, None, None]

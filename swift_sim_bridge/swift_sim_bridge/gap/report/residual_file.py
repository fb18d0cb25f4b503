"""The residuals of a diagnosis over time, as a file: `residuals.npz`. `swiftros view` reads it."""

import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from swift_ros.errors import UsageError

FILE = "residuals.npz"


@dataclass(frozen=True)
class ResidualCurves:
    """The residuals of one recording.

    Attributes:
        name: name of the recording.
        t: (m,) time, s.
        p_world: (m, 3) position, m; (0, 3) without a pose.
        channels: (c,) names of the channels.
        units: (c,) their units.
        layers: (c,) their layers, as the figures show them.
        noise: (c,) noise of each channel in the reference flights.
        before: (m, c) measured minus simulated value before the repair, NaN where nothing was measured.
        after: (m, c) the same after the repair; (0, c) without one.
    """

    name: str
    t: np.ndarray
    p_world: np.ndarray
    channels: np.ndarray
    units: np.ndarray
    layers: np.ndarray
    noise: np.ndarray
    before: np.ndarray
    after: np.ndarray

    def mismatch(self, residual) -> np.ndarray:
        """Return the largest residual (m,) in multiples of its noise; 0 where nothing was measured.

        Args:
            residual: (m, c), `before` or `after`.
        """
        return np.nan_to_num(np.abs(residual) / self.noise).max(axis=1, initial=0.0)


ARRAYS = tuple(name for name in ResidualCurves.__dataclass_fields__ if name != "name")


def curves_of(mismatch) -> ResidualCurves:
    """Return the residuals of a `validation.mismatch.Mismatch`."""
    from swift_sim_bridge.gap.validation.mismatch import display_layer  # imports JAX, which a reader does not need

    one, channels = mismatch, mismatch.channels
    return ResidualCurves(
        name=one.name,
        t=one.t,
        p_world=np.zeros((0, 3)) if one.p_world is None else one.p_world,
        channels=np.array([channel.name for channel in channels]),
        units=np.array([channel.unit for channel in channels]),
        layers=np.array([display_layer(channel) for channel in channels]),
        noise=one.noise,
        before=one.before,
        after=np.zeros((0, len(channels))) if one.after is None else one.after,
    )


def write(path: Path, recordings: list[ResidualCurves]) -> None:
    """Write the residuals of recordings. Their names are the array `names`; "0.before" belongs to the first one."""
    arrays = {f"{i}.{name}": getattr(one, name) for i, one in enumerate(recordings) for name in ARRAYS}
    np.savez_compressed(path, names=np.array([one.name for one in recordings]), **arrays)


def read(path: Path) -> list[ResidualCurves]:
    """Return the residuals in a file. Raises UsageError when it cannot be read."""
    try:
        with np.load(path) as file:
            names = file["names"].tolist()
            return [ResidualCurves(str(one), *(file[f"{i}.{name}"] for name in ARRAYS)) for i, one in enumerate(names)]
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise UsageError(f"{path} cannot be read as residuals; run `swiftros gap` again") from error

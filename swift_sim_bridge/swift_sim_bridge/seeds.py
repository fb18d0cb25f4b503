"""Random numbers of a race: an independent generator for each purpose, derived from the race's seed."""

import zlib

import numpy as np

from swift_ros.errors import UsageError

MAX_SEED = 2**31 - 1  # the largest whole number of a ROS parameter that Python, C and JAX read alike


def generator(seed: int, name: str) -> np.random.Generator:
    """Return the generator of the purpose `name`; the same seed and name give the same numbers."""
    return np.random.default_rng(np.random.SeedSequence([seed, zlib.crc32(name.encode())]))


def check_seeds(first: int, last: int) -> None:
    """Raise UsageError unless all seeds from `first` to `last` exist: whole numbers from 0 to MAX_SEED."""
    if first < 0 or last > MAX_SEED:
        wrong = first if first < 0 else last
        raise UsageError(f"there is no seed {wrong}; seeds are whole numbers from 0 to {MAX_SEED}")

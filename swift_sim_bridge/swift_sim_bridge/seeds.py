"""Random numbers of a race: an independent generator for each purpose, derived from the race's seed."""

import zlib

import numpy as np


def generator(seed: int, name: str) -> np.random.Generator:
    """Return the generator of the purpose `name`; the same seed and name give the same numbers."""
    return np.random.default_rng(np.random.SeedSequence([seed, zlib.crc32(name.encode())]))

"""Random numbers of a race: one independent generator a purpose, all derived from the race's seed by name."""

import zlib

import numpy as np


def generator(seed: int, name: str) -> np.random.Generator:
    """Return the generator of a race's seed for the purpose `name`; the same two give the same numbers."""
    return np.random.default_rng(np.random.SeedSequence([seed, zlib.crc32(name.encode())]))

"""Shared by the tests of the referee."""

import jax
import pytest


@pytest.fixture
def double_precision():
    """Compute in 64 bits, as the referee does."""
    with jax.enable_x64(True):
        yield

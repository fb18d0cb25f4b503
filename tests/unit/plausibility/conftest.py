"""Shared by the tests of what is possible."""

import shutil
from pathlib import Path

import pytest
from changed_files import CONFIG


@pytest.fixture
def folder(tmp_path):
    """Return a copy of the shipped configuration."""
    return Path(shutil.copytree(CONFIG, tmp_path / "config"))

"""What the tests of the pilot's training share."""

import pytest
from tiny_training import write_configuration

from swift_sim_bridge.pilot import picture


@pytest.fixture(autouse=True)
def draw_picture(monkeypatch):
    """Draw no pictures, which takes longer than these trainings; return the function that draws them."""
    draw = picture.draw
    monkeypatch.setattr(picture, "draw", lambda *_: None)
    return draw


@pytest.fixture
def tiny_configuration(tmp_path):
    """A configuration folder whose training takes seconds."""
    write_configuration(tmp_path / "config")
    return tmp_path / "config"

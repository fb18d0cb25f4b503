"""What every test shares: a ROS domain of its own, and the recordings beside the repository."""

import os
from pathlib import Path

import pytest

from swift_ros.graph.runner import free_domain

ROOT = Path(__file__).resolve().parent.parent

# Before anything imports rclpy: two runs at once, a race beside them, or a drone on the network must not hear each
# other. The domain is reserved for as long as this process lives.
os.environ.pop("ROS_DOMAIN_ID", None)
DOMAIN, RESERVATION = free_domain()
os.environ["ROS_DOMAIN_ID"] = str(DOMAIN)
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"


@pytest.fixture(scope="session")
def repository() -> Path:
    """The repository's root."""
    return ROOT


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of the public flight recordings, `../shared/data`; a test that needs it is skipped where it is absent."""
    folder = ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"needs the flight recordings in {folder}, which is absent")
    return folder


@pytest.fixture(scope="session")
def sitl_binary() -> str:
    """Path of a Betaflight SITL binary, from $SWIFT_SITL; a test that needs it is skipped where there is none."""
    path = os.environ.get("SWIFT_SITL")
    if not path:
        pytest.skip("needs the real firmware: set SWIFT_SITL to the path of a Betaflight 4.5 SITL binary (README)")
    return path

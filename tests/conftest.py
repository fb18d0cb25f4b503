"""Shared by all tests: a ROS domain of their own, and the recordings beside the repository."""

import os
from pathlib import Path

import pytest

from swift_ros.graph.runner import free_domain

ROOT = Path(__file__).resolve().parent.parent

# Before any import of rclpy: two runs at the same time, a race, or a drone on the network must not receive each other's
# messages. The domain is reserved until this process ends.
os.environ.pop("ROS_DOMAIN_ID", None)
DOMAIN, RESERVATION = free_domain()
os.environ["ROS_DOMAIN_ID"] = str(DOMAIN)
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"


def pytest_collection_modifyitems(items):
    """Give each process whole files, and all tests that start graphs of nodes to one process.

    Files have fixtures that take long. Graphs at the same time would be late.
    """
    for item in items:
        file = item.path.relative_to(ROOT / "tests")
        item.add_marker(pytest.mark.xdist_group("graphs" if file.parts[0] != "unit" else file.as_posix()))


@pytest.fixture(scope="session")
def repository() -> Path:
    """Root folder of the repository."""
    return ROOT


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of the public flight recordings, `../shared/data`; without it the test is skipped."""
    folder = ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"needs the flight recordings in {folder}, which is absent")
    return folder


@pytest.fixture(scope="session")
def sitl_binary() -> str:
    """Path of a Betaflight SITL binary, from $SWIFT_SITL; without it the test is skipped."""
    path = os.environ.get("SWIFT_SITL")
    if not path:
        pytest.skip("needs the real firmware: set SWIFT_SITL to a Betaflight 4.5 SITL binary (docs/simulation/sitl.md)")
    return path

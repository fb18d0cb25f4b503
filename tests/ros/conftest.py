"""Each test file has its own ROS domain: the next file does not discover nodes that the last one has left."""

import os

import pytest

from swift_ros.graph.domain import free_domain

RESERVED = []  # reserved until the end of the run: a released domain would be used by the next file


@pytest.fixture(scope="module", autouse=True)
def domain():
    """Return the domain, which no other file uses."""
    outer = os.environ.pop("ROS_DOMAIN_ID")
    number, reservation = free_domain()
    RESERVED.append(reservation)
    os.environ["ROS_DOMAIN_ID"] = str(number)
    yield number
    os.environ["ROS_DOMAIN_ID"] = outer

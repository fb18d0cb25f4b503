"""Each file here has a ROS domain of its own: what one leaves to discovery for a while, the next does not hear."""

import os

import pytest

from swift_ros.graph.runner import free_domain

RESERVED = []  # until the run ends: a domain given back would be the next file's


@pytest.fixture(scope="module", autouse=True)
def domain():
    """Return the domain, which no other file gets."""
    outer = os.environ.pop("ROS_DOMAIN_ID")
    number, reservation = free_domain()
    RESERVED.append(reservation)
    os.environ["ROS_DOMAIN_ID"] = str(number)
    yield number
    os.environ["ROS_DOMAIN_ID"] = outer

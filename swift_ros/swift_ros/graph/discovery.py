"""Who can reach the graph: this machine alone, unless the user asks for more. No ROS.

`ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST` limits whom Fast DDS discovers, but it still listens on all network
interfaces. With the profile `loopback.xml` it uses the loopback interface alone. Processes of other programs find the
graph with and without that profile, if they run on this machine and in the same ROS domain.
"""

import os
from collections.abc import MutableMapping
from pathlib import Path

from swift_ros.errors import UsageError

DISCOVERY = {"local": "LOCALHOST", "subnet": "SUBNET"}  # who can reach the graph, and the range of ROS for it
RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
PROFILE = "FASTRTPS_DEFAULT_PROFILES_FILE"
OTHER_PROFILE = "FASTDDS_DEFAULT_PROFILES_FILE"  # its name in newer releases, which read both
LOOPBACK = str(Path(__file__).with_name("loopback.xml"))
FAST_DDS = ("", "rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp")  # of RMW_IMPLEMENTATION; Jazzy's default is the first


def confine(environment: MutableMapping[str, str] = os.environ) -> None:
    """Confine ROS to this machine, unless the environment has another range. Call it before ROS starts.

    A profile of the user's own is kept: then LOCALHOST alone holds.

    Args:
        environment: variables of the process, changed in place.
    """
    if environment.setdefault(RANGE, "LOCALHOST") != "LOCALHOST":
        return
    own_profile = environment.get(PROFILE) or environment.get(OTHER_PROFILE)
    if environment.get("RMW_IMPLEMENTATION", "") in FAST_DDS and own_profile in (None, "", LOOPBACK):
        environment[PROFILE] = LOOPBACK
        environment[RANGE] = "SYSTEM_DEFAULT"  # with LOCALHOST the middleware would replace the profile's interfaces


def choose(discovery: str, environment: MutableMapping[str, str] = os.environ) -> None:
    """Set who can reach the graph, whatever the environment said before. Call it before ROS starts.

    Args:
        discovery: key of `DISCOVERY`.
        environment: variables of the process, changed in place.

    Raises:
        UsageError: `discovery` is not in `DISCOVERY`.
    """
    if discovery not in DISCOVERY:
        raise UsageError(f"discovery is '{discovery}'; give {' or '.join(DISCOVERY)}")
    if environment.get(PROFILE) == LOOPBACK:
        del environment[PROFILE]
    environment[RANGE] = DISCOVERY[discovery]
    confine(environment)

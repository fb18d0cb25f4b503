"""Who can reach the graph: this machine alone, unless the user asks for more. No ROS.

`ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST` limits whom Fast DDS discovers, but it still listens on all network
interfaces. With the profile `loopback.xml` it uses the loopback interface alone. Processes of other programs find the
graph with and without that profile, if they run on this machine and in the same ROS domain.

Both profiles do without the shared memory of Fast DDS. With it, a node that sends to a process for the first time
checks the health of that process's port, and stands still for 0.33 s where the port is idle (Fast DDS issue 6535; seen
between the nodes of a race with release 2.14.5). By its source, a program that begins to look at a topic causes the
same, and the locks in that memory make a sender wait for a receiver that is frozen. A UDP socket does neither. Its
buffers are as large as the system permits up to 4 MB, for a node that is late by some images.
"""

import os
from collections.abc import MutableMapping
from pathlib import Path

from swift_ros.errors import UsageError

DISCOVERY = {"local": "LOCALHOST", "subnet": "SUBNET"}  # who can reach the graph, and the range of ROS for it
RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
LOCALHOST_ONLY = "ROS_LOCALHOST_ONLY"  # deprecated; where it is 1, ROS ignores the range and listens beyond loopback
PROFILE = "FASTRTPS_DEFAULT_PROFILES_FILE"
OTHER_PROFILE = "FASTDDS_DEFAULT_PROFILES_FILE"  # its name in newer releases, which read both
LOOPBACK, SUBNET = (str(Path(__file__).with_name(f"{name}.xml")) for name in ("loopback", "subnet"))
FAST_DDS = ("", "rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp")  # of RMW_IMPLEMENTATION; Jazzy's default is the first


def confine(environment: MutableMapping[str, str] = os.environ) -> None:
    """Confine ROS to this machine, unless the environment has another range, and to UDP. Call it before ROS starts.

    A profile of the user's own is kept: then the range alone holds.

    Args:
        environment: variables of the process, changed in place.
    """
    if environment.pop(LOCALHOST_ONLY, "0") == "1":
        environment[RANGE] = "LOCALHOST"
    chosen = environment.setdefault(RANGE, "LOCALHOST")
    own_profile = environment.get(PROFILE) or environment.get(OTHER_PROFILE)
    if environment.get("RMW_IMPLEMENTATION", "") not in FAST_DDS or own_profile not in (None, "", LOOPBACK, SUBNET):
        return
    if chosen == "LOCALHOST":
        environment[PROFILE] = LOOPBACK
        environment[RANGE] = "SYSTEM_DEFAULT"  # with LOCALHOST the middleware would replace the profile's interfaces
    elif chosen == "SUBNET":
        environment[PROFILE] = SUBNET


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
    if environment.get(PROFILE) in (LOOPBACK, SUBNET):
        del environment[PROFILE]
    environment.pop(LOCALHOST_ONLY, None)
    environment[RANGE] = DISCOVERY[discovery]
    confine(environment)

"""The graph is open to this machine alone, however it is started, unless the user asks for more."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from swift_ros.errors import UsageError
from swift_ros.graph import discovery
from swift_ros.graph.runner import environment

PARTICIPANT = """
import time
{prepare}
import rclpy
rclpy.init()
node = rclpy.create_node("listener")
print("up", flush=True)
time.sleep(60)
"""


def test_a_plain_environment_is_confined_and_an_explicit_range_stays():
    plain = {}
    discovery.confine(plain)
    assert plain == {discovery.RANGE: "SYSTEM_DEFAULT", discovery.PROFILE: discovery.LOOPBACK}
    again = dict(plain)
    discovery.confine(again)
    assert again == plain
    for chosen, profile in (("SUBNET", {discovery.PROFILE: discovery.SUBNET}), ("OFF", {})):
        found = {discovery.RANGE: chosen}
        discovery.confine(found)
        assert found == {discovery.RANGE: chosen} | profile


def test_the_former_variable_of_ros_confines_as_well_and_a_choice_overrules_it():
    former = {discovery.LOCALHOST_ONLY: "1", discovery.RANGE: "SUBNET"}
    discovery.confine(former)
    assert former == {discovery.RANGE: "SYSTEM_DEFAULT", discovery.PROFILE: discovery.LOOPBACK}
    disabled = {discovery.LOCALHOST_ONLY: "0", discovery.RANGE: "SUBNET"}
    discovery.confine(disabled)
    assert disabled == {discovery.RANGE: "SUBNET", discovery.PROFILE: discovery.SUBNET}
    opened = {discovery.LOCALHOST_ONLY: "1"}
    discovery.choose("subnet", opened)
    assert opened == {discovery.RANGE: "SUBNET", discovery.PROFILE: discovery.SUBNET}


def test_another_middleware_and_an_own_profile_keep_the_range_of_ros():
    for given in ({"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}, {discovery.PROFILE: "/home/me/dds.xml"}):
        found = dict(given)
        discovery.confine(found)
        assert found == given | {discovery.RANGE: "LOCALHOST"}


def test_a_child_of_a_confined_process_can_be_opened_on_purpose(monkeypatch):
    for name in (discovery.PROFILE, discovery.RANGE):
        monkeypatch.delenv(name, raising=False)
    discovery.choose("local")
    assert environment(7, "local")[discovery.PROFILE] == discovery.LOOPBACK
    opened = environment(7, "subnet")
    assert (opened[discovery.RANGE], opened[discovery.PROFILE]) == ("SUBNET", discovery.SUBNET)
    with pytest.raises(UsageError, match="discovery is 'world'; give local or subnet"):
        discovery.choose("world", {})


def udp_addresses(process: int) -> set[str]:
    """Return the local addresses of the UDP sockets of a process, as the kernel lists them."""
    sockets = set()
    for link in Path(f"/proc/{process}/fd").iterdir():
        target = os.readlink(link) if link.is_symlink() else ""
        sockets.add(target.removeprefix("socket:[").rstrip("]"))
    found = set()
    for line in Path(f"/proc/{process}/net/udp").read_text().splitlines()[1:]:
        fields = line.split()
        if fields[9] in sockets:
            number = fields[1].partition(":")[0]
            found.add(".".join(str(byte) for byte in reversed(bytes.fromhex(number))))
    return found


@pytest.mark.parametrize("given", [{}, {discovery.LOCALHOST_ONLY: "1"}])
def test_a_node_listens_on_the_loopback_interface_alone_and_shares_no_memory(given):
    """So it is with a node that is started by hand, without any variable and with the former one of ROS."""
    prepare = "from swift_ros.graph.discovery import confine; confine()"
    variables = {k: v for k, v in os.environ.items() if k not in (discovery.RANGE, discovery.PROFILE)} | given
    with subprocess.Popen(
        [sys.executable, "-c", PARTICIPANT.format(prepare=prepare)], env=variables, stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout.readline() == "up\n"
            time.sleep(0.5)
            addresses = udp_addresses(process.pid)
            mapped = Path(f"/proc/{process.pid}/maps").read_text()
        finally:
            process.kill()
    assert "librmw_fastrtps" in mapped and "/dev/shm/fastrtps" not in mapped
    assert addresses
    assert all(address.startswith(("127.", "239.255.")) for address in addresses), addresses


def test_the_profile_of_a_graph_that_is_open_to_the_network_differs_by_the_interfaces_alone():
    loopback, subnet = (Path(profile).read_text() for profile in (discovery.LOOPBACK, discovery.SUBNET))
    before, _, rest = loopback.partition("        <interfaceWhiteList>")
    without_list = before + rest.partition("</interfaceWhiteList>\n")[2]
    assert without_list.splitlines()[2:] == subnet.replace('"subnet"', '"loopback"').splitlines()[2:]

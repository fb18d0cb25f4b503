"""Which ROS domain a run uses: one that no other run on this machine uses. No ROS."""

import os
import socket
from pathlib import Path

from swift_ros.errors import UsageError

DOMAINS = range(1, 102)  # the UDP ports of higher domains are in the ephemeral port range of Linux
FIRST_DEFAULT_DOMAIN = 20  # number of the lowest domains that are tried last, because they are usually chosen by hand
# Prefixes of abstract Unix sockets, which the kernel removes when their process ends: a process has reserved a domain,
# and a run has its graph in the domain. A run may use a domain that another process, such as a test, has reserved.
RESERVATION, GRAPH = "swift-ros-domain-", "swift-ros-graph-"
_marks: list[socket.socket] = []  # of launch files, until this process ends


class RunDomain:
    """The ROS domain of one run: no other run of swiftros on this machine can use it until `close`.

    Attributes:
        number: of the domain.
    """

    def __init__(self):
        """Take the domain of `free_domain`. Raises UsageError when another run has its graph there."""
        self.number, reservation = free_domain()
        graph = _bound(f"{GRAPH}{self.number}")
        self._sockets = [one for one in (reservation, graph) if one]
        if graph is None:
            self.close()
            raise UsageError(
                f"another run of swiftros uses ROS domain {self.number}; unset ROS_DOMAIN_ID or set another number, "
                "or end that run"
            )

    def close(self) -> None:
        """Leave the domain to other runs."""
        for one in self._sockets:
            one.close()


def free_domain() -> tuple[int, socket.socket | None]:
    """Return a ROS domain that no other run on this machine uses, and the socket that reserves it until closed.

    If `ROS_DOMAIN_ID` is set, that domain is returned without a reservation, used or not.
    """
    chosen = os.environ.get("ROS_DOMAIN_ID")
    if chosen:
        if not chosen.isdigit() or int(chosen) not in range(0, 102):
            raise UsageError(f"ROS_DOMAIN_ID is {chosen}; set a number from 0 to 101, or unset it")
        return int(chosen), None
    order = [*DOMAINS[FIRST_DEFAULT_DOMAIN:], *DOMAINS[:FIRST_DEFAULT_DOMAIN]]
    for domain in order:
        reservation = _bound(f"{RESERVATION}{domain}")
        if reservation is None:
            continue
        if graph := _bound(f"{GRAPH}{domain}"):  # no run was started there with ROS_DOMAIN_ID
            graph.close()
            return domain, reservation
        reservation.close()
    raise UsageError("all ROS domains from 1 to 101 are in use by other runs of swiftros; end one of them")


def mark_domain(number: int) -> None:
    """Keep other runs of swiftros out of a domain until this process ends; for launch files.

    A domain that is in use stays so: several launch files may start one graph.
    """
    if graph := _bound(f"{GRAPH}{number}"):
        _marks.append(graph)


def _bound(name: str) -> socket.socket | None:
    """Return a socket with an abstract name; None when another socket has it."""
    found = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        found.bind(f"\0{name}")
    except OSError:
        found.close()
        return None
    return found


def chosen_domain(domain: int | None) -> int:
    """Return the domain to inspect: `domain`, else `ROS_DOMAIN_ID`, else that of the only running race, else 0."""
    if domain is not None:
        return domain
    if os.environ.get("ROS_DOMAIN_ID", "").isdigit():
        return int(os.environ["ROS_DOMAIN_ID"])
    names = (line.split()[-1] for line in Path("/proc/net/unix").read_text().splitlines()[1:])
    running = sorted(int(name.removeprefix(f"@{RESERVATION}")) for name in names if name.startswith(f"@{RESERVATION}"))
    if len(running) > 1:
        raise UsageError(f"several races are running, in ROS domains {running}; choose one with --domain")
    return running[0] if running else 0

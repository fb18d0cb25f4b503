"""TCP ports of this machine: find a free one, check that one is free."""

import socket

from swift_ros.errors import UsageError

LOOPBACK = "127.0.0.1"
PORTS = range(1, 2**16)


def free_port() -> int:
    """Return a TCP port of the loopback interface on which no process listens."""
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        return probe.getsockname()[1]


def require_free(port: int, cure: str, host: str = LOOPBACK) -> None:
    """Check that a TCP port is free.

    Args:
        port: TCP port.
        cure: what the user can do when the port is in use; ends the error's sentence.
        host: address of the interface; "" for all interfaces.

    Raises:
        UsageError: there is no such port, or it is in use.
    """
    if port not in PORTS:
        raise UsageError(f"there is no TCP port {port}; ports are {PORTS[0]} to {PORTS[-1]}")
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            raise UsageError(f"TCP port {port} is not available: {error.strerror}; {cure}") from error

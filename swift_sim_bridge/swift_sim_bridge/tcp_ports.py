"""TCP ports of this machine: a free one, and whether a wished one can be had."""

import socket

from swift_ros.errors import UsageError

LOOPBACK = "127.0.0.1"


def free_port() -> int:
    """Return a TCP port of the loopback interface that nobody listens on."""
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        return probe.getsockname()[1]


def require_free(port: int, cure: str, host: str = LOOPBACK) -> None:
    """Raise UsageError, which ends with what to do, when a TCP port is taken. host: "" for all interfaces."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            raise UsageError(f"TCP port {port} cannot be had: {error.strerror}; {cure}") from error

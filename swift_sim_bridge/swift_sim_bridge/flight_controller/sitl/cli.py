"""The firmware's command line over its MSP port: what a person would type into the configurator's CLI tab."""

import socket
import time

from swift_ros.errors import UsageError

PROMPT = b"\r\n# "
ENTER_S, LINE_S, SAVE_S = 5.0, 5.0, 10.0
RETRY_S = 1.0
CHUNK = 4096


def set_up(port: int, lines) -> str:
    """Type `lines` and `save`, after which the firmware saves its settings and ends. Return what it said to all.

    Raises UsageError for a line that it refuses, or when it does not answer.
    """
    with _entered(port) as connection:
        said = [_type(connection, line) for line in lines]
        connection.sendall(b"save\n")
        _read_until(connection, None, SAVE_S)
    return "".join(said)


def _entered(port: int) -> socket.socket:
    """Return a connection that the command line listens to. One that comes too soon after another is closed again."""
    deadline = time.monotonic() + ENTER_S
    while time.monotonic() < deadline:
        connection = socket.create_connection(("127.0.0.1", port), timeout=ENTER_S)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.sendall(b"#")
        if _read_until(connection, PROMPT, RETRY_S) is not None:
            return connection
        connection.close()
    raise UsageError("the firmware does not open its command line on its MSP port; is it Betaflight SITL?")


def _type(connection, line: str) -> str:
    connection.sendall(line.encode("ascii") + b"\n")
    answer = _read_until(connection, PROMPT, LINE_S)
    if answer is None:
        raise UsageError(f"the firmware does not answer the line '{line}' of its command line within {LINE_S:.0f} s")
    text = answer.decode("ascii", "replace")
    if "###ERROR" in text:
        reason = text[text.index("###ERROR") :].strip("#\r\n ").splitlines()[0].rstrip("# ")
        raise UsageError(f"the firmware refuses the line '{line}' ({reason}); is it Betaflight 4.5?")
    return text


def _read_until(connection, mark: bytes | None, patience_s: float) -> bytes | None:
    """Return what is said up to `mark` (None: up to the end of the connection), None when that stays away."""
    said, deadline = b"", time.monotonic() + patience_s
    while (left_s := deadline - time.monotonic()) > 0:
        connection.settimeout(left_s)
        try:
            chunk = connection.recv(CHUNK)
        except TimeoutError:
            break
        except ConnectionError:
            chunk = b""
        said += chunk
        if mark is not None and said.endswith(mark):
            return said
        if not chunk:
            return said if mark is None else None
    return None

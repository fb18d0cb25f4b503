"""The firmware's command line (CLI) over its MSP port, as in the CLI tab of the configurator."""

import socket
import time

from swift_ros.errors import UsageError

PROMPT = b"\r\n# "
ENTER_S = 5.0  # longest time until the command line opens
LINE_S = 5.0  # longest time until a line is answered
SAVE_S = 10.0  # longest time until the settings are saved and the firmware ends
RETRY_S = 1.0  # without a prompt, the connection is opened again
CHUNK_BYTES = 4096  # read at once


def set_up(port: int, lines) -> str:
    """Enter lines and `save`; the firmware then saves its settings and ends.

    Args:
        port: TCP port of the firmware's MSP.
        lines: lines of the CLI.

    Returns:
        The firmware's answers to all lines.

    Raises:
        UsageError: the firmware refuses a line or does not answer.
    """
    with _open_command_line(port) as connection:
        answers = [_enter(connection, line) for line in lines]
        connection.sendall(b"save\n")
        _read_until(connection, None, SAVE_S)
    return "".join(answers)


def _open_command_line(port: int) -> socket.socket:
    """Return a connection with an open command line. The firmware closes one that follows another too quickly."""
    deadline = time.monotonic() + ENTER_S
    while time.monotonic() < deadline:
        connection = socket.create_connection(("127.0.0.1", port), timeout=ENTER_S)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.sendall(b"#")
        if _read_until(connection, PROMPT, RETRY_S) is not None:
            return connection
        connection.close()
    raise UsageError("the firmware does not open its command line on its MSP port; is it Betaflight SITL?")


def _enter(connection, line: str) -> str:
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
    """Return the bytes up to `mark` (None: up to the end of the connection); None when it does not arrive in time."""
    received, deadline = b"", time.monotonic() + patience_s
    while (left_s := deadline - time.monotonic()) > 0:
        connection.settimeout(left_s)
        try:
            chunk = connection.recv(CHUNK_BYTES)
        except TimeoutError:
            break
        except ConnectionError:
            chunk = b""
        received += chunk
        if mark is not None and received.endswith(mark):
            return received
        if not chunk:
            return received if mark is None else None
    return None

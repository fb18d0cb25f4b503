"""The firmware's command line (CLI) over its MSP port, as in the CLI tab of the configurator."""

import socket

from swift_ros.errors import UsageError
from swift_ros.working_time import WorkingTime

PROMPT = b"\r\n# "
# Patience is in working time.
ENTER_S = 5.0  # longest time until the command line opens
LINE_S = 5.0  # longest time until a line is answered
SAVE_S = 10.0  # longest time until the settings are saved and the firmware ends
RETRY_S = 1.0  # without a prompt, the connection is opened again
POLL_S = 0.1  # longest wait for bytes before the working time is read again
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
    clock = WorkingTime()
    with _open_command_line(port, clock) as connection:
        answers = [_enter(connection, line, clock) for line in lines]
        connection.sendall(b"save\n")
        _read_until(connection, None, SAVE_S, clock)
    return "".join(answers)


def _open_command_line(port: int, clock: WorkingTime) -> socket.socket:
    """Return a connection with an open command line. The firmware closes one that follows another too quickly."""
    deadline_s = clock.now_s() + ENTER_S
    while clock.now_s() < deadline_s:
        connection = socket.create_connection(("127.0.0.1", port), timeout=ENTER_S)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.sendall(b"#")
        if _read_until(connection, PROMPT, RETRY_S, clock) is not None:
            return connection
        connection.close()
    raise UsageError("the firmware does not open its command line on its MSP port; is it Betaflight SITL?")


def _enter(connection, line: str, clock: WorkingTime) -> str:
    connection.sendall(line.encode("ascii") + b"\n")
    answer = _read_until(connection, PROMPT, LINE_S, clock)
    if answer is None:
        raise UsageError(f"the firmware does not answer the line '{line}' of its command line within {LINE_S:.0f} s")
    text = answer.decode("ascii", "replace")
    if "###ERROR" in text:
        reason = text[text.index("###ERROR") :].strip("#\r\n ").splitlines()[0].rstrip("# ")
        raise UsageError(f"the firmware refuses the line '{line}' ({reason}); is it Betaflight 4.5?")
    return text


def _read_until(connection, mark: bytes | None, patience_s: float, clock: WorkingTime) -> bytes | None:
    """Return the bytes up to `mark` (None: up to the end of the connection); None when it does not arrive in time."""
    received, deadline_s = b"", clock.now_s() + patience_s
    connection.settimeout(POLL_S)
    while clock.now_s() < deadline_s:
        try:
            chunk = connection.recv(CHUNK_BYTES)
        except TimeoutError:
            continue
        except ConnectionError:
            chunk = b""
        received += chunk
        if mark is not None and received.endswith(mark):
            return received
        if not chunk:
            return received if mark is None else None
    return None

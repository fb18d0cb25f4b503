"""Bytes to and from a flight controller, over a TCP port or a serial device, with a reading thread.

The thread only stores bytes with their time of arrival, so reading never delays a frame.
"""

import errno
import os
import queue
import select
import socket
import termios
import threading
import time
import tty
from collections.abc import Callable

from swift_ros.betaflight import msp
from swift_ros.betaflight.link_settings import serial_speed, tcp_address
from swift_ros.errors import UsageError

CONNECT_S = 1.0  # longest time to open a TCP connection
RETRY_S = 0.2  # between two tries to connect
STALLED_S = 0.05  # longest wait for the other end to read; a longer one counts as a lost connection
POLL_S = 0.2  # period in which the thread notices `close`, and `ask` reads its clock
ANSWER_S, TRIES = 1.0, 3  # longest time for an answer, and number of tries, before a flight
CHUNK_BYTES = 4096  # bytes read at once


class ConnectionLost(UsageError):
    """The connection to the flight controller is lost."""

    def __init__(self, reason: str):
        super().__init__(f"the link to the flight controller is lost, its own failsafe must act: {reason}")


class Transport:
    """An open connection, made by `connect`."""

    def __init__(self, name: str, descriptor: int, owner, clock: Callable[[], float]):
        self._name, self._descriptor, self._owner, self._clock = name, descriptor, owner, clock
        os.set_blocking(descriptor, False)
        self._chunks: queue.SimpleQueue = queue.SimpleQueue()
        self._closing = False
        self._thread = threading.Thread(target=self._read, name="msp reader", daemon=True)
        self._thread.start()

    def write(self, data: bytes) -> None:
        """Write all bytes. Raises ConnectionLost when the other end has closed or does not read for STALLED_S."""
        while data:
            try:
                data = data[os.write(self._descriptor, data) :]
            except BlockingIOError:
                if not select.select([], [self._descriptor], [], STALLED_S)[1]:
                    raise ConnectionLost(f"{self._name} takes no more bytes") from None
            except OSError as error:
                raise ConnectionLost(f"{self._name}: {error.strerror}") from error

    def read(self, timeout_s: float = 0.0) -> tuple[bytes, float] | None:
        """Return the next bytes and their time of arrival (s, steady clock), or None when none arrive in time.

        Raises ConnectionLost when the connection is lost and all bytes before that were read.
        """
        try:
            chunk, arrived_s = self._chunks.get(timeout_s > 0, timeout_s or None)
        except queue.Empty:
            return None
        if isinstance(chunk, str):
            self._chunks.put((chunk, arrived_s))
            raise ConnectionLost(f"{self._name}: {chunk}")
        return chunk, arrived_s

    def ask(self, code: int, payload: bytes = b"") -> bytes | None:
        """Return the payload of the answer to a request, None for a refusal. Use it before the first stick frame.

        Raises UsageError when nothing answers.
        """
        parser = msp.Parser()
        for _ in range(TRIES):
            try:
                self.write(msp.encode(msp.Message(code, payload, msp.REQUEST)))
                deadline = self._clock() + ANSWER_S
                while (left_s := deadline - self._clock()) > 0:
                    chunk, _ = self.read(min(left_s, POLL_S)) or (b"", 0.0)
                    for message in parser.feed(chunk):
                        if message.code == code and message.kind != msp.REQUEST:
                            return message.payload if message.kind == msp.REPLY else None
            except ConnectionLost as error:
                raise UsageError(f"{self._name} was closed during a request; is it a flight controller?") from error
        raise UsageError(f"{self._name} does not answer MSP; check port, baud rate and that nothing else uses it")

    def close(self) -> None:
        """End the thread and close the connection."""
        self._closing = True
        self._thread.join(timeout=1.0)
        if self._owner is not None:
            self._owner.close()
        else:
            os.close(self._descriptor)

    def _read(self) -> None:
        while not self._closing:
            if not select.select([self._descriptor], [], [], POLL_S)[0]:
                continue
            try:
                chunk = os.read(self._descriptor, CHUNK_BYTES)
            except BlockingIOError:
                continue
            except OSError as error:
                end = "the other end was closed" if error.errno == errno.EIO else error.strerror
                self._chunks.put((end, time.monotonic()))
                return
            self._chunks.put((chunk or "the other end was closed", time.monotonic()))
            if not chunk:
                return
            if self._owner is not None:
                # A delayed acknowledgement would hold back SITL's next small answer for 40 ms (Nagle's algorithm).
                self._owner.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)


def connect(
    port: str,
    baud: int,
    patience_s: float,
    waiting: Callable[[str], object] = lambda reason: None,
    clock: Callable[[], float] = time.monotonic,
) -> Transport:
    """Connect to a flight controller.

    Args:
        port: tcp://HOST:PORT or the path of a serial device.
        baud: bits/s of a serial device.
        patience_s: s to keep trying.
        waiting: called once with the reason when the first try failed.
        clock: s, on which the patience with the connection and with answers is measured.

    Raises:
        UsageError: no connection; names port and reason.
    """
    deadline = clock() + patience_s
    reported = False
    while True:
        try:
            return _open(port, baud, clock)
        except ValueError as error:
            raise UsageError(str(error)) from error
        except OSError as error:
            reason = f"no flight controller on {port}: {error.strerror or error}"
        if clock() >= deadline:
            raise UsageError(f"{reason}; connect it or start the simulator, or set the parameter `port`")
        if not reported:
            waiting(reason)
            reported = True
        time.sleep(RETRY_S)


def _open(port: str, baud: int, clock: Callable[[], float]) -> Transport:
    address = tcp_address(port)
    if address is not None:
        connection = socket.create_connection(address, timeout=CONNECT_S)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return Transport(port, connection.fileno(), connection, clock)
    descriptor = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        _configure_serial(descriptor, port, baud)
    except BaseException:
        os.close(descriptor)
        raise
    return Transport(port, descriptor, None, clock)


def _configure_serial(descriptor: int, port: str, baud: int) -> None:
    speed = serial_speed(baud)
    try:
        tty.setraw(descriptor)
        attributes = termios.tcgetattr(descriptor)
    except termios.error as error:
        raise UsageError(f"the port '{port}' is not a serial device: {error.args[-1]}; set `port`") from error
    attributes[2] |= termios.CLOCAL | termios.CREAD
    attributes[4] = attributes[5] = speed
    termios.tcsetattr(descriptor, termios.TCSANOW, attributes)
    termios.tcflush(descriptor, termios.TCIOFLUSH)

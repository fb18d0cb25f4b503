"""The line between the link and the flight controller, as a TCP proxy that loses or changes bytes."""

import contextlib
import socket
import threading

import numpy as np

from swift_sim_bridge.faults.catalogue import LOST_BYTES
from swift_sim_bridge.tcp_ports import LOOPBACK

CHUNK_BYTES = 4096
CONNECT_S = 1.0  # s between two attempts to reach the flight controller, which starts later


class SerialLine:
    """Passes on the bytes of one connection at a time, in threads, until `close`.

    Attributes:
        port: TCP port of the loopback interface on which it waits for the link.
    """

    def __init__(self, controller_port: int, seed: int):
        """Open the port.

        Args:
            controller_port: TCP port of the flight controller.
            seed: of the errors.
        """
        self._controller_port = controller_port
        self._rng = np.random.default_rng(seed)
        self._kind, self._share = "", 0.0
        self._closing = threading.Event()
        self._listener = socket.socket()  # refuses connections until the flight controller is there
        self._listener.bind((LOOPBACK, 0))
        self.port = self._listener.getsockname()[1]
        threading.Thread(target=self._serve, daemon=True).start()

    def disturb(self, kind: str, share: float) -> None:
        """Lose (LOST_BYTES) or change (WRONG_BYTES) a share of the bytes from now on; a share of 0.0 ends it."""
        self._kind, self._share = kind, share

    def close(self) -> None:
        """Close all connections."""
        self._closing.set()
        self._listener.close()

    def _serve(self) -> None:
        with contextlib.suppress(OSError):
            while controller := self._connect():
                self._listener.listen()
                link, _ = self._listener.accept()
                for ends in ((link, controller), (controller, link)):
                    ends[0].setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                    threading.Thread(target=self._pass_on, args=ends, daemon=True).start()

    def _connect(self) -> socket.socket | None:
        while not self._closing.is_set():
            try:
                return socket.create_connection((LOOPBACK, self._controller_port))
            except OSError:
                self._closing.wait(CONNECT_S)
        return None

    def _pass_on(self, source: socket.socket, sink: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while data := source.recv(CHUNK_BYTES):
                sink.sendall(self._disturbed(data))
        for end in (source, sink):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def _disturbed(self, data: bytes) -> bytes:
        if not self._share:
            return data
        values = np.frombuffer(data, dtype=np.uint8)
        hit = self._rng.random(len(values)) < self._share
        if self._kind == LOST_BYTES:
            return values[~hit].tobytes()
        return np.where(hit, self._rng.integers(0, 256, len(values), dtype=np.uint8), values).tobytes()

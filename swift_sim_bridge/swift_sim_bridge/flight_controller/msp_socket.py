"""MSP server on a TCP port of the loopback interface or on a pseudo-terminal, in its own thread.

The flight controller receives bytes as they arrive, at any time of the simulation; `lock` separates the two threads.
"""

import os
import pty
import selectors
import socket
import threading
import tty

from swift_ros.errors import UsageError
from swift_sim_bridge.flight_controller.msp_server import MspServer

CHUNK_BYTES = 4096  # read at once
LOOPBACK = "127.0.0.1"
PSEUDO_TERMINAL = -1  # in place of a TCP port


class MspSocket:
    """Serves the MSP of a flight controller until `close`.

    Attributes:
        name: address for clients, such as `tcp://127.0.0.1:5761`, or a device's path.
        lock: held while the flight controller handles bytes.
    """

    _idle_s: float | None = None  # period of `_idle`; None: `_idle` does nothing

    def __init__(self, controller, port: int):
        """Open the port and start the thread.

        Args:
            controller: flight controller with `frames`, and what `MspServer` needs.
            port: TCP port; 0 for any free one; PSEUDO_TERMINAL for a pseudo-terminal.

        Raises:
            UsageError: the port is in use.
        """
        self._controller = controller
        self.lock = threading.Lock()
        self._arrived = threading.Condition(self.lock)
        self._selector = selectors.DefaultSelector()
        self._servers: dict[int, MspServer] = {}
        self._open: dict[int, socket.socket | None] = {}
        self.name = self._open_port(port)
        self._wake, self._woken = socket.socketpair()
        self._selector.register(self._woken, selectors.EVENT_READ, None)
        self._thread = threading.Thread(target=self._serve, name="msp server", daemon=True)
        self._thread.start()

    def wait_for_frames(self, count: int, patience_s: float) -> bool:
        """Wait until the flight controller has received `count` frames; return whether it has.

        Args:
            count: frames since power-on.
            patience_s: s to wait at most.
        """
        with self._arrived:
            return self._arrived.wait_for(lambda: self._controller.frames >= count, patience_s)

    def close(self) -> None:
        """Stop serving and close everything."""
        self._wake.send(b"x")
        self._thread.join(timeout=2.0)
        for descriptor in list(self._servers):
            self._disconnect(descriptor)
        self._selector.close()

    def _open_port(self, port: int) -> str:
        return self._open_terminal() if port == PSEUDO_TERMINAL else self._listen(port)

    def _listen(self, port: int) -> str:
        listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((LOOPBACK, port))
        except OSError as error:
            listener.close()
            raise UsageError(
                f"port {port} for MSP is not available: {error.strerror}; choose another `port`"
            ) from error
        listener.listen()
        self._selector.register(listener, selectors.EVENT_READ, self._accept)
        return f"tcp://{LOOPBACK}:{listener.getsockname()[1]}"

    def _open_terminal(self) -> str:
        master, self._client_end = pty.openpty()  # kept open, so the terminal survives a client that disconnects
        tty.setraw(self._client_end)
        self._add(master, None)
        return os.ttyname(self._client_end)

    def _accept(self, listener: socket.socket) -> None:
        connection, _ = listener.accept()
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._add(connection.fileno(), connection)

    def _add(self, descriptor: int, connection: socket.socket | None) -> None:
        self._servers[descriptor], self._open[descriptor] = self._new_server(), connection
        self._selector.register(descriptor, selectors.EVENT_READ, self._on_client_bytes)

    def _new_server(self):
        """Return the server of one client: an object with `feed`."""
        return MspServer(self._controller)

    def _disconnect(self, descriptor: int) -> None:
        self._selector.unregister(descriptor)
        del self._servers[descriptor]
        connection = self._open.pop(descriptor)
        os.close(descriptor) if connection is None else connection.close()

    def _serve(self) -> None:
        while True:
            for key, _ in self._selector.select(self._idle_s):
                if key.data is None:
                    return
                key.data(key.fileobj)
            self._idle()

    def _idle(self) -> None:
        """Do periodic work, every `_idle_s` or more often."""

    def _on_client_bytes(self, descriptor: int) -> None:
        try:
            data = os.read(descriptor, CHUNK_BYTES)
        except OSError:
            data = b""
        if not data:
            self._disconnect(descriptor)
            return
        with self._arrived:
            answer = self._servers[descriptor].feed(data)
            self._arrived.notify_all()
        self._write(descriptor, answer)

    def _write(self, descriptor: int, answer: bytes) -> None:
        while answer:
            try:
                answer = answer[os.write(descriptor, answer) :]
            except OSError:
                self._disconnect(descriptor)
                return

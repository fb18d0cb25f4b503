"""MSP proxy in front of the real firmware: it answers what SITL lacks and forwards everything else.

SITL accepts one client, has no voltmeter and no rotor telemetry, and does not report which stick frame it has read.
Clients therefore connect to the simulator's port, and the proxy forwards. Answers keep the order of their requests.
"""

import contextlib
import selectors
import socket
import time
from collections import deque
from dataclasses import dataclass

from swift_ros.betaflight import msp
from swift_ros.betaflight.msp_messages import Code
from swift_sim_bridge.flight_controller import msp_server
from swift_sim_bridge.flight_controller.firmware import FlightController, Readings, Setpoint
from swift_sim_bridge.flight_controller.msp_framing import Request, RequestReader, encode_answer
from swift_sim_bridge.flight_controller.msp_socket import CHUNK_BYTES, MspSocket

# Requests for the simulated vehicle's meters and motors, which the proxy answers.
ANSWERED_HERE = (Code.MOTOR, Code.ANALOG, Code.BATTERY_STATE, Code.MOTOR_TELEMETRY)
REPEAT_S = 0.05  # period, by the wall clock, of repeated stick frames: the firmware's receiver is lost after 0.1 s
PAUSE_TICKS = 2  # a stick frame that is at most so many ticks old is repeated: simulated time may be paused


class SitlController(FlightController):
    """Meters and counters of the simulated flight controller, beside the real firmware.

    Attributes:
        ticks: number of ticks so far.
    """

    ticks = 0

    def update(self, now_ns: int, readings: Readings) -> Setpoint | None:
        """Take the readings of a tick. Return None: the real firmware computes its own setpoint."""
        self.readings = readings
        self._meter()
        self.ticks += 1
        self.arming.armed = bool((readings.motor_command > 0.0).any())
        return None


@dataclass
class _PendingRequest:
    """A client's request and its answer, once there is one."""

    request: Request
    answer: bytes | None = None


@dataclass(frozen=True)
class _StickFrame:
    """The last stick frame, when it was sent (s of the steady clock) and the number of ticks at that time."""

    raw: bytes
    sent_s: float
    tick: int


class _Client:
    """One client of the proxy and its pending requests, in order."""

    def __init__(self, controller: SitlController, forward):
        self._controller, self._forward = controller, forward
        self._reader = RequestReader()
        self._pending: deque[_PendingRequest] = deque()

    def feed(self, data: bytes) -> bytes:
        """Take bytes of requests, split anywhere; return the answers that can be sent."""
        for request in self._reader.feed(data):
            pending = _PendingRequest(request)
            self._pending.append(pending)
            if request.command in ANSWERED_HERE:
                payload = msp_server.ANSWERS[request.command](self._controller, request.payload)
                pending.answer = encode_answer(request, payload)
                continue
            if request.command == Code.SET_RAW_RC:
                self._controller.record_command(request.raw)
                # At once: in lockstep, waiting for the firmware's answer would add 10 ms to each tick.
                pending.answer = encode_answer(request, b"")
            self._forward(pending)
        return self.completed()

    def completed(self) -> bytes:
        """Return the answers that are complete and have no unanswered request before them."""
        frames = []
        while self._pending and self._pending[0].answer is not None:
            frames.append(self._pending.popleft().answer)
        return b"".join(frames)


class SitlProxy(MspSocket):
    """Serves the firmware's MSP to clients.

    While simulated time is paused, the proxy repeats the last stick frame to the firmware, because the firmware's
    receiver uses the wall clock.
    """

    _idle_s = 0.5 * REPEAT_S

    def __init__(self, controller: SitlController, port: int, firmware: socket.socket):
        """Open the port.

        Args:
            controller: meters and counters.
            port: TCP port for the clients, as `MspSocket`.
            firmware: connection to the firmware's MSP port.

        Raises:
            UsageError: the port is in use.
        """
        self._firmware, self._parser = firmware, msp.Parser()
        self._forwarded: deque[_PendingRequest] = deque()
        self._sticks = _StickFrame(b"", time.monotonic(), 0)
        super().__init__(controller, port)
        self.lock = contextlib.nullcontext()  # a tick takes long and shares no data with requests

    def _open_port(self, port: int) -> str:
        name = super()._open_port(port)
        self._selector.register(self._firmware, selectors.EVENT_READ, self._on_firmware_bytes)
        return name

    def close(self) -> None:
        """Stop serving and close everything."""
        super().close()
        self._firmware.close()

    def _new_server(self) -> _Client:
        return _Client(self._controller, self._forward)

    def _forward(self, pending: _PendingRequest) -> None:
        if pending.request.command == Code.SET_RAW_RC:
            self._sticks = _StickFrame(pending.request.raw, time.monotonic(), self._controller.ticks)
        self._forwarded.append(pending)
        self._send(pending.request.raw)

    def _send(self, raw: bytes) -> None:
        with contextlib.suppress(OSError):  # the firmware has ended; the next step reports it
            self._firmware.sendall(raw)

    def _on_firmware_bytes(self, firmware: socket.socket) -> None:
        try:
            data = firmware.recv(CHUNK_BYTES)
        except OSError:
            data = b""
        if not data:
            self._selector.unregister(firmware)
            return
        # A delayed acknowledgement would hold back its next small answer for 40 ms (Nagle's algorithm).
        firmware.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)
        with self._arrived:
            for message in self._parser.feed(data):
                self._take(message)
            completed = [(descriptor, client.completed()) for descriptor, client in self._servers.items()]
        for descriptor, answer in completed:
            self._write(descriptor, answer)

    def _take(self, message: msp.Message) -> None:
        """Give an answer to its request. The firmware answers in order: older requests stay unanswered: refuse them."""
        while self._forwarded:
            pending = self._forwarded.popleft()
            if pending.request.command == message.code:
                refused = message.kind == msp.REFUSAL
                pending.answer = pending.answer or encode_answer(pending.request, message.payload, refused)
                return
            pending.answer = pending.answer or encode_answer(pending.request, b"", refused=True)

    def _idle(self) -> None:
        sticks, now_s = self._sticks, time.monotonic()
        paused = self._controller.ticks - sticks.tick <= PAUSE_TICKS
        if sticks.raw and paused and now_s - sticks.sent_s > REPEAT_S:
            self._forward(_PendingRequest(RequestReader().feed(sticks.raw)[0], answer=b""))

"""The MSP port in front of the real firmware: what it lacks is answered here, everything else goes through.

SITL lets in one client, has neither voltmeter nor rotor telemetry, and cannot tell which frame of sticks it has seen:
so clients connect to the simulator's own port as ever, and this passes on. Answers keep the order of their requests.
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
from swift_sim_bridge.flight_controller.msp_socket import CHUNK, MspSocket

# Of the simulated vehicle's meters, and of the motors, which need not be asked for.
ANSWERED_HERE = (Code.MOTOR, Code.ANALOG, Code.BATTERY_STATE, Code.MOTOR_TELEMETRY)
REPEAT_S = 0.05  # of the wall clock: the firmware calls its receiver lost after 0.1 s
STANDING_TICKS = 2


class SitlController(FlightController):
    """The simulated flight controller as mere meters and counters beside the real firmware. ticks: how many passed."""

    ticks = 0

    def update(self, now_ns: int, readings: Readings) -> Setpoint | None:
        """Take the readings of a tick; there is no setpoint: the firmware has its own."""
        self.readings = readings
        self._meter()
        self.ticks += 1
        self.arming.armed = bool((readings.motor_command > 0.0).any())
        return None


@dataclass
class _Owed:
    """A client's request and, once there is one, the answer's frame."""

    request: Request
    answer: bytes | None = None


@dataclass(frozen=True)
class _Sticks:
    """The last frame of sticks, when it was sent (steady clock) and how many ticks had passed then."""

    raw: bytes
    sent_s: float
    tick: int


class _Client:
    """One client of the port: its requests, in order, and what it is still owed."""

    def __init__(self, controller: SitlController, forward):
        self._controller, self._forward = controller, forward
        self._reader = RequestReader()
        self._owed: deque[_Owed] = deque()

    def feed(self, data: bytes) -> bytes:
        """Take requests, cut anywhere; return the answers that are due."""
        for request in self._reader.feed(data):
            owed = _Owed(request)
            self._owed.append(owed)
            if request.command in ANSWERED_HERE:
                payload = msp_server.ANSWERS[request.command](self._controller, request.payload)
                owed.answer = encode_answer(request, payload)
                continue
            if request.command == Code.SET_RAW_RC:
                self._controller.record_command(request.raw)
                owed.answer = encode_answer(request, b"")  # at once: in lockstep its answer would cost a tick 10 ms
            self._forward(owed)
        return self.due()

    def due(self) -> bytes:
        """Return the answers that no earlier request waits for."""
        frames = []
        while self._owed and self._owed[0].answer is not None:
            frames.append(self._owed.popleft().answer)
        return b"".join(frames)


class SitlProxy(MspSocket):
    """Serves the firmware's MSP. controller: its meters; port: of TCP; firmware: a connection to the firmware's own.

    While simulated time stands, the last frame of sticks is repeated to the firmware: its receiver's clock is the
    wall's. Raises UsageError for a port in use.
    """

    _idle_s = 0.5 * REPEAT_S

    def __init__(self, controller: SitlController, port: int, firmware: socket.socket):
        self._firmware, self._parser = firmware, msp.Parser()
        self._asked: deque[_Owed] = deque()
        self._sticks = _Sticks(b"", time.monotonic(), 0)
        super().__init__(controller, port)
        self.lock = contextlib.nullcontext()  # a tick is long, and works on nothing that requests change

    def _open_port(self, port: int) -> str:
        name = super()._open_port(port)
        self._selector.register(self._firmware, selectors.EVENT_READ, self._hear)
        return name

    def close(self) -> None:
        """Stop serving and close everything."""
        super().close()
        self._firmware.close()

    def _new_server(self) -> _Client:
        return _Client(self._controller, self._ask)

    def _ask(self, owed: _Owed) -> None:
        if owed.request.command == Code.SET_RAW_RC:
            self._sticks = _Sticks(owed.request.raw, time.monotonic(), self._controller.ticks)
        self._asked.append(owed)
        self._send(owed.request.raw)

    def _send(self, raw: bytes) -> None:
        with contextlib.suppress(OSError):  # it has ended: the next step says so
            self._firmware.sendall(raw)

    def _hear(self, firmware: socket.socket) -> None:
        try:
            data = firmware.recv(CHUNK)
        except OSError:
            data = b""
        if not data:
            self._selector.unregister(firmware)
            return
        # Acknowledged late, its next small answer would wait for 40 ms.
        firmware.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)
        with self._arrived:
            for message in self._parser.feed(data):
                self._take(message)
            due = [(descriptor, client.due()) for descriptor, client in self._servers.items()]
        for descriptor, answer in due:
            self._write(descriptor, answer)

    def _take(self, message: msp.Message) -> None:
        """Hand an answer to who asked. Answers come in order: what was asked before it will get none."""
        while self._asked:
            owed = self._asked.popleft()
            if owed.request.command == message.code:
                refused = message.kind == msp.REFUSAL
                owed.answer = owed.answer or encode_answer(owed.request, message.payload, refused)
                return
            owed.answer = owed.answer or encode_answer(owed.request, b"", refused=True)

    def _idle(self) -> None:
        sticks, now_s = self._sticks, time.monotonic()
        stands = self._controller.ticks - sticks.tick <= STANDING_TICKS
        if sticks.raw and stands and now_s - sticks.sent_s > REPEAT_S:
            self._ask(_Owed(RequestReader().feed(sticks.raw)[0], answer=b""))

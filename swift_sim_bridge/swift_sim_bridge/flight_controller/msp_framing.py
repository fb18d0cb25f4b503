"""The firmware's side of MSP framing (Betaflight 4.5, msp_serial.c): requests from bytes, answers to bytes.

Incomplete or corrupt frames are dropped without an answer. As in the firmware, the reader trusts the size of a frame:
it consumes that many bytes and searches for the next `$` after them.
"""

import enum
import struct
from dataclasses import dataclass

LARGEST_REQUEST = 192  # bytes of payload, the size of the firmware's buffer
JUMBO = 255  # size field of version 1: two more bytes of size follow
INNER_V2 = 255  # command of version 1: the payload is a frame of version 2


class Version(enum.Enum):
    """Framing of a request: MSP version 1, version 2, or version 2 inside version 1."""

    V1 = enum.auto()
    V2 = enum.auto()
    V2_IN_V1 = enum.auto()


@dataclass(frozen=True)
class Request:
    """One valid frame to the flight controller; `raw` is the whole frame."""

    version: Version
    command: int
    payload: bytes
    raw: bytes


def checksum_v1(data: bytes) -> int:
    """Return the exclusive or of all bytes."""
    value = 0
    for byte in data:
        value ^= byte
    return value


def _v2_table() -> tuple[int, ...]:
    table = []
    for value in range(256):
        for _ in range(8):
            value = (value << 1) ^ 0xD5 if value & 0x80 else value << 1
            value &= 0xFF
        table.append(value)
    return tuple(table)


_V2_TABLE = _v2_table()


def checksum_v2(data: bytes) -> int:
    """Return the CRC-8/DVB-S2 of all bytes."""
    value = 0
    for byte in data:
        value = _V2_TABLE[value ^ byte]
    return value


class RequestReader:
    """Collects bytes, split anywhere, and returns complete requests.

    Attributes:
        dropped: number of dropped frames.
    """

    def __init__(self):
        self._bytes = bytearray()
        self.dropped = 0

    def feed(self, data: bytes) -> list[Request]:
        """Return the requests that `data` completes, in order."""
        self._bytes += data
        requests = []
        while True:
            start = self._bytes.find(b"$")
            del self._bytes[: len(self._bytes) if start < 0 else start]
            taken, request = self._take()
            if taken == 0:
                return requests
            del self._bytes[:taken]
            if request is not None:
                requests.append(request)

    def _take(self) -> tuple[int, Request | None]:
        """Return (bytes to remove, request or None) of bytes that begin with `$`; (0, None) while some are missing."""
        data = self._bytes
        if len(data) < 3:
            bad_letter = len(data) == 2 and data[1] not in b"MX"
            return self._drop(2) if bad_letter else (0, None)
        if data[1] not in b"MX":
            return self._drop(2)
        if data[2] not in b"<>":
            return self._drop(3)
        return self._take_v1() if data[1] == ord("M") else self._take_v2()

    def _drop(self, count: int) -> tuple[int, None]:
        self.dropped += 1
        return count, None

    def _take_v1(self) -> tuple[int, Request | None]:
        data = self._bytes
        if len(data) < 5:
            return 0, None
        size, command = data[3], data[4]
        if size > LARGEST_REQUEST:
            return self._drop(5)
        end = 6 + size
        if len(data) < end:
            return 0, None
        raw, payload = bytes(data[:end]), bytes(data[5 : end - 1])
        if checksum_v1(raw[3:-1]) != raw[-1]:
            return self._drop(end)
        if command != INNER_V2:
            return end, self._if_request(Request(Version.V1, command, payload, raw))
        if len(payload) < 6 or checksum_v2(payload[:-1]) != payload[-1]:
            return self._drop(end)
        inner_command, inner_size = struct.unpack_from("<HH", payload, 1)
        if inner_size != len(payload) - 6:
            return self._drop(end)
        return end, self._if_request(Request(Version.V2_IN_V1, inner_command, payload[5:-1], raw))

    def _take_v2(self) -> tuple[int, Request | None]:
        data = self._bytes
        if len(data) < 8:
            return 0, None
        command, size = struct.unpack_from("<HH", data, 4)
        if size > LARGEST_REQUEST:  # the firmware lacks this check and overruns its buffer
            return self._drop(8)
        end = 9 + size
        if len(data) < end:
            return 0, None
        raw = bytes(data[:end])
        if checksum_v2(raw[3:-1]) != raw[-1]:
            return self._drop(end)
        return end, self._if_request(Request(Version.V2, command, raw[8:-1], raw))

    @staticmethod
    def _if_request(request: Request) -> Request | None:
        return request if request.raw[2:3] == b"<" else None  # an answer is not a request


def encode_answer(request: Request, payload: bytes, refused: bool = False) -> bytes:
    """Return the frame that answers a request, in the framing of the request; `refused` marks it with `!`."""
    mark = b"!" if refused else b">"
    inner = struct.pack("<BHH", 0, request.command, len(payload)) + payload
    if request.version is Version.V2:
        return b"$X" + mark + inner + bytes([checksum_v2(inner)])
    if request.version is Version.V2_IN_V1:
        body, command = inner + bytes([checksum_v2(inner)]), INNER_V2
    else:
        body, command = payload, request.command
    head = bytes([len(body), command]) if len(body) < JUMBO else struct.pack("<BBH", JUMBO, command, len(body))
    return b"$M" + mark + head + body + bytes([checksum_v1(head + body)])

"""MSP framing: the request-and-answer protocol of Betaflight, on serial ports and, with SITL, on TCP.

A frame is `$`, `M` (version 1) or `X` (version 2), a direction (`<` to the flight controller, `>` from it, `!` from it
when it refuses), code, size, payload and checksum. In version 1, a size of 255 means that two more bytes of size follow
(jumbo), and a code of 255 that the payload is a version-2 frame. Source: Betaflight, `msp_serial.c`.
"""

import functools
import operator
import struct
from dataclasses import dataclass

REQUEST, REPLY, REFUSAL = "<", ">", "!"
MAX_PAYLOAD = 4096  # bytes, above all answers used here; a larger size is a corrupt one
JUMBO, INNER_V2 = 255, 255  # size and code of version 1 with these meanings
_POLYNOMIAL = 0xD5  # DVB-S2
_NEEDS_MORE, _BROKEN = "needs more", "broken"


@dataclass(frozen=True)
class Message:
    """One valid frame.

    Attributes:
        code: code of the message.
        payload: its content.
        kind: REQUEST, REPLY or REFUSAL.
        version: 1 or 2.
    """

    code: int
    payload: bytes = b""
    kind: str = REPLY
    version: int = 2


def encode(message: Message) -> bytes:
    """Return the frame of a message. Raises ValueError for a code that version 1 cannot carry or too long a payload."""
    size = len(message.payload)
    if size > MAX_PAYLOAD:
        raise ValueError(f"an MSP payload of {size} bytes is too long")
    if message.version == 2:
        body = struct.pack("<BHH", 0, message.code, size) + message.payload
        return b"$X" + message.kind.encode() + body + bytes([crc8(body)])
    if message.code >= INNER_V2:
        raise ValueError(f"MSP version 1 cannot carry code {message.code}")
    head = struct.pack("<BBH", JUMBO, message.code, size) if size >= JUMBO else bytes([size, message.code])
    body = head + message.payload
    return b"$M" + message.kind.encode() + body + bytes([exclusive_or(body)])


class Parser:
    """Parses bytes, split anywhere, into messages.

    Invalid bytes are skipped and counted. The search continues after the first byte of a broken frame, so a valid
    frame is found as soon as it is complete, even within the length that a corrupt size claims.

    Attributes:
        bad: number of broken frames plus number of other runs of bytes that belong to no frame.
    """

    def __init__(self):
        self.bad = 0
        self._bytes = bytearray()
        self._skipping = False

    def feed(self, chunk: bytes) -> list[Message]:
        """Return the messages (in order) that `chunk` completes."""
        self._bytes += chunk
        messages = []
        while (found := self._next()) is not None:
            messages.append(found)
        return messages

    def _next(self) -> Message | None:
        """Return the next valid frame and drop all bytes up to its end; without one, keep a possible beginning."""
        keep_from, broken, position = None, 0, 0
        while (start := self._bytes.find(b"$", position)) >= 0:
            frame, end = _read_frame(self._bytes, start)
            if isinstance(frame, Message):
                # An incomplete frame before a valid one will never be completed.
                self._drop(start, broken + (keep_from is not None))
                del self._bytes[: end - start]
                self._skipping = False
                return frame
            if frame == _NEEDS_MORE and keep_from is None:
                keep_from = start
            elif frame == _BROKEN and keep_from is None:
                broken += end > start + 1
            position = start + 1
        self._drop(len(self._bytes) if keep_from is None else keep_from, broken)
        return None

    def _drop(self, count: int, broken: int) -> None:
        if broken:
            self.bad += broken
            self._skipping = True
        elif count and not self._skipping:
            self.bad += 1
            self._skipping = True
        del self._bytes[:count]


def _read_frame(data: bytearray, start: int):
    """Return (message, its end), (_NEEDS_MORE, start) or (_BROKEN, end of the recognised header) for `data[start:]`."""
    head = bytes(data[start : start + 8])
    if len(head) < 3:
        possible = head[1:2] in (b"", b"M", b"X")
        return (_NEEDS_MORE, start) if possible else (_BROKEN, start)
    if head[1:2] not in (b"M", b"X") or head[2:3] not in (b"<", b">", b"!"):
        return _BROKEN, start
    read = _read_v1 if head[1:2] == b"M" else _read_v2
    return read(data, start, chr(head[2]))


def _read_v2(data: bytearray, start: int, kind: str):
    if len(data) < start + 8:
        return _NEEDS_MORE, start
    _, code, size = struct.unpack_from("<BHH", data, start + 3)
    end = start + 8 + size + 1
    if size > MAX_PAYLOAD:
        return _BROKEN, start + 8
    if len(data) < end:
        return _NEEDS_MORE, start
    body = bytes(data[start + 3 : end - 1])
    if crc8(body) != data[end - 1]:
        return _BROKEN, start + 8
    return Message(code, body[5:], kind, 2), end


def _read_v1(data: bytearray, start: int, kind: str):
    if len(data) < start + 5:
        return _NEEDS_MORE, start
    size, code = data[start + 3], data[start + 4]
    head_end = start + 5
    if size == JUMBO:
        if len(data) < start + 7:
            return _NEEDS_MORE, start
        size, head_end = struct.unpack_from("<H", data, start + 5)[0], start + 7
    end = head_end + size + 1
    if size > MAX_PAYLOAD:
        return _BROKEN, head_end
    if len(data) < end:
        return _NEEDS_MORE, start
    body, payload = data[start + 3 : end - 1], bytes(data[head_end : end - 1])
    if exclusive_or(body) != data[end - 1]:
        return _BROKEN, head_end
    if code != INNER_V2:
        return Message(code, payload, kind, 1), end
    if len(payload) < 6 or crc8(payload[:-1]) != payload[-1]:
        return _BROKEN, head_end
    return Message(struct.unpack_from("<H", payload, 1)[0], payload[5:-1], kind, 2), end


def exclusive_or(data) -> int:
    """Return the checksum of version 1: the exclusive or of all bytes."""
    return functools.reduce(operator.xor, data, 0)


def crc8(data: bytes) -> int:
    """Return the checksum of version 2: CRC-8/DVB-S2."""
    crc = 0
    for byte in data:
        crc = _CRC_TABLE[crc ^ byte]
    return crc


def _crc_table():
    for value in range(256):
        for _ in range(8):
            value = (value << 1) ^ _POLYNOMIAL if value & 0x80 else value << 1
        yield value & 0xFF


_CRC_TABLE = bytes(_crc_table())

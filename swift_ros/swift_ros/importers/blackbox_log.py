"""Decodes Betaflight blackbox logs ("Blackbox logging internals", data version 2). No ROS.

A file has one log for each arming: text lines that name fields, predictors and encodings, then frames that begin with a
letter. I frames are complete, P frames hold the difference to a prediction, S, G and H frames are slow ones, E frames
are events. A frame is valid when another frame begins where it ends. After an invalid frame all main frames are skipped
up to the next I frame.
"""

import re
from dataclasses import dataclass, field

import numpy as np

from swift_ros.errors import UsageError
from swift_ros.importers.blackbox_bytes import Bytes, InvalidFrame, sign_extended
from swift_ros.text import excerpt

BEGIN = b"H Product:Blackbox flight data recorder"
LETTERS = b"IPSGHE"
END_EVENT, END_TEXT = 255, b"End of log"
EVENT_NUMBERS = {0: 1, 14: 2, 15: 1, 30: 2}  # by event: how many integers follow
ADJUSTMENT_EVENT, FLOAT_ADJUSTMENT = 13, 128  # event, and its bit for a value in single precision
MAX_FRAME_BYTES = 256  # bytes; a longer frame is invalid
MAX_FIELDS = 255  # of a frame, three times as many as Betaflight writes
# us; longest time between successive frames, and from a frame to the next I frame; longer ones are invalid times
MAX_STEP_US, MAX_PAUSE_US = 100_000, 10_000_000
WRAP_US = 1 << 32  # us; the controller's clock has 32 bits
# encodings of a field
SIGNED, UNSIGNED, NEGATIVE_14, GROUP_8, THREE, FOUR, NOTHING = 0, 1, 3, 6, 7, 8, 9
# predictors of a field
(
    AS_IS,
    PREVIOUS,
    LINE,
    AVERAGE,
    MIN_THROTTLE,
    FIRST_MOTOR,
    COUNT,
    HOME,
    CENTRE,
    VBAT_REFERENCE,
    MAIN_TIME,
    MIN_MOTOR,
) = range(12)


@dataclass(frozen=True)
class Frame:
    """Format of the frames of one letter.

    Attributes:
        names: of the fields.
        signed: 1 for a field that can be negative.
        predictor: of each field.
        encoding: of each field.
    """

    names: tuple[str, ...]
    signed: tuple[int, ...]
    predictor: tuple[int, ...]
    encoding: tuple[int, ...]


@dataclass(frozen=True)
class Log:
    """One log.

    Attributes:
        header: texts by name.
        time_us: increasing times (n,) of the main frames, us, unwrapped beyond the controller's 32 bits.
        fields: integers (n,) of the main frames, by name.
        gaps: first and last time (us) of each part that cannot be decoded.
        ended: the end of the log was written, the file is not truncated.
    """

    header: dict[str, str]
    time_us: np.ndarray
    fields: dict[str, np.ndarray]
    gaps: list[tuple[int, int]] = field(default_factory=list)
    ended: bool = True


def split(data: bytes) -> list[bytes]:
    """Return the logs of a file, one after each arming."""
    starts, at = [], data.find(BEGIN)
    while at >= 0:
        starts.append(at)
        at = data.find(BEGIN, at + len(BEGIN))
    return [data[begin:end] for begin, end in zip(starts, [*starts[1:], len(data)], strict=False)]


def decode(data: bytes, where: str) -> Log:
    """Return one decoded log.

    Args:
        data: bytes of the log, see `split`.
        where: name of the log in errors.

    Raises:
        UsageError: the header is damaged, or uses an unknown version, predictor or encoding.
    """
    header, at = _header(data)
    frames = {letter: _frame(header, letter, where) for letter in "ISGH" if f"Field {letter} name" in header}
    if "I" not in frames or "time" not in frames["I"].names or "Field P predictor" not in header:
        raise UsageError(f"{where} does not name its fields; the log's header is damaged")
    if header.get("Data version") != "2":
        raise UsageError(f"{where} has data version {excerpt(header.get('Data version', 'none'))}; only 2 is supported")
    return _Decoder(data, at, header, frames, where).run()


def _header(data: bytes) -> tuple[dict[str, str], int]:
    """Return the header's lines by name, and the position of the first frame."""
    header, at = {}, 0
    while data.startswith(b"H ", at):
        end = data.find(b"\n", at)
        line = data[at + 2 : end] if end >= 0 else b""
        if b":" not in line or b"\0" in line:
            break  # a frame of the home position begins with the same letter
        name, _, value = line.decode("latin-1").partition(":")
        header[name] = value.strip()
        at = end + 1
    return header, at


def _frame(header: dict[str, str], letter: str, where: str) -> Frame:
    """Return the format of the frames of one letter. Raises UsageError when the header is damaged."""
    names = tuple(header[f"Field {letter} name"].split(","))
    if len(names) > MAX_FIELDS:
        raise UsageError(f"{where}: the header's 'Field {letter} name' has {len(names)} names; it is damaged")
    kinds = []
    for kind in ("signed", "predictor", "encoding"):
        text = header.get(f"Field {letter} {kind}", "").split(",")
        if len(text) != len(names) or not all(re.fullmatch("[0-9]{1,3}", number) for number in text):
            raise UsageError(f"{where}: the header's 'Field {letter} {kind}' does not fit its names; it is damaged")
        kinds.append(tuple(map(int, text)))
    return Frame(names, *kinds)


def header_number(header: dict[str, str], name: str, default: int, where: str) -> int:
    """Return the first number in a line of the header.

    Args:
        header: the header's lines.
        name: of the line.
        default: result without the line.
        where: name of the log in errors.

    Raises:
        UsageError: the line does not begin with a whole number.
    """
    text = header.get(name, str(default)).split(",")[0]
    if not re.fullmatch("-?[0-9]{1,9}", text):
        raise UsageError(f"{where}: the header's '{name}' does not begin with a whole number; it is damaged")
    return int(text)


class _Decoder(Bytes):
    """Decodes the frames of one log in their order, and keeps the frames that predictors refer to."""

    def __init__(self, data: bytes, at: int, header: dict[str, str], frames: dict[str, Frame], where: str):
        super().__init__(data, at)
        self.header, self.where = header, where
        inter = {f"Field P {key}": header.get(f"Field P {key}", "") for key in ("predictor", "encoding")}
        inter |= {f"Field P {key}": header[f"Field I {key}"] for key in ("name", "signed")}
        self.frames = frames | {"P": _frame(inter, "P", where)}
        self.names = frames["I"].names
        self.time, self.first_motor = self.names.index("time"), self._index("motor[0]")
        self.constants = {
            AS_IS: 0,
            CENTRE: 1500,
            VBAT_REFERENCE: header_number(header, "vbatref", 4095, where),
            MIN_THROTTLE: header_number(header, "minthrottle", 1150, where),
            MIN_MOTOR: header_number(header, "motorOutput", 1150, where),
            HOME: 0,
        }
        self.last = self.before = None  # newest main frame and the one before; None: waiting for an I frame
        self.refused_us: int | None = None  # time of the last refused I frame
        self.rows: list[list[int]] = []
        self.times: list[int] = []
        self.gaps: list[tuple[int, int]] = []
        self.in_gap = self.ended = False

    def run(self) -> Log:
        """Return the log."""
        data = self.data
        while self.at < len(data) and not self.ended:
            begin = self.at
            letter = chr(data[begin])
            try:
                self.at = begin + 1
                store = self._read(letter)
                invalid = self.at < len(data) and data[self.at] not in LETTERS and not self.ended
            except InvalidFrame:
                invalid = True
            if invalid or self.at - begin > MAX_FRAME_BYTES:
                self.at, self.last, self.in_gap = begin + 1, None, bool(self.rows)
            else:
                store()
        table = np.array(self.rows, dtype=np.int64).reshape(-1, len(self.names))
        fields = {name: table[:, i] for i, name in enumerate(self.names)}
        return Log(self.header, np.array(self.times, dtype=np.int64), fields, self.gaps, self.ended)

    def _read(self, letter: str):
        """Decode one frame and return the function that stores it, to be called when it is valid."""
        if letter == "E":
            return self._event()
        if letter not in self.frames:
            raise InvalidFrame
        if letter == "P":
            last = self.last
            if last is None:
                raise InvalidFrame
            values = self._fields("P", last, self.before)
            return lambda: self._store(values, last, MAX_STEP_US)
        values = self._fields(letter, None, None)
        return (lambda: self._store(values, values, MAX_PAUSE_US)) if letter == "I" else (lambda: None)

    def _store(self, values: list[int], before: list[int], max_step_us: int) -> None:
        """Store a main frame, unless its time is invalid: then wait for the next I frame."""
        stamp = values[self.time] % WRAP_US
        if self.times and not 0 < (stamp - self.times[-1]) % WRAP_US < max_step_us:
            self.last, self.in_gap = None, True
            if max_step_us != MAX_PAUSE_US or not self._confirmed(stamp):
                return
        now = self.times[-1] + (stamp - self.times[-1]) % WRAP_US if self.times else stamp
        if self.in_gap and self.times:
            self.gaps.append((self.times[-1], now))
        self.in_gap, self.refused_us = False, None
        self.rows.append(values)
        self.times.append(now)
        self.before, self.last = before, values

    def _confirmed(self, stamp: int) -> bool:
        """Return whether this I frame and the refused one before it agree with each other, but not with stored frames.

        Either the log paused, or stored frames of later times were invalid; these are removed.
        """
        refused, self.refused_us = self.refused_us, stamp
        if refused is None or not 0 < (stamp - refused) % WRAP_US < MAX_PAUSE_US:
            return False
        while self.times and not 0 < (stamp - self.times[-1]) % WRAP_US <= WRAP_US // 2:
            del self.times[-1], self.rows[-1]
        self.gaps = [gap for gap in self.gaps if self.times and gap[1] <= self.times[-1]]
        return True

    def _event(self):
        """Decode one event; return the function that stores it, which does nothing."""
        kind = self.byte()
        if kind == END_EVENT:
            if not self.data.startswith(END_TEXT, self.at):
                raise InvalidFrame
            self.at, self.ended = self.at + len(END_TEXT), True
            return lambda: None
        if kind == ADJUSTMENT_EVENT:
            if self.byte() < FLOAT_ADJUSTMENT:
                self.signed()
            else:
                self.at += 4
            return lambda: None
        if kind not in EVENT_NUMBERS:
            raise InvalidFrame
        for _ in range(EVENT_NUMBERS[kind]):
            self.unsigned()
        return lambda: None

    def _fields(self, letter: str, last, before) -> list[int]:
        """Decode the fields of one frame; predictors refer to the frames `last` and `before`."""
        frame, values, i = self.frames[letter], [], 0
        count = len(frame.names)
        while i < count:
            encoding = frame.encoding[i]
            if encoding == SIGNED:
                numbers = (self.signed(),)
            elif encoding == UNSIGNED:
                numbers = (self.unsigned(),)
            elif encoding == NOTHING:
                numbers = (0,)
            elif encoding == NEGATIVE_14:
                numbers = (-sign_extended(self.unsigned() & 0x3FFF, 14),)
            elif encoding == GROUP_8:
                numbers = self.group(_group_size(frame.encoding, i))
            elif encoding == THREE:
                numbers = self.three()
            elif encoding == FOUR:
                numbers = self.four()
            else:
                raise UsageError(f"{self.where} uses the unknown encoding {encoding} for {excerpt(frame.names[i])}")
            for value in numbers:
                if i == count:
                    raise InvalidFrame
                values.append(self._predicted(frame, i, value, values, last, before))
                i += 1
        return values

    def _predicted(self, frame: Frame, i: int, value: int, values, last, before) -> int:
        """Return the value of field i: the decoded number plus its prediction."""
        predictor = frame.predictor[i]
        if predictor == AS_IS:
            pass
        elif predictor == PREVIOUS:
            value += last[i] if last else 0
        elif predictor == AVERAGE:
            value += _half(last[i] + before[i]) if last else 0
        elif predictor == LINE:
            value += 2 * last[i] - before[i] if last else 0
        elif predictor == FIRST_MOTOR:
            value += self._first_motor_of(values)
        elif predictor == COUNT:
            value += last[i] + 1 if last else 0
        elif predictor == MAIN_TIME:
            value += self.times[-1] if self.times else 0
        elif predictor in self.constants:
            value += self.constants[predictor]
        else:
            raise UsageError(f"{self.where} uses the unknown predictor {predictor} for {excerpt(frame.names[i])}")
        return sign_extended(value & 0xFFFFFFFF, 32) if frame.signed[i] else value & 0xFFFFFFFF

    def _first_motor_of(self, values: list[int]) -> int:
        """Return the first motor's value among the fields of a frame decoded so far."""
        if self.first_motor is None or self.first_motor >= len(values):
            raise UsageError(f"{self.where} refers to motor[0] before it is known; the log's header is damaged")
        return values[self.first_motor]

    def _index(self, name: str) -> int | None:
        return self.names.index(name) if name in self.names else None


def _group_size(encoding: tuple[int, ...], i: int) -> int:
    """Return the number of fields, at most eight, that are encoded as one group from field i on."""
    count = 1
    while count < 8 and i + count < len(encoding) and encoding[i + count] == GROUP_8:
        count += 1
    return count


def _half(value: int) -> int:
    """Return half of a number, rounded towards zero as C does."""
    return value // 2 if value >= 0 else -(-value // 2)

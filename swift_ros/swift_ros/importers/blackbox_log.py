"""The flight controller's own log, as Betaflight writes it ("Blackbox logging internals", data version 2). Pure.

A file holds one log after each arming: text lines that name fields, predictors and encodings, then frames that begin
with a letter. I frames stand alone, P frames hold what their predictor did not foresee, S, G and H frames are slow
ones, E frames tell events. A frame is believed when the next one begins where it ends; after one that is not, nothing
is until the next I frame.
"""

from dataclasses import dataclass, field

import numpy as np

from swift_ros.errors import UsageError
from swift_ros.importers.blackbox_bytes import Bytes, Torn, extended

BEGIN = b"H Product:Blackbox flight data recorder"
LETTERS = b"IPSGHE"
END_EVENT, END_TEXT = 255, b"End of log"
EVENT_NUMBERS = {0: 1, 14: 2, 15: 1, 30: 2}  # event: how many whole numbers it tells
ADJUSTMENT_EVENT, FLOAT_ADJUSTMENT = 13, 128
LONGEST_FRAME = 256
LONGEST_STEP_US, LONGEST_PAUSE_US = 100_000, 10_000_000  # between frames in step, and to the next I frame
WRAP_US = 1 << 32
SIGNED, UNSIGNED, NEGATIVE_14, GROUP_8, THREE, FOUR, NOTHING = 0, 1, 3, 6, 7, 8, 9
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
    """How the frames of one letter are written. names; predictor, encoding: of each field; signed: whether it can be
    negative."""

    names: tuple[str, ...]
    signed: tuple[int, ...]
    predictor: tuple[int, ...]
    encoding: tuple[int, ...]


@dataclass(frozen=True)
class Log:
    """One log. header: text by name; fields (n,) whole numbers by name, of main frames; time_us (n,), growing, also
    past the controller's 32 bits; gaps: first and last time (us) of stretches that cannot be read; ended: whether its
    end was written, not torn off."""

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
    """Return one log of a file (see `split`); `where` names it in errors.

    Raises UsageError when its header does not say how the frames are written, or in a way that is not known.
    """
    header, at = _header(data)
    frames = {letter: _frame(header, letter, where) for letter in "ISGH" if f"Field {letter} name" in header}
    if "I" not in frames or "time" not in frames["I"].names or "Field P predictor" not in header:
        raise UsageError(f"{where} does not name its fields; the log's header is damaged")
    if header.get("Data version") != "2":
        raise UsageError(f"{where} has data version {header.get('Data version')}; 2 can be read")
    return _Decoder(data, at, header, frames, where).run()


def _header(data: bytes) -> tuple[dict[str, str], int]:
    """Return the header's lines by name, and where the frames begin."""
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
    names = tuple(header[f"Field {letter} name"].split(","))
    kinds = []
    for kind in ("signed", "predictor", "encoding"):
        text = header.get(f"Field {letter} {kind}", "").split(",")
        if len(text) != len(names) or not all(number.isdigit() for number in text):
            raise UsageError(f"{where}: the header's 'Field {letter} {kind}' does not fit its names; it is damaged")
        kinds.append(tuple(map(int, text)))
    return Frame(names, *kinds)


class _Decoder(Bytes):
    """Reads the frames of one log in their order. It keeps what predictors look back to."""

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
            VBAT_REFERENCE: self._number("vbatref", 4095),
            MIN_THROTTLE: self._number("minthrottle", 1150),
            MIN_MOTOR: self._number("motorOutput", 1150),
            HOME: 0,
        }
        self.last = self.before = None  # main frames, of which the newer is last; None: not in step
        self.doubted_us: int | None = None
        self.rows: list[list[int]] = []
        self.times: list[int] = []
        self.gaps: list[tuple[int, int]] = []
        self.broken = self.ended = False

    def run(self) -> Log:
        """Return the log."""
        data = self.data
        while self.at < len(data) and not self.ended:
            begin = self.at
            letter = chr(data[begin])
            try:
                self.at = begin + 1
                keep = self._read(letter)
                torn = self.at < len(data) and data[self.at] not in LETTERS and not self.ended
            except Torn:
                torn = True
            if torn or self.at - begin > LONGEST_FRAME:
                self.at, self.last, self.broken = begin + 1, None, bool(self.rows)
            else:
                keep()
        table = np.array(self.rows, dtype=np.int64).reshape(-1, len(self.names))
        fields = {name: table[:, i] for i, name in enumerate(self.names)}
        return Log(self.header, np.array(self.times, dtype=np.int64), fields, self.gaps, self.ended)

    def _read(self, letter: str):
        """Read one frame and return what is to be done when it can be believed."""
        if letter == "E":
            return self._event()
        if letter not in self.frames:
            raise Torn
        if letter == "P":
            if self.last is None:
                raise Torn
            values = self._fields("P", self.last, self.before)
            return lambda: self._take(values, self.last, LONGEST_STEP_US)
        values = self._fields(letter, None, None)
        return (lambda: self._take(values, values, LONGEST_PAUSE_US)) if letter == "I" else (lambda: None)

    def _take(self, values: list[int], before: list[int], longest_us: int) -> None:
        """Keep a main frame, unless its time cannot be: then nothing is in step until the next I frame."""
        stamp = values[self.time] % WRAP_US
        if self.times and not 0 < (stamp - self.times[-1]) % WRAP_US < longest_us:
            self.last, self.broken = None, True
            if longest_us != LONGEST_PAUSE_US or not self._overruled(stamp):
                return
        now = self.times[-1] + (stamp - self.times[-1]) % WRAP_US if self.times else stamp
        if self.broken and self.times:
            self.gaps.append((self.times[-1], now))
        self.broken, self.doubted_us = False, None
        self.rows.append(values)
        self.times.append(now)
        self.before, self.last = before, values

    def _overruled(self, stamp: int) -> bool:
        """Return whether this I frame and the one before it agree against what was kept: then the log paused, or what
        was kept of a later time was no frame, and is taken back."""
        doubted, self.doubted_us = self.doubted_us, stamp
        if doubted is None or not 0 < (stamp - doubted) % WRAP_US < LONGEST_PAUSE_US:
            return False
        while self.times and (stamp - self.times[-1]) % WRAP_US > WRAP_US // 2:
            del self.times[-1], self.rows[-1]
        self.gaps = [gap for gap in self.gaps if self.times and gap[1] <= self.times[-1]]
        return True

    def _event(self):
        kind = self.byte()
        if kind == END_EVENT:
            if not self.data.startswith(END_TEXT, self.at):
                raise Torn
            self.at, self.ended = self.at + len(END_TEXT), True
            return lambda: None
        if kind == ADJUSTMENT_EVENT:
            if self.byte() < FLOAT_ADJUSTMENT:
                self.signed()
            else:
                self.at += 4
            return lambda: None
        if kind not in EVENT_NUMBERS:
            raise Torn
        for _ in range(EVENT_NUMBERS[kind]):
            self.unsigned()
        return lambda: None

    def _fields(self, letter: str, last, before) -> list[int]:
        frame, values, i = self.frames[letter], [], 0
        count = len(frame.names)
        while i < count:
            encoding = frame.encoding[i]
            if encoding == SIGNED:
                told = (self.signed(),)
            elif encoding == UNSIGNED:
                told = (self.unsigned(),)
            elif encoding == NOTHING:
                told = (0,)
            elif encoding == NEGATIVE_14:
                told = (-extended(self.unsigned() & 0x3FFF, 14),)
            elif encoding == GROUP_8:
                told = self.group(_alike(frame.encoding, i))
            elif encoding == THREE:
                told = self.three()
            elif encoding == FOUR:
                told = self.four()
            else:
                raise UsageError(f"{self.where} encodes {frame.names[i]} in way {encoding}, which is not known")
            for value in told:
                if i == count:
                    raise Torn
                values.append(self._predicted(frame, i, value, values, last, before))
                i += 1
        return values

    def _predicted(self, frame: Frame, i: int, value: int, values, last, before) -> int:
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
            value += values[self.first_motor]
        elif predictor == COUNT:
            value += last[i] + 1 if last else 0
        elif predictor == MAIN_TIME:
            value += self.times[-1] if self.times else 0
        elif predictor in self.constants:
            value += self.constants[predictor]
        else:
            raise UsageError(f"{self.where} predicts {frame.names[i]} in way {predictor}, which is not known")
        return extended(value & 0xFFFFFFFF, 32) if frame.signed[i] else value & 0xFFFFFFFF

    def _index(self, name: str) -> int | None:
        return self.names.index(name) if name in self.names else None

    def _number(self, name: str, default: int) -> int:
        text = self.header.get(name, "").split(",")[0]
        return int(text) if text.lstrip("-").isdigit() else default


def _alike(encoding: tuple[int, ...], i: int) -> int:
    """Return how many fields, eight at most, are written as one group from i on."""
    count = 1
    while count < 8 and i + count < len(encoding) and encoding[i + count] == GROUP_8:
        count += 1
    return count


def _half(value: int) -> int:
    """Return half of a number, rounded towards zero as C does."""
    return value // 2 if value >= 0 else -(-value // 2)

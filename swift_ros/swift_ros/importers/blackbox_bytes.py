"""Decodes the numbers in the frames of a blackbox log ("Blackbox logging internals"). No ROS."""


class InvalidFrame(Exception):
    """The bytes end within a frame, or are not a frame."""


class Bytes:
    """Decodes numbers from `data`, from position `at` on. Every method raises InvalidFrame at the end of the data."""

    def __init__(self, data: bytes, at: int):
        self.data, self.at = data, at

    def byte(self) -> int:
        """Return the next byte."""
        if self.at >= len(self.data):
            raise InvalidFrame
        self.at += 1
        return self.data[self.at - 1]

    def unsigned(self) -> int:
        """Return an unsigned number of seven bits per byte, lowest first, in at most five bytes."""
        result = 0
        for shift in (0, 7, 14, 21, 28):
            byte = self.byte()
            result |= (byte & 0x7F) << shift
            if byte < 0x80:
                return result
        raise InvalidFrame

    def signed(self) -> int:
        """Return a signed number in zigzag encoding, its bytes like those of an unsigned one."""
        value = self.unsigned()
        return (value >> 1) ^ -(value & 1)

    def group(self, count: int) -> tuple[int, ...]:
        """Return up to eight numbers after a byte of flags for the nonzero ones; a single number has no flags."""
        if count == 1:
            return (self.signed(),)
        flags = self.byte()
        return tuple(self.signed() if flags >> i & 1 else 0 for i in range(count))

    def three(self) -> tuple[int, ...]:
        """Return three numbers of 2, 4 or 6 bits or whole bytes, selected by the two highest bits of the first byte."""
        lead = self.byte()
        kind = lead >> 6
        if kind == 0:
            return tuple(sign_extended(lead >> shift & 3, 2) for shift in (4, 2, 0))
        if kind == 1:
            second = self.byte()
            return tuple(sign_extended(part & 15, 4) for part in (lead, second >> 4, second))
        if kind == 2:
            return tuple(sign_extended(part & 63, 6) for part in (lead, self.byte(), self.byte()))
        return tuple(self._whole_bytes(1 + (lead >> shift & 3)) for shift in (0, 2, 4))

    def four(self) -> tuple[int, ...]:
        """Return four numbers of 0, 4, 8 or 16 bits, packed across byte boundaries, highest bits first."""
        selector = self.byte()
        sizes = [(0, 4, 8, 16)[selector >> 2 * i & 3] for i in range(4)]
        count = (sum(sizes) + 7) // 8
        packed, left, values = 0, 8 * count, []
        for _ in range(count):
            packed = packed << 8 | self.byte()
        for size in sizes:
            left -= size
            values.append(sign_extended(packed >> left & (1 << size) - 1, size) if size else 0)
        return tuple(values)

    def _whole_bytes(self, count: int) -> int:
        return sign_extended(sum(self.byte() << 8 * i for i in range(count)), 8 * count)


def sign_extended(value: int, bits: int) -> int:
    """Return the value of a two's-complement number of `bits` bits."""
    return value - (1 << bits) if value >> (bits - 1) & 1 else value

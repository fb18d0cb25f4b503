"""Writer of blackbox logs in the format of Betaflight 4.5 ("Blackbox logging internals"), for tests of the reader."""

import numpy as np

NAMES = (
    "loopIteration",
    "time",
    *(f"axisI[{i}]" for i in range(3)),
    *(f"rcCommand[{i}]" for i in range(4)),
    *(f"setpoint[{i}]" for i in range(4)),
    "vbatLatest",
    "amperageLatest",
    "rssi",
    *(f"gyroADC[{i}]" for i in range(3)),
    *(f"accSmooth[{i}]" for i in range(3)),
    *(f"motor[{i}]" for i in range(4)),
    *(f"eRPM[{i}]" for i in range(4)),
    *(f"axisF[{i}]" for i in range(3)),
)
SIGNED = [0, 0, 1, 1, 1, 1, 1, 1, 0, 1, 1, 1, 1, 0, 1, 0, *[1] * 6, *[0] * 8, *[1] * 3]
I_PREDICTOR = [*[0] * 13, 9, *[0] * 8, 11, 5, 5, 5, *[0] * 7]
I_ENCODING = [1, 1, *[0] * 6, 1, *[0] * 4, 3, 0, 1, *[0] * 6, 1, 0, 0, 0, *[1] * 4, *[0] * 3]
P_PREDICTOR = [6, 2, *[1] * 14, *[3] * 10, *[1] * 7]
P_ENCODING = [9, 0, 7, 7, 7, *[8] * 8, 6, 6, 6, *[0] * 17]
VBAT_REFERENCE, MOTOR_LOW, INTERVAL = 1680, 158, 32
SLOW = b"S" + bytes([1, 0, 0])  # flight modes, state flags, and three small numbers in one byte
BEEP = b"E" + bytes([0, 5])
END = b"E" + bytes([255]) + b"End of log\0"
SETTINGS = {
    "Firmware revision": "Betaflight 4.5.2 (024f8e13d) STM32F7X2",
    "I interval": INTERVAL,
    "P interval": 1,
    "gyro_scale": "0x3f800000",
    "motorOutput": f"{MOTOR_LOW},2047",
    "acc_1G": 2048,
    "vbatref": VBAT_REFERENCE,
    "motor_poles": 14,
    "blackbox_high_resolution": 0,
}


def written(rows, settings: dict | None = None, ended: bool = True) -> bytes:
    """Return the log of rows (n, 33) of whole numbers, in the order of NAMES."""
    log, before, last = bytearray(_header(SETTINGS | (settings or {}))), None, None
    for count, row in enumerate(np.asarray(rows).tolist()):
        if count % INTERVAL == 0:
            log += b"I" + _intra(row)
            before = last = row
        else:
            log += b"P" + _inter(row, last, before)
            before, last = last, row
        if count % 100 == 0:
            log += SLOW + BEEP
    return bytes(log + END) if ended else bytes(log)


def _header(settings: dict) -> bytes:
    """Return the header lines with names, predictors and encodings of all fields."""
    lines = {"Product": "Blackbox flight data recorder by Nicholas Sherlock", "Data version": 2}
    for letter, rows in {
        "I": {"name": NAMES, "signed": SIGNED, "predictor": I_PREDICTOR, "encoding": I_ENCODING},
        "P": {"predictor": P_PREDICTOR, "encoding": P_ENCODING},
        "S": {
            "name": ("flightModeFlags", "stateFlags", "failsafePhase", "rxSignalReceived", "rxFlightChannelsValid"),
            "signed": [0] * 5,
            "predictor": [0] * 5,
            "encoding": [1, 1, 7, 7, 7],
        },
    }.items():
        lines |= {f"Field {letter} {key}": ",".join(map(str, values)) for key, values in rows.items()}
    return "".join(f"H {key}:{value}\n" for key, value in (lines | settings).items()).encode()


def _intra(row: list[int]) -> bytes:
    """Return an I frame, which depends on no other."""
    predicted = {9: VBAT_REFERENCE, 11: MOTOR_LOW, 5: row[NAMES.index("motor[0]")], 0: 0}
    frame = bytearray()
    for value, predictor, encoding in zip(row, I_PREDICTOR, I_ENCODING, strict=True):
        error = value - predicted[predictor]
        frame += _unsigned(-error & 0x3FFF) if encoding == 3 else _unsigned(error) if encoding == 1 else _signed(error)
    return bytes(frame)


def _inter(row: list[int], last: list[int], before: list[int]) -> bytes:
    """Return a P frame: differences from predictions by the two rows before."""
    predicted = {
        1: lambda i: last[i],
        2: lambda i: 2 * last[i] - before[i],
        6: lambda i: row[i],
        3: lambda i: int((last[i] + before[i]) / 2),
    }
    errors = [row[i] - predicted[predictor](i) for i, predictor in enumerate(P_PREDICTOR)]
    frame = _signed(errors[1]) + _three(errors[2:5]) + _four(errors[5:9]) + _four(errors[9:13]) + _group(errors[13:16])
    return frame + b"".join(map(_signed, errors[16:]))


def _unsigned(value: int) -> bytes:
    """Return a variable-length number of 32 bits, seven bits a byte."""
    value, found = value & 0xFFFFFFFF, bytearray()
    while value > 0x7F:
        found.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*found, value])


def _signed(value: int) -> bytes:
    """Return a variable-length signed number, zigzag-coded."""
    value = (value + (1 << 31)) % (1 << 32) - (1 << 31)  # differences wrap around with the 32-bit clock
    return _unsigned(value << 1 ^ value >> 31)


def _three(values: list[int]) -> bytes:
    """Return three numbers in 2, 4 or 6 bits each, or in as many bytes as each needs."""
    if all(-2 <= value < 2 for value in values):
        return bytes([sum((value & 3) << shift for value, shift in zip(values, (4, 2, 0), strict=True))])
    if all(-8 <= value < 8 for value in values):
        return bytes([0x40 | values[0] & 15, (values[1] & 15) << 4 | values[2] & 15])
    if all(-32 <= value < 32 for value in values):
        return bytes([0x80 | values[0] & 63, values[1] & 63, values[2] & 63])
    sizes = [next(n for n in (1, 2, 3, 4) if -(1 << 8 * n - 1) <= value < 1 << 8 * n - 1) for value in values]
    lead = 0xC0 | sum((size - 1) << 2 * i for i, size in enumerate(sizes))
    return bytes([lead]) + b"".join(
        (v & (1 << 8 * n) - 1).to_bytes(n, "little") for v, n in zip(values, sizes, strict=True)
    )


def _four(values: list[int]) -> bytes:
    """Return four numbers in 0, 4, 8 or 16 bits each, packed across bytes."""
    sizes = [0 if not v else 4 if -8 <= v < 8 else 8 if -128 <= v < 128 else 16 for v in values]
    selector = sum((0, 4, 8, 16).index(size) << 2 * i for i, size in enumerate(sizes))
    bits = "".join(
        format(value & (1 << size) - 1, f"0{size}b") for value, size in zip(values, sizes, strict=True) if size
    )
    bits += "0" * (-len(bits) % 8)
    return bytes([selector, *(int(bits[i : i + 8], 2) for i in range(0, len(bits), 8))])


def _group(values: list[int]) -> bytes:
    """Return up to eight numbers, zeros as a flag alone."""
    flags = sum(1 << i for i, value in enumerate(values) if value)
    return bytes([flags]) + b"".join(_signed(value) for value in values if value)

"""A plain writer of blackbox logs, slow and apart from the reader: each encoding, frames, a whole log."""

from quasi.importing.readers.blackbox import decode
from quasi.importing.readers.blackbox_header import find_logs


def uvb(value):
    value &= 0xFFFFFFFF
    out = bytearray()
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    return bytes([*out, value])


def svb(value):
    return uvb((value << 1) ^ (value >> 31))


def neg14(value):
    return uvb(-value & 0x3FFF)


def tag8_8svb(values):
    if len(values) == 1:
        return svb(values[0])
    tag = sum(1 << i for i, v in enumerate(values) if v)
    return bytes([tag]) + b"".join(svb(v) for v in values if v)


def bits(values, widths):
    """Fields of given widths, highest bit first, filled up to whole bytes."""
    text = "".join(format(v & ((1 << w) - 1), f"0{w}b") for v, w in zip(values, widths) if w)
    text += "0" * (-len(text) % 8)
    return bytes(int(text[i : i + 8], 2) for i in range(0, len(text), 8))


def widest(values, widths):
    return next(w for w in widths if all(-(1 << (w - 1)) <= v < 1 << (w - 1) for v in values))


def wide_three(values):
    sizes = [widest([v], (8, 16, 24, 32)) // 8 for v in values]
    lead = 0xC0 | sum((size - 1) << (2 * i) for i, size in enumerate(sizes))
    return bytes([lead]) + b"".join((v & (1 << 8 * s) - 1).to_bytes(s, "little") for v, s in zip(values, sizes))


def tag2_3s32(values):
    width = widest(values, (2, 4, 6, 32))
    if width == 32:
        return wide_three(values)
    # the lead byte holds its two size bits, then padding up to where the fields end on whole bytes
    size = {2: 0, 4: 1, 6: 2}[width]
    if width == 6:
        return bytes([size << 6 | values[0] & 63, values[1] & 63, values[2] & 63])
    return bits([size, 0, *values], [2, 0 if width == 2 else 2, width, width, width])


def tag2_3svariable(values):
    a, b, c = values
    fits = lambda v, w: -(1 << (w - 1)) <= v < 1 << (w - 1)  # noqa: E731
    for size, widths in ((0, (2, 2, 2)), (1, (5, 5, 4)), (2, (8, 7, 7))):
        if all(map(fits, (a, b, c), widths)):
            return bits([size, *values], [2, *widths])
    return wide_three(values)


def tag8_4s16(values):
    widths = [0 if v == 0 else widest([v], (4, 8, 16)) for v in values]
    tag = sum({0: 0, 4: 1, 8: 2, 16: 3}[w] << (2 * i) for i, w in enumerate(widths))
    return bytes([tag]) + bits(values, widths)


def log_bytes(fields, frames, header="", intra=None, inter=None, start="0"):
    """A log: fields [(name, signed)], intra and inter (encodings, predictors) behind loopIteration and time."""
    names = ["loopIteration", "time", *(name for name, _ in fields)]
    n = len(fields)
    intra = intra or ([0] * n, [0] * n)
    inter = inter or ([0] * n, [1] * n)
    join = lambda values: ",".join(map(str, values))  # noqa: E731
    lines = [
        "Product:Blackbox flight data recorder by Nicholas Sherlock",
        "Data version:2",
        "Field I name:" + join(names),
        "Field I signed:" + join([0, 0, *(int(s) for _, s in fields)]),
        "Field I encoding:" + join([1, 1, *intra[0]]),
        "Field I predictor:" + join([0, 0, *intra[1]]),
        "Field P encoding:" + join([9, 0, *inter[0]]),
        "Field P predictor:" + join([6, 2, *inter[1]]),
        "Field S name:flightModeFlags,stateFlags,failsafePhase,rxSignalReceived,rxFlightChannelsValid",
        "Field S signed:0,0,0,0,0",
        "Field S encoding:1,1,7,7,7",
        "Field S predictor:0,0,0,0,0",
        "Firmware type:Cleanflight",
        "Firmware revision:Betaflight 4.5.1 (77d01ba3b) STM32F7X2",
        "I interval:32",
        "P interval:1",
        *[line for line in header.splitlines() if line],
    ]
    return "".join(f"H {line}\n" for line in lines).encode() + frames


def intra_frame(iteration, time, payload=b""):
    return b"I" + uvb(iteration) + uvb(time) + payload


def inter_frame(step, payload=b""):
    return b"P" + svb(step) + payload


END = b"E\xffEnd of log\x00"


def frames_of(data, fields=None):
    (log,) = find_logs(data, "made.bbl")
    assert log.fault == ""
    return decode(data, log, fields)


def damaged_log():
    """40 intra intervals of 32 frames at 1 kHz, one field that counts them: the bytes and the offset of each frame."""
    pieces, offsets = [], []
    at = len(log_bytes([("n", False)], b"", intra=([1], [0]), inter=([0], [1])))
    for i in range(40 * 32):
        piece = intra_frame(i, 1000 * i, uvb(i)) if i % 32 == 0 else inter_frame(1000 if i % 32 == 1 else 0, svb(1))
        pieces.append(piece)
        offsets.append(at)
        at += len(piece)
    return log_bytes([("n", False)], b"".join(pieces) + END, intra=([1], [0]), inter=([0], [1])), offsets

"""Blackbox data version 2: the bytes of one log become frames (compiled).

A log is a run of frames, each a letter and its fields: I (intra, complete), P (inter, differences to the frames
before), S (slow), G and H (GPS and its home), E (event). A frame has no length and no checksum: it counts as good when
all its fields fit and the letter of another frame, or the end, follows. After damage, P frames are worthless until the
next I frame.

Source: Betaflight documentation, "Blackbox logging internals" (betaflight.com/docs/development/blackbox-internals).
"""

import numpy as np
from numba import njit

FRAME_KINDS = "IPSGHE"
ENCODING, PREDICTOR, ARGUMENT, SIGNED, GROUP = range(5)
# constants that predictors refer to
MIN_THROTTLE, BATTERY_REFERENCE, MAIN_TIME, MIN_MOTOR = range(4)
DROPPED_P, REJECTED, UNKNOWN_EVENTS, ENDED, MAIN, SLOW, SPANS, EVENTS = range(6, 14)
TALLY = 14

_MASK = 0xFFFFFFFF
_LONGEST_FRAME = 1024  # bytes of one frame; the longest that firmware writes are about 300
_JUMP = 10_000_000  # us; a longer step between frames needs a resume event or a second witness
_MOST_STEPS = 320_000  # iterations in that time at 32 kHz
_EVENT_BYTES = 32  # bytes after an unknown event in which the next frame must begin
_KIND_OF = np.full(256, -1, np.int64)
_KIND_OF[[ord(letter) for letter in FRAME_KINDS]] = np.arange(len(FRAME_KINDS))
_END_TEXT = np.frombuffer(b"End of log", np.uint8)


@njit(cache=True)
def _signed(value, bits):
    half = 1 << (bits - 1)
    return ((value & ((1 << bits) - 1)) ^ half) - half


@njit(cache=True)
def _unsigned_vb(data, at, end):
    """Seven bits a byte, lowest first; the top bit says that more follow. Returns (value, next position or -1)."""
    value = 0
    for i in range(5):
        if at + i >= end:
            return 0, -1
        byte = np.int64(data[at + i])
        value |= (byte & 127) << (7 * i)
        if byte < 128:
            return value & _MASK, at + i + 1
    return 0, -1


@njit(cache=True)
def _signed_vb(data, at, end):
    value, at = _unsigned_vb(data, at, end)
    return (value >> 1) ^ -(value & 1), at


@njit(cache=True)
def _three(data, at, end, code, raw, i, n):
    """TAG2_3S32 (code 7) or TAG2_3SVARIABLE (code 10): three fields behind a size in two bits."""
    if at >= end:
        return -1
    lead = np.int64(data[at])
    at += 1
    size = lead >> 6
    a = b = c = 0
    if size == 0:
        a, b, c = _signed(lead >> 4, 2), _signed(lead >> 2, 2), _signed(lead, 2)
    elif size == 1:
        if at >= end:
            return -1
        one = np.int64(data[at])
        at += 1
        if code == 7:
            a, b, c = _signed(lead, 4), _signed(one >> 4, 4), _signed(one, 4)
        else:
            a, b, c = _signed(lead >> 1, 5), _signed((lead << 4) | (one >> 4), 5), _signed(one, 4)
    elif size == 2:
        if at + 1 >= end:
            return -1
        one, two = np.int64(data[at]), np.int64(data[at + 1])
        at += 2
        if code == 7:
            a, b, c = _signed(lead, 6), _signed(one, 6), _signed(two, 6)
        else:
            a, b, c = _signed((lead << 2) | (one >> 6), 8), _signed((one << 1) | (two >> 7), 7), _signed(two, 7)
    else:
        for k in range(3):
            width = ((lead >> (2 * k)) & 3) + 1
            if at + width > end:
                return -1
            value = 0
            for j in range(width):
                value |= np.int64(data[at + j]) << (8 * j)
            at += width
            value = _signed(value, 8 * width)
            if k == 0:
                a = value
            elif k == 1:
                b = value
            else:
                c = value
    raw[i] = a
    if i + 1 < n:
        raw[i + 1] = b
    if i + 2 < n:
        raw[i + 2] = c
    return at


@njit(cache=True)
def _four(data, at, end, raw, i, n):
    """TAG8_4S16: four fields of 0, 4, 8 or 16 bits each, packed by half bytes, high part first."""
    if at >= end:
        return -1
    tag = np.int64(data[at])
    at += 1
    half, held = False, 0
    for k in range(4):
        size = (tag >> (2 * k)) & 3
        value = 0
        nibbles = (0, 1, 2, 4)[size]
        for _ in range(nibbles):
            if half:
                value = (value << 4) | (held & 15)
            else:
                if at >= end:
                    return -1
                held = np.int64(data[at])
                at += 1
                value = (value << 4) | (held >> 4)
            half = not half
        if nibbles:
            value = _signed(value, 4 * nibbles)
        if i + k < n:
            raw[i + k] = value
    return at


@njit(cache=True)
def read_fields(data, at, end, layout, kind, n, raw):
    """Encoded values of one frame of `kind`, before prediction, into raw (n,); the position after it, or -1."""
    i = np.int64(0)  # as a literal it would be a type of its own, for which the functions are compiled again
    while i < n:
        code = layout[kind, ENCODING, i]
        group = layout[kind, GROUP, i]
        if code == 0:
            raw[i], at = _signed_vb(data, at, end)
        elif code == 1:
            raw[i], at = _unsigned_vb(data, at, end)
        elif code == 3:
            value, at = _unsigned_vb(data, at, end)
            raw[i] = -_signed(value, 14)
        elif code == 6:
            if group == 1:
                raw[i], at = _signed_vb(data, at, end)
            else:
                if at >= end:
                    return -1
                tag = np.int64(data[at])
                at += 1
                if tag >> group:
                    return -1
                for k in range(group):
                    raw[i + k] = 0
                    if tag >> k & 1:
                        raw[i + k], at = _signed_vb(data, at, end)
                        if at < 0:
                            return -1
        elif code == 7 or code == 10:
            at = _three(data, at, end, code, raw, i, i + group)
        elif code == 8:
            at = _four(data, at, end, raw, i, i + group)
        else:
            raw[i] = 0
        if at < 0:
            return -1
        i += group
    return at


@njit(cache=True)
def add_predictions(layout, kind, n, raw, history, before, before2, now, constants, skipped):
    """history[now] = raw + prediction from rows `before` and `before2`, 32-bit, signed as the header says."""
    for i in range(n):
        how = layout[kind, PREDICTOR, i]
        value = raw[i]
        if how == 1:
            value += history[before, i]
        elif how == 2:
            value += 2 * history[before, i] - history[before2, i]
        elif how == 3:
            both = history[before, i] + history[before2, i]
            value += (both + 1) >> 1 if both < 0 else both >> 1  # half, rounded towards zero
        elif how == 4:
            value += constants[MIN_THROTTLE]
        elif how == 5:
            value += history[now, layout[kind, ARGUMENT, i]]
        elif how == 6:
            value += history[before, i] + 1 + skipped
        elif how == 8:
            value += 1500
        elif how == 9:
            value += constants[BATTERY_REFERENCE]
        elif how == 10:
            value += constants[MAIN_TIME]
        elif how == 11:
            value += constants[MIN_MOTOR]
        value &= _MASK
        if layout[kind, SIGNED, i] and value > 0x7FFFFFFF:
            value -= 0x100000000
        history[now, i] = value


@njit(cache=True)
def _read_event(data, at, end):
    """(position after the event or -1, code, a, b, known); `at` is behind the letter."""
    if at >= end:
        return -1, 0, 0, 0, False
    code = np.int64(data[at])
    at += 1
    a = b = 0
    if code == 0 or code == 15 or code == 40:  # beep, disarm, IMU failure
        a, at = _unsigned_vb(data, at, end)
    elif code == 14 or code == 30:  # logging resumed (iteration, time), flight mode (new, old)
        a, at = _unsigned_vb(data, at, end)
        if at >= 0:
            b, at = _unsigned_vb(data, at, end)
    elif code == 13:  # adjustment in flight
        if at >= end:
            return -1, code, 0, 0, True
        a = np.int64(data[at])
        at += 1
        if a & 128:
            at = at + 4 if at + 4 <= end else -1
        else:
            b, at = _signed_vb(data, at, end)
    elif code == 255:
        for k in range(_END_TEXT.size):
            if at + k >= end or data[at + k] != _END_TEXT[k]:
                return -1, code, 0, 0, True
        at += _END_TEXT.size
    else:
        return at, code, 0, 0, False
    return at, code, a, b, True


@njit(cache=True)
def decode_frames(
    data, start, end, layout, sizes, clock, constants, skips, keep, main, time, slow, slow_time, spans, events
):
    """Decode the frames data[start:end] of one log.

    data      (bytes,) uint8
    layout    (5, 5, fields) int64: of each kind I P S G H the encoding, predictor, argument, sign, group of each field
    sizes     (5,) number of fields per kind; 0 = the log defines no such frame
    clock     (2,) index of the fields time and loopIteration (-1 = not logged)
    constants (4,) what predictors refer to; changed while reading
    skips     (I interval,) iterations left out after the iteration of that place in the interval
    keep      (k,) main fields to store
    Filled: main (k, frames) float64 and time (frames,) us, 64 bit; slow (changes, fields) with slow_time; spans
    (m, 4): first byte, byte behind, time before, time after (-1 = none); events (m, 4): code, time, a, b. Frames of
    GPS are counted alone, no quantity comes from them.
    Returns   (TALLY,) counts of good frames per kind and of the rest, in the order of the names above.
    """
    tally = np.zeros(TALLY, np.int64)
    width = layout.shape[2]
    raw = np.zeros(width, np.int64)
    history = np.zeros((3, width), np.int64)
    other = np.zeros((2, width), np.int64)
    zero, one = np.int64(0), np.int64(1)  # see `read_fields`
    before, before2, now = zero, zero, one
    clock_time, clock_iteration = clock[0], clock[1]
    valid = False
    last, witness, witness_iteration, resumed = -1, -1, 0, -1
    iteration, anchor, interval = 0, 0, skips.size
    lost, lost_time, patience = -1, -1, 0
    n, at = 0, start
    while at < end:
        kind = _KIND_OF[data[at]]
        code, a, b, known = 0, 0, 0, True
        after = -1
        if 0 <= kind < 5:
            if sizes[kind] > 0:
                after = read_fields(data, at + 1, min(end, at + _LONGEST_FRAME), layout, kind, sizes[kind], raw)
        elif kind == 5:
            after, code, a, b, known = _read_event(data, at + 1, end)
            if not known and lost >= 0:
                after = -1  # amid damage an unknown event is more likely no event at all
        if after >= 0 and after < end and known and code != 255 and _KIND_OF[data[after]] < 0:
            after = -1
        if after < 0:
            if patience > 0:
                patience -= 1
            else:
                witness = -1
                if lost < 0:
                    lost, lost_time = at, last
                    valid = False
            at += 1
            continue
        patience = 0
        if kind <= 1:
            good = True
            if kind == 1 and not valid:
                good = False
                tally[DROPPED_P] += 1
            else:
                skipped = skips[iteration % interval] if kind == 1 else zero
                add_predictions(layout, kind, sizes[kind], raw, history, before, before2, now, constants, skipped)
                stamp = history[now, clock_time] & _MASK
                count = history[now, clock_iteration] if clock_iteration >= 0 else 0
                step = _signed(stamp - (last & _MASK), 32)
                if kind == 1:
                    good = 0 <= step < _JUMP
                elif last < 0:
                    step = stamp - last
                else:
                    # amid damage, bytes that only look like a frame are found out by an iteration off the interval
                    fits = lost < 0 or (count - anchor) % interval == 0
                    good = fits and 0 <= step < _JUMP and 0 <= count - iteration < _MOST_STEPS
                    if not good and fits and resumed >= 0 and 0 <= _signed(stamp - resumed, 32) < _JUMP:
                        step = (stamp - last) & _MASK
                        good = True
                    if not good and witness >= 0:
                        # the second I frame of an undamaged run confirms the first
                        good = 0 <= _signed(stamp - witness, 32) < _JUMP
                        good = good and (clock_iteration < 0 or count == witness_iteration + interval)
                        if good and tally[0] == 1:
                            # two I frames against the only one before: that one was wrong
                            tally[REJECTED] += n
                            n, lost_time, step = 0, -1, stamp - last
                            tally[0], tally[1] = 0, 0
                        good = good and (step >= 0 or n == 0)
                    if not good:
                        witness, witness_iteration = stamp, count
                if not good:
                    tally[REJECTED] += 1
            if good:
                last += step
                iteration, witness, resumed, valid = count, -1, -1, True
                if kind == 0:
                    anchor = count
                constants[MAIN_TIME] = last & _MASK
                if lost >= 0:
                    m = min(tally[SPANS], spans.shape[0] - 1)
                    if m == tally[SPANS]:
                        tally[SPANS] += 1
                        spans[m, 0], spans[m, 2] = lost, lost_time
                    spans[m, 1], spans[m, 3] = at, last
                    lost = -1
                for k in range(keep.size):
                    main[k, n] = history[now, keep[k]]
                time[n] = last
                n += 1
                tally[kind] += 1
                before2 = now if kind == 0 else before
                before = now
                for free in range(3):
                    if free != before and free != before2:
                        now = free
            else:
                valid = False
                if lost < 0:
                    lost, lost_time = at, last
        elif kind == 2:
            add_predictions(layout, kind, sizes[2], raw, other, zero, zero, one, constants, zero)
            tally[2] += 1
            m = tally[SLOW]
            new = m == 0
            for i in range(sizes[2]):
                if m > 0 and slow[m - 1, i] != other[1, i]:
                    new = True
            if new and m < slow.shape[0]:
                for i in range(sizes[2]):
                    slow[m, i] = other[1, i]
                slow_time[m] = last
                tally[SLOW] += 1
        elif kind <= 4:
            tally[kind] += 1
        else:
            tally[5] += 1
            m = tally[EVENTS]
            if m < events.shape[0]:
                events[m, 0], events[m, 1], events[m, 2], events[m, 3] = code, last, a, b
                tally[EVENTS] += 1
            if code == 14:
                resumed = b
            elif code == 255:
                tally[ENDED] = 1
                at = after
                break
            elif not known:
                tally[UNKNOWN_EVENTS] += 1
                patience = _EVENT_BYTES
        at = after
    if lost >= 0:
        m = min(tally[SPANS], spans.shape[0] - 1)
        if m == tally[SPANS]:
            tally[SPANS] += 1
            spans[m, 0], spans[m, 2] = lost, lost_time
        spans[m, 1], spans[m, 3] = at, -1
    tally[MAIN] = n
    return tally

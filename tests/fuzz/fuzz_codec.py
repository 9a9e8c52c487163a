"""The compiled codec on any layout and payload: one frame and a batch agree, and what is sent can be read."""

from __future__ import annotations

import math
from collections import Counter
from typing import Literal

import numpy as np

from candaemon.dbc.batch_codec import BatchDecoder, BatchEncoder
from candaemon.dbc.bits import sendable_raw
from candaemon.dbc.single_codec import compile_decoder, compile_encoder
from candaemon.dbc.types import MessageSpec, SignalSpec
from candaemon.errors import ConfigError

from .drawn import Drawn

_SCALES = (1.0, 0.1, -0.5, 1e-7, 2.0, 1e4, 0.0, -1e-300)
_OFFSETS = (0.0, -40.0, 0.05, 1e9)


def fuzz_codec(data: bytes) -> Counter[str]:
    """Decode payloads with a layout, encode values, and read them back."""
    drawn = Drawn(data)
    spec = _message(drawn)
    one, batch = compile_decoder(spec), BatchDecoder(spec)
    payloads = [drawn.taken(spec.length).ljust(spec.length, b"\xa5") for _ in range(drawn.integer(1, 20))]
    table = batch.decode(b"".join(payloads))
    for column, payload in zip(table.T, payloads, strict=True):
        values = one(payload)
        alone = np.full(len(spec.signals), np.nan) if values is None else np.array([float(value) for value in values])
        # integers of more bits than a float's may be rounded before or after scaling
        assert np.allclose(column, alone, rtol=1e-14, atol=0, equal_nan=True), (spec, payload.hex(), column, alone)
    assert one(payloads[0][:-1]) is None, "a frame too short was decoded"
    return Counter(payloads=len(payloads), encoded=_encoded(spec, drawn))


def _encoded(spec: MessageSpec, drawn: Drawn) -> bool:
    """Encode any numbers; what arrives is within what the signal can say. Return whether the layout can be sent."""
    try:
        one, batch = compile_encoder(spec), BatchEncoder(spec)
    except ConfigError:
        return False
    values = [drawn.number() for _ in spec.signals]
    payload, saturated = one(values)
    table, together = batch.encode(np.array(values)[:, None])
    assert (table.tobytes(), together) == (payload, saturated), (spec, values)
    assert len(payload) == spec.length
    read = compile_decoder(spec)(payload)
    if read is None:
        return True  # its multiplexer has a value that selects nothing
    for signal, value in zip(spec.signals, read, strict=True):
        if signal.is_float or signal.multiplexer_signal is not None or _overlaps(spec, signal):
            continue
        ends = sorted(limit * signal.scale + signal.offset for limit in sendable_raw(signal))
        slack = 1e-9 * max(map(abs, ends))
        assert ends[0] - slack <= value <= ends[1] + slack, (signal, value, ends)
        assert math.isfinite(value) or not all(map(math.isfinite, ends)), (signal, value)
    return True


def _overlaps(spec: MessageSpec, signal: SignalSpec) -> bool:
    return any(_bits(signal) & _bits(other) for other in spec.signals if other is not signal)


def _bits(signal: SignalSpec) -> set[int]:
    if signal.byte_order == "little":
        return set(range(signal.start, signal.start + signal.length))
    first = signal.start ^ 7
    return {bit ^ 7 for bit in range(first, first + signal.length)}


def _message(drawn: Drawn) -> MessageSpec:
    length = drawn.choice((8, 1, 2, 3, 7, 12, 16, 64))
    signals = [_signal(drawn, f"s{k}", 8 * length) for k in range(drawn.integer(1, 6))]
    return MessageSpec("M", 0x123, length, tuple(signals))


def _signal(drawn: Drawn, name: str, bits: int) -> SignalSpec:
    """Draw a signal; the first of a message may select others."""
    order: Literal["little", "big"] = "big" if drawn.flag() else "little"
    is_float = drawn.integer(0, 7) == 7
    length = drawn.choice((16, 32, 64)) if is_float else drawn.integer(1, min(bits, 70))
    bounds = [drawn.number(), drawn.number()] if drawn.flag() else [None, None]
    kind = drawn.integer(0, 5)
    first = name == "s0"
    return SignalSpec(
        name,
        drawn.integer(0, bits - 1),
        length,
        order,
        signed=drawn.flag(),
        is_float=is_float,
        scale=drawn.choice(_SCALES),
        offset=drawn.choice(_OFFSETS),
        minimum=bounds[0],
        maximum=bounds[1],
        initial=drawn.integer(0, 255) if drawn.flag() else None,
        is_multiplexer=first and kind >= 4 and not is_float,
        multiplexer_signal="s0" if not first and kind == 5 else None,
        multiplexer_ids=frozenset({drawn.integer(0, 3), 7}) if not first and kind == 5 else frozenset(),
    )

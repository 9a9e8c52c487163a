"""What the compiled codec does where cantools gives no answer: saturation, NaN, overlaps, odd signals, batch sizes."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from candaemon.dbc import bits
from candaemon.dbc.batch_codec import BatchDecoder, BatchEncoder
from candaemon.dbc.bits import same_layout
from candaemon.dbc.database import load_database
from candaemon.dbc.single_codec import compile_decoder, compile_encoder
from candaemon.dbc.types import MessageSpec, SignalSpec
from candaemon.errors import ConfigError


def message(*signals: SignalSpec, length: int = 8) -> MessageSpec:
    return MessageSpec("M", 0x123, length, signals)


DISTANCE = SignalSpec("distance", 0, 12, scale=0.1, minimum=0, maximum=300.0)
RATE = SignalSpec("rate", 19, 10, "big", signed=True, scale=0.25)


@pytest.mark.parametrize(
    ("value", "sent", "count"),
    [
        *[(12.34, 12.3, 0), (300.0, 300.0, 0), (300.04, 300.0, 0), (300.1, 300.0, 1), (-0.04, 0, 0), (-5, 0, 1)],
        *[(math.inf, 300.0, 1), (-math.inf, 0, 1), (math.nan, 0, 1), (1.7e308, 300.0, 1)],
    ],
)
def test_saturation_at_the_dbc_range(value: float, sent: float, count: int) -> None:
    spec = message(DISTANCE, RATE)
    payload, saturated = compile_encoder(spec)([value, -1.0])
    assert compile_decoder(spec)(payload) == pytest.approx((sent, -1.0))
    assert saturated == count
    table, batch = BatchEncoder(spec).encode(np.array([[value], [-1.0]]))
    assert (table.tobytes(), batch) == (payload, count)


def test_saturation_at_the_bits_and_nan_at_the_start_value() -> None:
    spec = message(replace(DISTANCE, minimum=-1000.0, maximum=1000.0, initial=40), RATE)
    table, saturated = BatchEncoder(spec).encode(np.array([[math.nan, 999.0, 5.0], [500.0, -500.0, math.nan]]))
    assert saturated == 5
    assert BatchDecoder(spec).decode(table) == pytest.approx(np.array([[4.0, 409.5, 5.0], [127.75, -128.0, 0.0]]))


def test_a_range_its_bits_cannot_reach_is_left_out() -> None:
    assert bits.sendable_raw(replace(DISTANCE, minimum=-9.0, maximum=-2.0)) == (0, 4095)


def test_signals_not_given_are_zero_and_order_is_the_callers() -> None:
    spec = message(DISTANCE, RATE)
    payload, _ = compile_encoder(spec, ["rate"])([-0.25])
    assert compile_decoder(spec, ["rate", "distance"])(payload) == (-0.25, 0.0)
    assert BatchDecoder(spec, ["rate", "distance"]).decode(payload).tolist() == [[-0.25], [0.0]]


def test_no_sign_of_zero_is_lost_beside_a_signal_with_an_offset() -> None:
    """An angle of minus zero is half a turn from one of zero, where x is negative."""
    spec = message(replace(DISTANCE, scale=-0.1), replace(RATE, offset=5.0))
    assert [math.copysign(1.0, value) for value in compile_decoder(spec)(bytes(8)) or ()] == [-1.0, 1.0]
    assert np.copysign(1.0, BatchDecoder(spec).decode(bytes(8))).tolist() == [[-1.0], [1.0]]


def test_overlapping_signals_read_their_common_bits_twice() -> None:
    spec = message(SignalSpec("word", 0, 16), SignalSpec("high", 8, 8), length=2)
    assert compile_decoder(spec)(b"\x34\x12") == (0x1234, 0x12)
    assert BatchDecoder(spec).decode(b"\x34\x12").tolist() == [[0x1234], [0x12]]


def test_a_signal_outside_its_message_is_nan_and_cannot_be_sent() -> None:
    spec = message(SignalSpec("inside", 0, 8), SignalSpec("outside", 12, 8), length=2)
    assert repr(compile_decoder(spec)(b"\x05\xff")) == "(5, nan)"
    assert np.array_equal(BatchDecoder(spec).decode(b"\x05\xff"), [[5.0], [math.nan]], equal_nan=True)
    with pytest.raises(
        ConfigError, match="'outside' of message 'M' cannot be encoded: its bits lie outside the 2 bytes"
    ):
        compile_encoder(spec)


def test_what_cannot_be_encoded_says_why() -> None:
    child = SignalSpec("child", 8, 8, multiplexer_signal="mode", multiplexer_ids=frozenset({1}))
    mode = SignalSpec("mode", 0, 8, is_multiplexer=True)
    for spec, names, why in [
        (message(mode, child), ["child"], "selected by 'mode', which must be given too"),
        (message(replace(mode, is_multiplexer=False), child), None, "its multiplexer 'mode' is not one"),
        (message(replace(mode, scale=0)), None, "its scale is 0"),
        (message(mode), ["mod"], "did you mean 'mode'"),
    ]:
        makers: list[Callable[[MessageSpec, list[str] | None], object]] = [compile_encoder, BatchEncoder]
        for make in makers:
            with pytest.raises(ConfigError, match=why):
                make(spec, names)


def test_batches_of_any_size() -> None:
    spec = message(DISTANCE, RATE)
    decoder, encoder, one = BatchDecoder(spec), BatchEncoder(spec), compile_decoder(spec)
    for frames in (*range(70), 300, 64, 0):
        data = random.Random(frames).randbytes(8 * frames)  # noqa: S311 - test data
        values = decoder.decode(data)
        assert values.shape == (2, frames)
        assert decoder.known(data).tolist() == [True] * frames
        assert list(map(tuple, values.T)) == [one(data[at : at + 8]) for at in range(0, 8 * frames, 8)]
        assert np.array_equal(decoder.decode(encoder.encode(np.clip(values, -128, 300))[0]), np.clip(values, -128, 300))


def test_families_of_real_radars_share_a_layout(vendor_dbc: Path) -> None:
    radar = load_database(vendor_dbc / "toyota_adas.dbc")
    names = ["LONG_DIST", "LAT_DIST", "REL_SPEED", "VALID", "NEW_TRACK"]
    assert all(same_layout(radar.message("TRACK_A_0"), radar.message(f"TRACK_A_{i}"), names) for i in range(16))
    first = radar.message("TRACK_A_0")
    moved = replace(first, signals=tuple(replace(s, start=s.start ^ 8) for s in first.signals))
    assert not same_layout(first, moved, names)
    assert not same_layout(first, radar.message("TRACK_B_0"), names)
    assert not same_layout(radar.message("TRACK_B_0"), radar.message("TRACK_B_9"), ["REL_ACCEL"])


def test_wide_signals_and_wide_multiplexers_take_the_scalar_road() -> None:
    def specs() -> Iterator[MessageSpec]:
        yield message(SignalSpec("serial", 3, 200), SignalSpec("a", 210, 12, "big"), length=32)
        mode = SignalSpec("mode", 0, 32, is_multiplexer=True)
        yield message(mode, SignalSpec("a", 40, 8, multiplexer_signal="mode", multiplexer_ids=frozenset({70000})))

    for spec in specs():
        payload = (70000).to_bytes(4, "little") + bytes(range(spec.length - 4))
        values = compile_decoder(spec)(payload)
        assert values is not None
        assert BatchDecoder(spec).decode(payload)[:, 0].tolist() == [float(value) for value in values]
        assert (
            BatchEncoder(spec).encode(np.array([[70000.0], [3.0]]))[0].tobytes()
            == compile_encoder(spec)([70000.0, 3.0])[0]
        )

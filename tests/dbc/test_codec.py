"""The compiled codec against cantools: to 1e-9 decoding, byte for byte encoding, and no exception on any bytes."""

from __future__ import annotations

import math
import random
from pathlib import Path

import cantools
import numpy as np
import pytest
from cantools.database.can import Message
from cantools.database.errors import DecodeError
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from candaemon.dbc import bits
from candaemon.dbc.batch_codec import BatchDecoder, BatchEncoder
from candaemon.dbc.database import load_database
from candaemon.dbc.single_codec import compile_decoder, compile_encoder
from candaemon.dbc.types import MessageSpec, SignalSpec
from tests.support.effort import examples
from tests.support.paths import DATA, ROOT

FILES = sorted([*(DATA / "dbc").glob("*.dbc"), *(ROOT / "dbc").glob("*.dbc")])
SCALINGS = [(1, 0), (1, -40), (0.1, 0), (0.04, -5.12), (-0.5, 3), (2, 1), (0.001, 1e4), (1e-7, 0), (3.0, 0.5)]


def agrees(ours: float, theirs: float) -> bool:
    if math.isnan(theirs):
        return math.isnan(ours)
    return ours == theirs or math.isclose(ours, theirs, rel_tol=1e-9, abs_tol=1e-9)


def oracle(path: Path) -> list[Message]:
    parsed = cantools.database.load_file(path, strict=False)
    assert isinstance(parsed, cantools.database.Database)
    return parsed.messages


def decoded(message: Message, data: bytes) -> dict[str, float] | None:
    """Give what cantools decodes; None for an unknown multiplexer value."""
    try:
        values = message.decode(data, decode_choices=False)
    except DecodeError as error:
        if "expected multiplexer id" not in str(error):
            raise
        return None
    assert isinstance(values, dict)
    return {name: float(value) for name, value in values.items() if isinstance(value, int | float)}


def decodable(message: Message) -> bool:
    """Tell whether cantools decodes the message at all: it refuses overlaps within one byte order."""
    try:
        message.decode(bytes(message.length), decode_choices=False)
    except DecodeError as error:
        return "multiplexer" in str(error)
    return True


def check_decoding(spec: MessageSpec, message: Message, payloads: list[bytes]) -> None:
    names = [signal.name for signal in spec.signals]
    one, batch = compile_decoder(spec), BatchDecoder(spec)
    joined = b"".join(payloads)
    table = batch.decode(np.frombuffer(joined, np.uint8).reshape(-1, spec.length))
    assert table.shape == (len(names), len(payloads))
    assert np.array_equal(table, batch.decode(joined), equal_nan=True)
    known = batch.known(joined)
    for frame, data in enumerate(payloads):
        expected, values = decoded(message, data), one(data)
        assert (values is not None) == known[frame] == (expected is not None)
        for row, name in enumerate(names):
            right = math.nan if expected is None else expected.get(name, math.nan)
            assert agrees(table[row, frame], right), (spec.signal(name), data.hex())
            assert values is None or agrees(values[row], right), (spec.signal(name), data.hex())


def in_range(chance: random.Random, signal: SignalSpec) -> float:
    """Draw a value whose float is within what may be sent, between two raw steps as often as on one."""
    low, high = bits.sendable_raw(signal)
    if signal.is_float:
        return (
            max(low, min(high, chance.choice([0.0, 1.5, -2.25, 1e3 * chance.random()]))) * signal.scale + signal.offset
        )
    raw = float(chance.randint(math.ceil(low * 0.99), math.floor(high * 0.99)))
    raw += chance.choice([0.0, 0.0, 0.5, chance.random() - 0.5])
    value = raw * signal.scale + signal.offset
    return value if low <= round(bits.to_raw(signal, value)) <= high else math.floor(raw) * signal.scale + signal.offset


def present(spec: MessageSpec, signal: SignalSpec, values: dict[str, float]) -> bool:
    chain = bits.gates(spec, signal)
    return chain is not None and all(int(values[gate.multiplexer]) in gate.ids for gate in chain)


def draw_values(chance: random.Random, spec: MessageSpec) -> dict[str, float]:
    """Draw in-range values of a whole frame, with multiplexers at values the DBC knows."""
    values = {signal.name: in_range(chance, signal) for signal in spec.signals}
    for selector in bits.multiplexers(spec):
        fitting = [each for each in bits.known_ids(spec, selector) if each <= bits.sendable_raw(selector)[1]]
        values[selector.name] = float(chance.choice(sorted(fitting)))
    return values


def check_encoding(spec: MessageSpec, message: Message, chance: random.Random, frames: int) -> None:
    one, batch = compile_encoder(spec), BatchEncoder(spec)
    columns, payloads = [], []
    for _ in range(frames):
        values = draw_values(chance, spec)
        sent = {signal.name: values[signal.name] for signal in spec.signals if present(spec, signal, values)}
        expected = message.encode(sent, strict=False, padding=False)
        column = [sent.get(signal.name, math.nan) for signal in spec.signals]
        assert one(column) == (expected, 0), (spec.signals, sent)
        columns.append(column)
        payloads.append(expected)
    table, saturated = batch.encode(np.array(columns, dtype=np.float64).reshape(frames, len(spec.signals)).T)
    assert [row.tobytes() for row in table] == payloads
    assert saturated == 0


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_every_message_of_every_file(path: Path) -> None:
    chance = random.Random(path.name)  # noqa: S311 - test data
    database = load_database(path)
    checked = 0
    for message in filter(decodable, oracle(path)):
        spec = database.message(message.name)
        check_decoding(spec, message, [chance.randbytes(spec.length) for _ in range(24)])
        check_encoding(spec, message, chance, 8)
        checked += 1
    assert checked >= len(database.messages) - 1


@st.composite
def drawn_message(draw: st.DrawFn) -> str:
    """Draw a DBC of one message: both byte orders, signs, floats, 1 to 64 bytes, plain or extended multiplexing."""
    length = draw(st.sampled_from([1, 2, 3, 5, 6, 7, 8, 8, 8, 12, 20, 32, 64]))
    used: set[int] = set()
    lines, extra = [f"BO_ 291 M: {length} X"], []
    shapes = draw(st.sampled_from(["", "plain", "nested", "nested"]))
    for index in range(draw(st.integers(4 if shapes == "nested" else 1, 10))):
        order, signed, multiplexed = draw(st.sampled_from(["1", "0"])), draw(st.booleans()), draw(st.booleans())
        is_float = draw(st.integers(0, 5)) == 0
        bits = draw(st.sampled_from([16, 32, 64])) if is_float else draw(st.integers(1, 64))
        selects = bool(shapes) and index < (2 if shapes == "nested" else 1)
        if selects:
            is_float, signed, bits = False, False, draw(st.integers(2, 3))
        if bits > 8 * length:
            continue
        first = draw(st.integers(0, 8 * length - bits))
        places = {bit if order == "1" else bit ^ 7 for bit in range(first, first + bits)}
        if places & used:
            continue
        used |= places
        scale, offset = (1, 0) if selects else draw(st.sampled_from(SCALINGS))
        ends = sorted(raw * scale + offset for raw in (0, draw(st.integers(1, 1 << (bits - 1)))))
        limits = "0|0" if selects or draw(st.booleans()) else f"{ends[0]!r}|{ends[1]!r}"
        mark = ""
        names = [line.split()[1] for line in lines[1:] if " M :" in line or "m1M :" in line]
        if selects:
            mark = "M " if not names else "m1M "
            extra += [f"SG_MUL_VAL_ 291 S{index} {names[0]} 1-1;"] if names else []
        elif names and multiplexed:
            low, parent = draw(st.integers(0, 3)), draw(st.sampled_from(names))
            mark = f"m{low} "
            extra.append(f"SG_MUL_VAL_ 291 S{index} {parent} {low}-{low + draw(st.integers(0, 2))};")
        start, sign = (first if order == "1" else first ^ 7), "-" if signed else "+"
        lines.append(f' SG_ S{index} {mark}: {start}|{bits}@{order}{sign} ({scale!r},{offset!r}) [{limits}] "" X')
        if is_float:
            extra.append(f"SIG_VALTYPE_ 291 S{index} : {1 if bits < 64 else 2};")
    return "\n".join([*lines, *extra, ""])


def both(folder: Path, text: str) -> tuple[MessageSpec, Message]:
    path = folder / "drawn.dbc"
    path.write_text(text)
    return load_database(path).message("M"), oracle(path)[0]


@settings(deadline=None, max_examples=examples(250), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(text=drawn_message(), seed=st.integers(0, 1 << 32))
def test_any_layout(tmp_path: Path, text: str, seed: int) -> None:
    spec, message = both(tmp_path, text)
    chance = random.Random(seed)  # noqa: S311 - test data
    check_decoding(spec, message, [chance.randbytes(spec.length) for _ in range(10)])
    check_encoding(spec, message, chance, 6)


@pytest.mark.parametrize("selector", ["+ (1,0)", "- (1,0)", "+ (2,0)", "- (1,2)", "+ (0.5,0)", "- (-1,1)"])
def test_nested_multiplexers_for_every_value(tmp_path: Path, selector: str) -> None:
    text = f"""BO_ 291 M: 2 X
 SG_ OUTER M : 0|3@1{selector} [0|0] "" X
 SG_ INNER m1M : 4|3@1{selector} [0|0] "" X
 SG_ A m0 : 8|8@1+ (1,0) [0|0] "" X
 SG_ B m2 : 8|4@1- (1,0) [0|0] "" X
 SG_ C m3 : 15|8@0+ (1,0) [0|0] "" X
SG_MUL_VAL_ 291 INNER OUTER 1-1;
SG_MUL_VAL_ 291 A OUTER 0-0, 2-3;
SG_MUL_VAL_ 291 B INNER 0-2;
SG_MUL_VAL_ 291 C INNER 3-3;
VAL_ 291 OUTER 4 "nothing more";
"""
    spec, message = both(tmp_path, text)
    assert [len(bits.gates(spec, spec.signal(name)) or ()) for name in ("OUTER", "INNER", "A", "C")] == [0, 1, 1, 2]
    check_decoding(spec, message, [bytes([first, 0xA7]) for first in range(256)])


WILD = st.floats(allow_nan=True, allow_infinity=True) | st.sampled_from([0.0, -0.0, 1e300, -1e300, 1e18, 255.5, 0.5])


@settings(deadline=None, max_examples=examples(150), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(text=drawn_message(), data=st.data())
def test_any_value_is_saturated_alike_and_never_nan(tmp_path: Path, text: str, data: st.DataObject) -> None:
    spec, _ = both(tmp_path, text)
    columns = data.draw(
        st.lists(st.lists(WILD, min_size=len(spec.signals), max_size=len(spec.signals)), min_size=1, max_size=4)
    )
    one, decode = compile_encoder(spec), compile_decoder(spec)
    alone = [one(column) for column in columns]
    table, saturated = BatchEncoder(spec).encode(np.array(columns).reshape(len(columns), len(spec.signals)).T)
    assert [row.tobytes() for row in table] == [payload for payload, _ in alone]
    assert saturated == sum(count for _, count in alone)
    for payload, _ in alone:
        sent = dict(zip((s.name for s in spec.signals), decode(payload) or (), strict=False))
        for signal in spec.signals:
            if signal.name in sent and present(spec, signal, sent):
                low, high = bits.sendable_raw(signal)
                slack = 0.01 + (1e-3 if signal.is_float else 1e-6) * max(abs(low), abs(high))
                assert low - slack <= bits.to_raw(signal, sent[signal.name]) <= high + slack


@settings(deadline=None, max_examples=examples(150), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(text=drawn_message(), data=st.binary(max_size=70))
def test_no_bytes_raise_and_short_ones_are_told(tmp_path: Path, text: str, data: bytes) -> None:
    spec, _ = both(tmp_path, text)
    decode = compile_decoder(spec)
    if len(data) < spec.length:
        assert decode(data) is None
    else:
        assert repr(decode(data)) == repr(decode(data[: spec.length]))


@pytest.mark.parametrize("kind", [1, 2])
def test_a_negative_zero_keeps_its_sign_where_zero_is_the_least(tmp_path: Path, kind: int) -> None:
    length = 32 * kind
    text = f'BO_ 291 M: 8 X\n SG_ A : 0|{length}@1+ (1,0) [0|1] "" X\nSIG_VALTYPE_ 291 A : {kind};\n'
    spec, _ = both(tmp_path, text)
    payload, _ = compile_encoder(spec)([-0.0])
    assert payload[length // 8 - 1] == 0x80
    assert BatchEncoder(spec).encode(np.array([[-0.0]]))[0].tobytes() == payload

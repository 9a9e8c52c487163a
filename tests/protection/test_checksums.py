"""Checksums: known values, one frame against a whole cycle, and damage found."""

from __future__ import annotations

import gzip
from functools import reduce
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from candaemon.dbc.types import MessageSpec, SignalSpec
from candaemon.errors import ConfigError
from candaemon.frames.frame import EXTENDED
from candaemon.protection.checksums import Kind, Protector, crc8_sae_j1850
from tests.support.effort import examples

KINDS: tuple[Kind, ...] = get_args(Kind)


def message(
    position: int, length: int = 8, can_id: int = 0x210, *, kind: Kind = "toyota", high: int = 0
) -> MessageSpec:
    """Make a message whose checksum fills a byte, or of honda's kind its low or high half."""
    checksum = SignalSpec(name="Sum", start=8 * position + 4 * high, length=4 if kind == "honda" else 8)
    return MessageSpec(name="M", can_id=can_id, length=length, signals=(checksum,))


def test_crc8_check_value() -> None:
    assert crc8_sae_j1850(b"123456789") == 0x4B
    assert crc8_sae_j1850(b"") == 0


def test_known_checksums() -> None:
    data = bytes.fromhex("93382608AC0901C9")
    others = data[:7]
    expected: dict[Kind, int] = {
        "toyota": (0x02 + 0x10 + 8 + sum(others)) & 0xFF,
        "additive": sum(others) & 0xFF,
        "xor": reduce(lambda a, b: a ^ b, others),
        "crc8_sae_j1850": crc8_sae_j1850(others),
    }
    assert expected["toyota"] == 0xC9
    for kind, checksum in expected.items():
        assert Protector(kind, [message(7)], "Sum").checksum(0x210, data) == checksum


@pytest.mark.parametrize("counter", range(4))
def test_honda_checksums_are_those_of_its_frames(counter: int) -> None:
    """The sums that openDBC's tests hold for a 0x33D and a 29-bit 0x33DA whose other half bytes add up to 10."""
    for can_id, first in ((0x33D, 11), (0x33DA | EXTENDED, 4)):
        spec = MessageSpec("M", can_id, 5, (SignalSpec(name="Sum", start=35, length=4, byte_order="big"),))
        protector = Protector("honda", [spec], "Sum")
        sealed = protector.seal(can_id, bytes([0x41, 0x50, 0, 0, counter << 4 | 0xF]))
        assert sealed == bytes([0x41, 0x50, 0, 0, counter << 4 | first - counter])
        assert protector.verify(can_id, sealed)


def test_toyota_sums_every_byte_of_an_extended_identifier() -> None:
    can_id = 0x18DA_10F1 | EXTENDED
    protector = Protector("toyota", [message(7, can_id=can_id)], "Sum")
    assert protector.checksum(can_id, bytes(8)) == (0x18 + 0xDA + 0x10 + 0xF1 + 8) & 0xFF


@settings(deadline=None, max_examples=examples(60))
@given(
    kind=st.sampled_from(KINDS),
    length=st.integers(2, 64),
    where=st.floats(0, 0.999),
    seed=st.integers(0, 2**32 - 1),
    extended=st.booleans(),
    high=st.integers(0, 1),
)
def test_a_cycle_is_filled_as_single_frames_are(
    kind: Kind, length: int, where: float, seed: int, extended: bool, high: int
) -> None:
    position = int(where * length)
    rng = np.random.default_rng(seed)
    ids = rng.choice(0x1FFF_FFFF if extended else 0x7FF, 5, replace=False).astype(np.int64) | EXTENDED * extended
    high = high if kind == "honda" else 0
    protector = Protector(kind, [message(position, length, int(i), kind=kind, high=high) for i in ids], "Sum")
    payloads = rng.integers(0, 256, (5, length), dtype=np.uint8)
    protector.fill(ids, payloads)
    for can_id, payload in zip(ids.tolist(), payloads, strict=True):
        data = payload.tobytes()
        assert data[position] >> 4 * high & (15 if kind == "honda" else 255) == protector.checksum(can_id, data)
        assert protector.verify(can_id, data)
        assert protector.seal(can_id, data) == data
        bit = int(rng.integers(8 * length))
        damaged = bytearray(data)
        damaged[bit // 8] ^= 1 << bit % 8
        assert not protector.verify(can_id, bytes(damaged))
        assert not protector.verify(can_id, data[:-1])


def test_messages_may_keep_it_in_different_places() -> None:
    long, short = message(7, 8, 0x220), message(5, 6, 0x228)
    protector = Protector("additive", [long, short], "Sum")
    assert protector.verify(0x220, bytes([1, 2, 3, 4, 5, 6, 7, 28]))
    assert protector.verify(0x228, bytes([1, 2, 3, 4, 5, 15]))
    assert (protector.position(0x220), protector.position(0x228)) == (7, 5)


@pytest.mark.parametrize(("start", "bits"), [(4, 8), (56, 7), (60, 8), (0, 16)])
def test_checksum_must_fill_one_byte(start: int, bits: int) -> None:
    spec = MessageSpec("M", 1, 8, (SignalSpec(name="Sum", start=start, length=bits),))
    with pytest.raises(ConfigError, match="expected 8 bits that fill one byte"):
        Protector("xor", [spec], "Sum")


@pytest.mark.parametrize(("start", "bits"), [(2, 4), (56, 8), (64, 4)])
def test_a_honda_checksum_must_fill_half_a_byte(start: int, bits: int) -> None:
    spec = MessageSpec("M", 1, 8, (SignalSpec(name="Sum", start=start, length=bits),))
    with pytest.raises(ConfigError, match="expected 4 bits that fill half a byte"):
        Protector("honda", [spec], "Sum")


def test_every_radar_frame_of_the_drive_passes(drive: Path) -> None:
    tracks = {0x210 + n: message(7, 8, 0x210 + n) for n in range(0x18)}
    tracks |= {0x228 + n: message(5, 6, 0x228 + n) for n in range(8)}
    protector = Protector("toyota", list(tracks.values()), "Sum")
    seen = 0
    with gzip.open(drive / "drive.log.gz", "rt") as lines:
        for line in lines:
            _, channel, frame = line.split()[:3]
            number, _, data = frame.partition("#")
            if channel == "can1" and int(number, 16) in tracks:
                seen += 1
                assert protector.verify(int(number, 16), bytes.fromhex(data))
    assert seen == 38_400


@pytest.mark.parametrize("kind", KINDS)
@settings(deadline=None, max_examples=examples(200))
@given(data=st.data())
def test_many_frames_are_verified_as_one_by_one(kind: Kind, data: st.DataObject) -> None:
    specs = [
        message(3, can_id=0x210, kind=kind, high=int(kind == "honda")),
        message(5, 6, 0x18FF0011 | EXTENDED, kind=kind),
        message(11, 12, 0x211, kind=kind),
    ]
    protector = Protector(kind, specs, "Sum")
    width = data.draw(st.sampled_from((8, 64)))
    frame = st.tuples(st.sampled_from(specs), st.binary(max_size=width), st.booleans())
    frames = data.draw(st.lists(frame, max_size=9))
    payloads = [
        protector.seal(spec.can_id, payload) if sealed and len(payload) >= spec.length else payload
        for spec, payload, sealed in frames
    ]
    can_ids = np.array([spec.can_id for spec, _, _ in frames], np.int64)
    lengths = np.array([len(payload) for payload in payloads], np.int64)
    padded = b"".join(payload.ljust(width, b"\0") for payload in payloads)
    found = protector.verified(can_ids, lengths, np.frombuffer(padded, np.uint8).reshape(-1, width))
    assert found.tolist() == [
        protector.verify(spec.can_id, p) for (spec, _, _), p in zip(frames, payloads, strict=True)
    ]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("padding", [b"", b"\x00\x00", b"\xcc\xcc", b"\xff\xff"])
def test_what_a_controller_fills_a_frame_up_with_is_no_part_of_it(kind: Kind, padding: bytes) -> None:
    """No CAN FD frame has 10 bytes: one of 12 comes."""
    checked = Protector(kind, [message(9, length=10, kind=kind)], "Sum")
    frame = checked.seal(0x210, bytes(range(3, 13))) + padding
    assert checked.verify(0x210, frame)
    table = np.zeros((2, 16), np.uint8)
    table[0, : len(frame)] = table[1, : len(frame)] = np.frombuffer(frame, np.uint8)
    table[1, 4] ^= 0x10
    ids, lengths = np.full(2, 0x210), np.full(2, len(frame))
    assert checked.verified(ids, lengths, table).tolist() == [True, False]

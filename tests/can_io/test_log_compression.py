"""Compressed logs: what was packed comes out, as far as it goes, in bounded memory."""

from __future__ import annotations

import gzip
import lzma
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from candaemon.can_io.logs import compression
from candaemon.can_io.logs.compression import COMPRESSIONS, LARGEST_WINDOW
from candaemon.can_io.logs.read import read_log
from candaemon.can_io.logs.stream import LogCounts
from candaemon.can_io.logs.write import open_log_writer
from candaemon.errors import InputError
from candaemon.files.outputs import OutputFile
from candaemon.frames.frame import Frame

zstandard = pytest.importorskip("zstandard")

START = 1_533_226_488_434_433_001
FRAMES = [Frame(START + k * 10**6, k % 2, 0x200 + k % 7, bytes([k % 256] * 8)) for k in range(3000)]
CHANNELS = {"can0": 0, "can1": 1}
PACK: dict[str, Callable[[bytes], bytes]] = {
    ".gz": gzip.compress,
    ".xz": lzma.compress,
    ".zst": lambda data: bytes(zstandard.ZstdCompressor().compress(data)),
}
LINE = b"(1533226488.434433) can0 260#08FFFB0000001884\n"


def written(path: Path) -> bytes:
    with OutputFile(path) as file, open_log_writer(file, ["can0", "can1"]) as writer:
        writer.write(FRAMES)
    return path.read_bytes()


def read(path: Path) -> tuple[list[Frame], LogCounts]:
    counts = LogCounts()
    return list(read_log(path, CHANNELS, counts)), counts


@pytest.mark.parametrize("suffix", COMPRESSIONS)
def test_what_is_packed_comes_out_and_packs_to_the_same_bytes(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a.log{suffix}"
    packed = written(path)
    found, counts = read(path)
    assert found == FRAMES
    assert counts.bytes_read == counts.bytes_total == len(packed)
    assert written(tmp_path / f"b.log{suffix}") == packed
    assert len(packed) < 0.3 * len(written(tmp_path / "a.log"))


@pytest.mark.parametrize("suffix", COMPRESSIONS)
def test_a_stream_that_is_cut_short_gives_what_is_there(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a.log{suffix}"
    packed = written(path)
    path.write_bytes(packed[: len(packed) - 5])
    found, counts = read(path)
    assert found[:-1] == FRAMES[: max(len(found) - 1, 0)]  # the last line may be half there
    assert counts.truncated
    assert "ended before the end-of-stream" in counts.stream_error


@pytest.mark.parametrize("suffix", COMPRESSIONS)
def test_damage_ends_a_stream_and_costs_nothing_before_it(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a.log{suffix}"
    first = PACK[suffix](LINE * 20)
    path.write_bytes(first + b"damaged behind a whole stream")
    found, counts = read(path)
    assert len(found) == 20
    assert counts.truncated
    path.write_bytes(b"nothing of the kind")
    found, counts = read(path)
    assert found == []
    with pytest.raises(InputError, match="the file ends early"):
        counts.require_frames(path)


@pytest.mark.parametrize("suffix", COMPRESSIONS)
def test_streams_one_after_another_are_one_log(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a.log{suffix}"
    padding = b"\0" * 8 if suffix == ".xz" else b""
    path.write_bytes(PACK[suffix](LINE * 3) + padding + PACK[suffix](LINE[:20]) + PACK[suffix](LINE[20:] * 1))
    found, counts = read(path)
    assert (len(found), counts.truncated) == (4, False)
    path.write_bytes(b"")
    assert read(path)[1].truncated is False


def test_unpacking_may_take_so_much_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert LARGEST_WINDOW == 128 << 20
    monkeypatch.setattr(compression, "LARGEST_WINDOW", 1 << 23)
    for beyond in (0, 1):
        parameters = zstandard.ZstdCompressionParameters(window_log=23 + beyond, write_content_size=0)
        packer = zstandard.ZstdCompressor(compression_params=parameters).compressobj()
        (path := tmp_path / "a.log.zst").write_bytes(packer.compress(LINE * 10) + packer.flush())
        found, counts = read(path)
        assert (len(found), counts.truncated) == (0 if beyond else 10, bool(beyond))
        # unpacking takes what the dictionary does, and little more
        filters = [{"id": lzma.FILTER_LZMA2, "dict_size": (6 + 2 * beyond) << 20}]
        (path := tmp_path / "a.log.xz").write_bytes(lzma.compress(LINE * 10, filters=filters))
        found, counts = read(path)
        assert (len(found), counts.truncated) == (0 if beyond else 10, bool(beyond))


@pytest.mark.parametrize("suffix", [".xz", ".zst"])
def test_a_bomb_comes_out_in_small_pieces(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a.log{suffix}"
    path.write_bytes(PACK[suffix](bytes(64 << 20)))
    with path.open("rb") as file:
        source = compression.unpacked(file, suffix, path)
        sizes = iter(lambda: len(source.read1(1 << 16)), 0)
        assert sum(sizes) == 64 << 20
        assert max(map(len, compression._zst_pieces(file, zstandard)), default=0) == 0
    with path.open("rb") as file:
        pieces = compression._zst_pieces(file, zstandard) if suffix == ".zst" else compression._xz_pieces(file)
        assert max(map(len, pieces)) <= 8 << 20


def test_without_its_extra_zstandard_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written(path := tmp_path / "a.log.zst")
    monkeypatch.setitem(sys.modules, "zstandard", None)
    for use in (lambda: read(path), lambda: written(tmp_path / "b.log.zst")):
        with pytest.raises(InputError, match=r"extra 'zst': pip install 'candaemon\[zst\]'"):
            use()

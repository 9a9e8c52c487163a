"""Compressed logs: gzip, xz and Zstandard, unpacked and packed as streams, in bounded memory.

A stream may consist of several, one after another. One that is damaged, or cut short, gives all that lies before and
then raises.
"""

from __future__ import annotations

import gzip
import lzma
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO, Final, Protocol, cast

from candaemon.errors import InputError

LARGEST_WINDOW: Final = 128 << 20
"""Bytes of memory that unpacking may take; `xz -9` takes 65 MiB, `zstd --ultra` 128 MiB, `--long=31` more."""

COMPRESSIONS: Final = (".gz", ".xz", ".zst")
"""Suffixes that mark a log as compressed."""
_MAGIC = {b"\x1f\x8b": ".gz", b"\xfd7zXZ\0": ".xz", b"\x28\xb5\x2f\xfd": ".zst"}

_PIECE = 1 << 16
_SIP = 256
"""Packed bytes that are unpacked at once by Zstandard, whose blocks of 4 bytes may hold 128 KiB."""
_CUT_SHORT = "Compressed file ended before the end-of-stream marker was reached"


class ByteSource(Protocol):
    """A stream that returns up to `size` bytes per read, b"" at its end."""

    def read1(self, size: int, /) -> bytes:
        """Return up to `size` bytes."""

    def close(self) -> None:
        """Give up what was opened for it."""


def compression_by_name(path: Path) -> str:
    """Return the last suffix of a name where it marks compression; empty for any other."""
    suffix = path.suffix.lower()
    return suffix if suffix in COMPRESSIONS else ""


def compression_by_content(head: bytes) -> str:
    """Return the suffix of the compression that a file's first bytes show; empty where they show none."""
    return next((suffix for magic, suffix in _MAGIC.items() if head.startswith(magic)), "")


def unpacked(file: ByteSource, compression: str, path: Path) -> ByteSource:
    """Return what a file holds.

    Reading it raises EOFError where the file is cut short, OSError or `zlib.error` where it is damaged, or would take
    more memory than `LARGEST_WINDOW`.

    Args:
        file: the file; closed by the caller.
        compression: one of `COMPRESSIONS`, or empty.
        path: of the file, for messages.

    Raises:
        InputError: the library for it is not installed.
    """
    match compression:
        case ".gz":
            return cast("ByteSource", gzip.GzipFile(fileobj=cast("BinaryIO", file), mode="rb"))
        case ".xz":
            return _Pieces(_xz_pieces(file))
        case ".zst":
            return _Pieces(_zst_pieces(file, _zstandard(path)))
    return file


def packed(stream: BinaryIO, path: Path) -> BinaryIO:
    """Return a stream that compresses as a file's name says; the same bytes give the same. Closing it closes no other.

    Raises:
        InputError: the library for it is not installed.
    """
    match compression_by_name(path):
        case ".gz":  # no name and no time in the header, so that equal content gives equal bytes
            return cast("BinaryIO", gzip.GzipFile(filename="", mode="wb", fileobj=stream, mtime=0))
        case ".xz":
            return cast("BinaryIO", lzma.LZMAFile(stream, "wb"))
        case ".zst":
            return cast("BinaryIO", _zstandard(path).ZstdCompressor().stream_writer(stream, closefd=False))
    return stream


def _zstandard(path: Path) -> Any:
    """Return the library for Zstandard.

    Raises:
        InputError: it is not installed.
    """
    try:
        return import_module("zstandard")
    except ImportError:
        raise InputError("Zstandard needs the extra 'zst': pip install 'candaemon[zst]'", file=path) from None


class _Pieces:
    """Pieces of any size as a stream."""

    def __init__(self, pieces: Iterator[bytes]) -> None:
        self._pieces = pieces
        self._rest = memoryview(b"")

    def read1(self, size: int) -> bytes:
        """Return up to `size` bytes, b"" at the end."""
        while not self._rest:  # ends: the pieces do
            piece = next(self._pieces, None)
            if piece is None:
                return b""
            self._rest = memoryview(piece)
        given, self._rest = self._rest[:size], self._rest[size:]
        return bytes(given)

    def close(self) -> None:
        """Do nothing: the file is its opener's."""


def _xz_pieces(file: ByteSource) -> Iterator[bytes]:
    """Yield what xz streams hold, with padding between them."""
    rest = b""
    while rest := rest or file.read1(_PIECE):
        rest = rest.lstrip(b"\0")
        if not rest:
            continue
        try:
            inflater = lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=LARGEST_WINDOW)
            while not inflater.eof:
                if inflater.needs_input and not rest:
                    rest = _more(file.read1)
                yield inflater.decompress(rest, _PIECE)
                rest = b""
        except lzma.LZMAError as error:
            raise OSError(str(error)) from None
        rest = inflater.unused_data


def _zst_pieces(file: ByteSource, zstandard: Any) -> Iterator[bytes]:
    """Yield what Zstandard frames hold."""
    unpacker, rest = zstandard.ZstdDecompressor(max_window_size=LARGEST_WINDOW), b""
    while rest := rest or file.read1(_PIECE):
        inflater = unpacker.decompressobj()
        while not inflater.eof:
            rest = rest or _more(file.read1)
            sip, rest = rest[:_SIP], rest[_SIP:]
            try:
                yield inflater.decompress(sip)
            except zstandard.ZstdError as error:
                raise OSError(str(error)) from None
        rest = inflater.unused_data + rest


def _more(read: Callable[[int], bytes]) -> bytes:
    """Read on in the middle of a compressed stream.

    Raises:
        EOFError: there is no more.
    """
    piece = read(_PIECE)
    if not piece:
        raise EOFError(_CUT_SHORT)
    return piece

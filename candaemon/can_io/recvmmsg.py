"""Many datagrams a system call: recvmmsg(2), which Python's sockets lack.

A call to Python's `recvmsg` costs one system call a frame, and for CAN another that looks up the interface's name.
"""

from __future__ import annotations

import ctypes
import errno
import os
import struct
from collections.abc import Iterator
from functools import cache
from typing import Any


class _IoVec(ctypes.Structure):
    """struct iovec of readv(2)."""

    _fields_ = (("base", ctypes.c_void_p), ("len", ctypes.c_size_t))


class _MsgHdr(ctypes.Structure):
    """struct msghdr of recvmsg(2)."""

    _fields_ = (
        ("name", ctypes.c_void_p),
        ("namelen", ctypes.c_uint32),
        ("iov", ctypes.c_void_p),
        ("iovlen", ctypes.c_size_t),
        ("control", ctypes.c_void_p),
        ("controllen", ctypes.c_size_t),
        ("flags", ctypes.c_int),
    )


class _MMsgHdr(ctypes.Structure):
    """struct mmsghdr of recvmmsg(2): a message and how much of it was received."""

    _fields_ = (("hdr", _MsgHdr), ("len", ctypes.c_uint))


_MSG_DONTWAIT = 0x40
_LENGTHS = struct.Struct("@PIPNPNi0NI0N")
"""An mmsghdr; native alignment, as in C."""


class DatagramBatch:
    """Room for datagrams and what the kernel says beside each of them.

    A record is a datagram followed by its control messages and its sender's address, all in the room given, whatever of
    it is filled.

    Args:
        count: datagrams received in one call at most.
        size: longest datagram in bytes; a multiple of 8, which keeps the control messages aligned.
        control: bytes for the control messages of each, as CMSG_SPACE adds them up; a multiple of the word size.
        sender: bytes for the address of each one's sender; likewise.

    Attributes:
        count: as given.
    """

    def __init__(self, count: int, size: int, control: int, sender: int = 0) -> None:
        self.count = count
        self._stride = size + control + sender
        self._room = ctypes.create_string_buffer(count * self._stride)
        self._headers = (_MMsgHdr * count)()
        start = ctypes.addressof(self._room)
        self._vectors = (_IoVec * count)(*(_IoVec(start + k * self._stride, size) for k in range(count)))
        start_of_vectors = ctypes.addressof(self._vectors)
        for k, header in enumerate(self._headers):
            vector = start_of_vectors + k * ctypes.sizeof(_IoVec)
            beside = start + k * self._stride + size
            header.hdr = _MsgHdr(beside + control, sender, vector, 1, beside, control)
        self._blank = bytes(self._headers)  # the kernel writes over the lengths
        self._records = memoryview(self._room)
        self._lengths = memoryview(self._headers).cast("B")
        self._recvmmsg = _recvmmsg()

    def receive(self, descriptor: int, limit: int) -> int:
        """Receive what is there, without waiting.

        Args:
            descriptor: of the socket.
            limit: datagrams at most; never more than `count`.

        Returns:
            how many came; 0 where none waits.

        Raises:
            OSError: the socket's error.
        """
        ctypes.memmove(self._headers, self._blank, len(self._blank))
        number: int = self._recvmmsg(descriptor, self._headers, min(limit, self.count), _MSG_DONTWAIT, None)
        if number >= 0:
            return number
        code = ctypes.get_errno()
        if code in (errno.EAGAIN, errno.EINTR):
            return 0
        raise OSError(code, os.strerror(code))

    def lengths(self, number: int) -> Iterator[tuple[int, int]]:
        """Yield the bytes of each datagram and of its control messages.

        Args:
            number: of datagrams, as `receive` returned it.
        """
        for *_, control, _flags, size in _LENGTHS.iter_unpack(self._lengths[: number * _LENGTHS.size]):
            yield size, control

    def records(self, number: int, form: struct.Struct) -> Iterator[tuple[Any, ...]]:
        """Yield each datagram with its control messages, unpacked; what was not filled is of no meaning.

        Args:
            number: of datagrams, as `receive` returned it.
            form: of a whole record.
        """
        return form.iter_unpack(self._records[: number * self._stride])


@cache
def _recvmmsg() -> Any:  # ctypes' functions have no type
    """Return the C library's recvmmsg.

    Raises:
        OSError: this system has none.
    """
    library = ctypes.CDLL(None, use_errno=True)
    try:
        function = library.recvmmsg
    except AttributeError as error:
        raise OSError(errno.ENOSYS, "this system has no recvmmsg") from error
    function.argtypes = (ctypes.c_int, ctypes.c_void_p, ctypes.c_uint, ctypes.c_int, ctypes.c_void_p)
    function.restype = ctypes.c_int
    return function

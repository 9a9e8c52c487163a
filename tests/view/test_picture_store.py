"""The store of pictures: order, limits, what is forgotten."""

from __future__ import annotations

import errno
import os

import pytest

from candaemon.errors import InputError
from candaemon.view import picture_store
from candaemon.view.picture_store import PictureStore


def filled(store: PictureStore, count: int, size: int = 10) -> int:
    """Put pictures into a store, one a second; return how many it took."""
    return sum(store.append(float(k), f"{k:0{size}d}".encode()) for k in range(count))


def test_pictures_are_found_by_number_and_by_time() -> None:
    store = PictureStore(8 * 100)
    assert filled(store, 25) == 25  # over three segments
    assert store.number_at(-1.0) == 0
    assert store.number_at(9.0) == 10  # the picture of that time is before it
    assert store.number_at(9.5) == 10
    assert store.number_at(99.0) == 25
    assert [int(each) for each in store.read(8, 22)] == list(range(8, 22))
    assert [int(each) for each in store.read(20, 99)] == list(range(20, 25))
    assert store.time_of(17) == 17.0
    assert store.time_of(99) == 24.0
    assert store.time_of(-5) == 0.0
    store.close()


@pytest.mark.parametrize("name", ["LARGEST_DRIVE", "LARGEST_LIVE"])
def test_a_store_holds_so_many_bytes(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert getattr(picture_store, name) >= 1 << 20
    monkeypatch.setattr(picture_store, name, 8 * 40)
    store = PictureStore(getattr(picture_store, name), forgets=name == "LARGEST_LIVE")
    if name == "LARGEST_DRIVE":
        assert filled(store, 33) == 32  # eight segments of four
        assert store.extent().cut
        assert store.read(0, 1) == [b"0000000000"]
    else:
        assert filled(store, 33) == 33
        extent = store.extent()
        assert (extent.first, extent.after, extent.first_s, extent.cut) == (4, 33, 4.0, False)
        assert store.read(0, 5) == [b"0000000004"]
        assert store.number_at(0.0) == 4
    store.close()


def test_a_picture_that_a_full_disk_cuts_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    store, write, room = PictureStore(), os.pwrite, 35

    def filling(descriptor: int, data: bytes, at: int) -> int:
        if at == room:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(descriptor, data[: min(room - at, 7)], at)  # in parts, as a nearly full disk takes it

    monkeypatch.setattr(os, "pwrite", filling)
    with pytest.raises(InputError, match="cannot be kept there: No space left on device; make room, or set TMPDIR"):
        filled(store, 9)
    assert store.extent().after == 3
    assert [int(each) for each in store.read(0, 9)] == [0, 1, 2]
    store.close()


def test_time_never_runs_backwards() -> None:
    store = PictureStore()
    for time_s in (5.0, 4.0, 6.0):
        store.append(time_s, b"x")
    assert [store.time_of(k) for k in range(3)] == [5.0, 5.0, 6.0]
    store.close()


def test_an_empty_store_is_empty() -> None:
    store = PictureStore()
    assert store.extent().after == 0
    assert store.read(0, 5) == []
    assert store.number_at(3.0) == 0
    assert store.time_of(0) == 0.0

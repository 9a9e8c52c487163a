"""The pictures in the documentation show what is drawn today."""

from __future__ import annotations

import struct

from tests.support.view_pictures import DIGEST, FOLDER, SIZE, digest


def test_the_pictures_are_of_the_data_that_is_drawn() -> None:
    said = "make them anew: python -m tests.support.view_pictures"
    assert DIGEST.read_text(encoding="ascii").strip() == digest(), said


def test_the_pictures_are_there() -> None:
    for name in ("view.png", "view-dark.png"):
        data = (FOLDER / name).read_bytes()
        assert data.startswith(b"\x89PNG")
        assert struct.unpack(">II", data[16:24]) == SIZE
        assert len(data) < 400_000

"""Tables of tracks and truth with anything in them: refused by name and line, or read, written again and evaluated."""

from __future__ import annotations

import gzip
import json
from collections import Counter
from dataclasses import fields
from pathlib import Path

import numpy as np

from candaemon.errors import InputError
from candaemon.evaluation.metrics import compare
from candaemon.evaluation.tables import BODY_NUMBERS, COLUMNS, NUMBERS, TrackTable, TrackWriter, read_tracks, read_truth
from candaemon.files.outputs import OutputFile
from candaemon.frames.bodies import CLASSES

from .drawn import Drawn
from .invariants import hold_place
from .scratch import scratch

_WORDS = (b",", b",,", b"\n", b"\r\n", b'"', b'""', b"nan", b"inf", b"-1e308", b"1e400", b"0", b"-0.0", b"1_0", b"0x1",
          b"9223372036854775807", b"9223372036854775808", b"9" * 40, b"1e9", b"1700000000.0000000005", b"sNaN",
          b"tentative", b"coasting", b"hidden", b"stationary", b"front:1;front:2", b":", b";", b"a:b", b"\0", b"\xff",
          b"\xef\xbb\xbf", "\u2028\u00b2\u0663".encode(), b"time,", b"1700000000.1,1,actor,")  # fmt: skip
_TIMES = 6
_IDS = 4


def fuzz_tables(data: bytes) -> Counter[str]:
    """Read a table of tracks and one of truth; two that can be read are compared."""
    drawn = Drawn(data)
    edited, packed, changes_truth = drawn.integer(0, 7) > 0, drawn.integer(0, 3) == 3, drawn.flag()
    texts = {"tracks": _SOUND["tracks"], "truth": _SOUND["truth"]}
    name = "truth" if changes_truth else "tracks"
    texts[name] = drawn.edited(texts[name], _WORDS) if edited else drawn.rest()
    tracks = _read(texts["tracks"], "tracks", packed=packed)
    truth = _read(texts["truth"], "truth", packed=packed)
    if tracks is None or truth is None:
        return Counter(edited=edited, refused=1)
    try:
        found = json.loads(compare(tracks, truth).to_json(), parse_constant=_no_number)
    except InputError:
        return Counter(edited=edited, without_common_time=1)
    assert isinstance(found, dict)
    return Counter(edited=edited, evaluated=1, rows=len(tracks) + len(truth))


def _read(text: bytes, name: str, *, packed: bool) -> TrackTable | None:
    """Return a table after what must hold of one; None: it was refused."""
    path = scratch() / (f"{name}.csv.gz" if packed else f"{name}.csv")
    path.write_bytes(gzip.compress(text, 1) if packed else text)
    reader = read_tracks if name == "tracks" else read_truth
    try:
        table = reader(path)
    except InputError as error:
        hold_place(error)
        return None
    assert all(len(getattr(table, field.name)) == len(table) for field in fields(table))
    assert not any(np.isinf(getattr(table, number)).any() for number in (*NUMBERS, *BODY_NUMBERS))
    assert (np.diff(table.time_ns) >= 0).all()
    _written_again(table, scratch() / f"{name}-again.csv", reader is read_tracks)
    return table


def _written_again(table: TrackTable, path: Path, tracks: bool) -> None:
    """Hold that what is written is read again, and gives the same bytes."""
    reader, written = read_tracks if tracks else read_truth, []
    for _ in range(2):
        with OutputFile(path) as file, TrackWriter(file, (*BODY_NUMBERS, "class")) as writer:
            for time_ns in np.unique(table.time_ns).tolist():
                rows = table.take(table.time_ns == time_ns)
                columns = {name: getattr(rows, name) for name in (*COLUMNS[1:], *BODY_NUMBERS)} | {"class": rows.kind}
                writer.write_cycle(time_ns, columns)
        written.append(path.read_bytes())
        table = reader(path)
    assert written[0] == written[1], "a table that was written and read is written otherwise"


def _no_number(constant: str) -> None:
    raise AssertionError(f"{constant} in JSON")


def _sound(states: tuple[str, ...], offset: float) -> bytes:
    """Return a table of some objects that drive side by side."""
    lines = [",".join((*COLUMNS, *BODY_NUMBERS, "class"))]
    for k in range(_TIMES):
        for number in range(_IDS):
            x, y = 10.0 * number + 2.0 * k + offset, 3.5 * (number % 3 - 1)
            numbers = (x, y, 20.0, 0.0, 0.0, 0.0, x + 100, y, 20.0, 0.0, 0.3, 0.3, 0.5, 0.5, 0.05 * k)
            cells = ",".join(f"{value:.4f}" for value in numbers)
            body = f"{number - 2}.5,0.01,4.5,1.8,{x + 2},{y},0.9,2,{CLASSES[number]}"
            lines.append(
                f"17000000{k:02d}.050000,{number},{states[number % len(states)]},{cells},front:{number},{body}"
            )
    return "\n".join((*lines, "")).encode()


_SOUND = {
    "tracks": _sound(("confirmed", "confirmed", "coasting", "tentative"), 0.2),
    "truth": _sound(("actor", "actor", "stationary", "hidden"), 0.0),
}

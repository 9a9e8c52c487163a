"""A bird's-eye view made of characters, for a terminal: ahead is up, the own vehicle is `^`."""

from __future__ import annotations

from typing import Final

import numpy as np

from candaemon.view.picture import Picture

SIGNS: Final = "?o~"
"""Before the id of a tentative, a confirmed and a coasting obstacle."""
_DETECTION, _OWN = "·", "^"
_ROWS_A_METRE_WIDE: Final = 2.0
"""A character is twice as high as wide."""


def drawn(picture: Picture, columns: int, rows: int, *, ahead: float = 100.0) -> list[str]:
    """Return a picture as lines of characters.

    Of obstacles whose ids would touch, the one least far ahead keeps its id. The others are their sign, or nothing
    where that would touch, too.

    Args:
        picture: of the cycle.
        columns: characters of a line.
        rows: lines.
        ahead: m that the upper edge lies ahead; a sixth of it is drawn behind.
    """
    field = [[" "] * columns for _ in range(rows)]
    behind = ahead / 6
    metres = (ahead + behind) / max(rows - 1, 1)
    own_row = round(ahead / metres)
    middle = columns // 2

    def cell(x: float, y: float) -> tuple[int, int] | None:
        if not (abs(x) < 1e6 and abs(y) < 1e6):  # NaN is not less
            return None
        row, column = own_row - round(x / metres), middle - round(y / metres * _ROWS_A_METRE_WIDE)
        return (row, column) if 0 <= row < rows and 0 <= column < columns else None

    marked = [k for k in range(rows) if (own_row - k) % 5 == 0 and k != own_row]
    for k in marked:
        field[k][middle] = "|"
    for scan in picture.scans:
        for x, y in zip(scan.x.tolist(), scan.y.tolist(), strict=True):
            if (at := cell(x, y)) is not None:
                field[at[0]][at[1]] = _DETECTION
    if 0 <= own_row < rows:
        field[own_row][middle] = _OWN
    named = picture.columns
    taken = [[False] * columns for _ in range(rows)]
    for row in np.argsort(named["x"], kind="stable").tolist():
        at = cell(float(named["x"][row]), float(named["y"][row]))
        if at is not None:
            sign = SIGNS[int(named["state"][row]) % len(SIGNS)]
            line = field[at[0]], taken[at[0]]
            _ = _put(*line, at[1], f"{sign}{int(named['id'][row])}") or _put(*line, at[1], sign)
    for k in marked:
        _put(field[k], taken[k], 0, f"{(own_row - k) * metres:.0f} m")
    return ["".join(line).rstrip() for line in field]


def _put(line: list[str], taken: list[bool], column: int, text: str) -> bool:
    """Write a text into a line where there is room for all of it and it touches no other; return whether there is."""
    end = column + len(text)
    if end > len(line) or any(taken[max(column - 1, 0) : end + 1]):
        return False
    line[column:end] = text
    taken[column:end] = [True] * len(text)
    return True

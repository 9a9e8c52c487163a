"""Drawings as SVG within a page: axes with round numbers, lines, bands, bars, in the colours of its style sheet."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape
from math import ceil, floor, isfinite, log10
from typing import Final

import numpy as np

from candaemon.arrays import Floats

_LEFT, _RIGHT, _TOP, _BOTTOM = 58.0, 12.0, 10.0, 36.0
_NEAREST: Final = 0.4
"""Of points of a line that are nearer to one another than that on the page, one is drawn."""


def ticks(low: float, high: float, most: int = 8) -> list[float]:
    """Return round numbers between two, `most` at most."""
    span = high - low
    if not (isfinite(span) and span > 0):
        return [low]
    step = 10.0 ** floor(log10(span / most))
    step *= next(factor for factor in (1, 2, 5, 10, 20) if span / (step * factor) <= most)
    first = ceil(low / step - 1e-9)
    return [k * step for k in range(first, floor(high / step + 1e-9) + 1)]


class Chart:
    """A drawing with two axes.

    Args:
        x, y: least and largest value of each axis.
        labels: of the axes.
        size: width and height on the page, in its own units.
        equal: a unit of x is that many times as long as one of y; the limits are widened for that. None: as it comes.
        decimals: of the numbers at the axes; None: as many as they need.
    """

    def __init__(
        self,
        x: tuple[float, float],
        y: tuple[float, float],
        labels: tuple[str, str],
        *,
        size: tuple[float, float] = (960.0, 240.0),
        equal: float | None = None,
        decimals: tuple[int | None, int | None] = (None, None),
    ) -> None:
        self.width, self.height = size
        self._area = (_LEFT, _TOP, self.width - _LEFT - _RIGHT, self.height - _TOP - _BOTTOM)
        self.x, self.y = _wide(x), _wide(y)
        if equal is not None:
            self._equalise(equal)
        self._labels, self._decimals = labels, decimals
        self._parts: list[str] = []

    def line(self, x: Floats, y: Floats, colour: str, *, width: float = 1.4, dash: str = "", title: str = "") -> None:
        """Draw a line; it breaks where a value is not finite."""
        style = f' stroke-dasharray="{dash}"' if dash else ""
        told = f"<title>{escape(title)}</title>" if title else ""
        path = "".join(self._path(piece_x, piece_y) for piece_x, piece_y in _pieces(x, y))
        if path:
            self._parts.append(
                f'<path d="{path}" class="{colour}" fill="none" stroke-width="{width:g}"{style}>{told}</path>'
            )

    def band(self, x: Floats, low: Floats, high: Floats, colour: str) -> None:
        """Fill between two lines."""
        known = np.isfinite(x) & np.isfinite(low) & np.isfinite(high)
        x, low, high = x[known], low[known], high[known]
        if len(x):
            edge = [*zip(*self._at(x, low), strict=True), *reversed(list(zip(*self._at(x, high), strict=True)))]
            points = " ".join(f"{a:.1f},{b:.1f}" for a, b in edge)
            self._parts.append(f'<polygon points="{points}" class="band {colour}"/>')

    def bar(self, left: float, right: float, low: float, high: float, colour: str, title: str = "") -> None:
        """Fill a rectangle."""
        (x0, x1), (y0, y1) = self._at(np.array([left, right]), np.array([high, low]))
        told = f"<title>{escape(title)}</title>" if title else ""
        self._parts.append(
            f'<rect x="{x0:.1f}" y="{y0:.1f}" width="{max(x1 - x0, 0.6):.1f}" height="{max(y1 - y0, 0.3):.1f}" '
            f'class="fill {colour}">{told}</rect>'
        )

    def point(self, x: float, y: float, colour: str, title: str) -> None:
        """Draw a dot."""
        (left,), (top,) = self._at(np.array([x]), np.array([y]))
        self._parts.append(
            f'<circle cx="{left:.1f}" cy="{top:.1f}" r="4" class="fill {colour}">'
            f"<title>{escape(title)}</title></circle>"
        )

    def text(self, x: float, y: float, text: str) -> None:
        """Write beside a point."""
        (left,), (top,) = self._at(np.array([x]), np.array([y]))
        self._parts.append(f'<text x="{left + 6:.1f}" y="{top - 6:.1f}">{escape(text)}</text>')

    def svg(self, name: str) -> str:
        """Return the drawing; `name` is what a screen reader says."""
        left, top, width, height = self._area
        inside = f"c{abs(hash_of(name)):x}"
        return (
            f'<svg viewBox="0 0 {self.width:g} {self.height:g}" role="img" aria-label="{escape(name)}">'
            f'<clipPath id="{inside}"><rect x="{left:g}" y="{top:g}" width="{width:g}" height="{height:g}"/></clipPath>'
            f'{"".join(self._axes())}<g clip-path="url(#{inside})">{"".join(self._parts)}</g></svg>'
        )

    def _axes(self) -> Iterator[str]:
        left, top, width, height = self._area
        for value in ticks(*self.x):
            at = float(self._at(np.array([value]), np.array([self.y[0]]))[0][0])
            yield f'<line class="grid" x1="{at:.1f}" y1="{top:g}" x2="{at:.1f}" y2="{top + height:g}"/>'
            yield _text(at, top + height + 14, "middle", _number(value, self._decimals[0]))
        for value in ticks(*self.y, 6):
            at = float(self._at(np.array([self.x[0]]), np.array([value]))[1][0])
            yield f'<line class="grid" x1="{left:g}" y1="{at:.1f}" x2="{left + width:g}" y2="{at:.1f}"/>'
            yield _text(left - 5, at + 4, "end", _number(value, self._decimals[1]))
        yield _text(left + width / 2, self.height - 4, "middle", self._labels[0])
        turned = f"translate(12 {top + height / 2:g}) rotate(-90)"
        yield f'<text transform="{turned}" text-anchor="middle">{escape(self._labels[1])}</text>'

    def _at(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        left, top, width, height = self._area
        return (
            left + (x - self.x[0]) / (self.x[1] - self.x[0]) * width,
            top + height - (y - self.y[0]) / (self.y[1] - self.y[0]) * height,
        )

    def _path(self, x: Floats, y: Floats) -> str:
        across, down = self._at(x, y)
        kept = [0]
        for k in range(1, len(across)):
            if abs(across[k] - across[kept[-1]]) + abs(down[k] - down[kept[-1]]) >= _NEAREST:
                kept.append(k)
        if kept[-1] != len(across) - 1:
            kept.append(len(across) - 1)
        return "M" + "L".join(f"{across[k]:.1f} {down[k]:.1f}" for k in kept)

    def _equalise(self, ratio: float) -> None:
        _, _, width, height = self._area
        scale = max((self.x[1] - self.x[0]) * ratio / width, (self.y[1] - self.y[0]) / height)
        (left, right), (low, high) = self.x, self.y
        self.x = (left + right - scale * width / ratio) / 2, (left + right + scale * width / ratio) / 2
        self.y = (low + high - scale * height) / 2, (low + high + scale * height) / 2


def _text(x: float, y: float, anchor: str, text: str) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(text)}</text>'


def hash_of(text: str) -> int:
    """Return a number of a text, the same in each run."""
    total = 0
    for letter in text:
        total = (total * 131 + ord(letter)) % (1 << 61)
    return total


def limits(*values: Floats | Sequence[float], least: float | None = None) -> tuple[float, float]:
    """Return the least and the largest finite number among some; 0 and 1 where there is none."""
    whole = np.concatenate([np.asarray(each, np.float64).ravel() for each in values]) if values else np.empty(0)
    whole = whole[np.isfinite(whole)]
    low, high = (float(whole.min()), float(whole.max())) if len(whole) else (0.0, 1.0)
    return (low if least is None else min(least, low)), high


def _wide(span: tuple[float, float]) -> tuple[float, float]:
    low, high = span
    if high - low > 1e-12 * max(abs(low), abs(high), 1e-9):
        return low, high
    room = abs(low) * 1e-6 or 0.5
    return low - room, high + room


def _pieces(x: Floats, y: Floats) -> Iterator[tuple[Floats, Floats]]:
    known = np.isfinite(x) & np.isfinite(y)
    starts = np.flatnonzero(np.diff(np.concatenate([[False], known, [False]]).astype(np.int8)))
    for begin, end in starts.reshape(-1, 2).tolist():
        yield x[begin:end], y[begin:end]


def _number(value: float, decimals: int | None) -> str:
    return f"{value + 0.0:.6g}" if decimals is None else f"{value + 0.0:.{decimals}f}"

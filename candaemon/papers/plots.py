"""Drawings of experiments as PNG and SVG: the same bytes for the same data, whatever style the user has set."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Mapping
from itertools import cycle, product
from typing import Any, TypeAlias

import matplotlib.style
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas

from candaemon.exports.palette import SERIES
from candaemon.papers.experiment import Figure, Panel

Look: TypeAlias = dict[str, Any]
"""How a curve is drawn, in matplotlib's words."""

_WIDTH_IN = 8.0
_PANEL_HEIGHT_IN = 2.6
_PATH_HEIGHT_IN = 4.0
_Y_LABEL_LETTERS = 28  # what a panel's height has room for

_DASHES = ("-", "--", ":")  # a seventh curve has the first colour again, dashed

_KNOWN_LOOKS: Mapping[str, Look] = {
    "truth": {"color": "black", "linewidth": 0.8},
    "measured": {"color": "0.6", "linestyle": "none", "marker": ".", "markersize": 2.0, "zorder": 1.0},
    "default": {"color": "0.3", "linestyle": "--"},
    "bound": {"color": "black", "linestyle": ":"},
}
"""Of the curves that many figures have, by label."""

_STYLE: Mapping[str, Any] = {
    "axes.axisbelow": True,
    "axes.grid": True,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "figure.constrained_layout.use": True,
    "font.size": 9,
    "grid.alpha": 0.3,
    "legend.frameon": False,
    "lines.linewidth": 1.2,
    "savefig.dpi": 150,
    "svg.hashsalt": "candaemon",  # else the ids inside an SVG are random
}

_METADATA: Mapping[str, Mapping[str, None]] = {"png": {"Software": None}, "svg": {"Creator": None, "Date": None}}
"""Of each kind of file, what would differ from day to day or from one matplotlib to the next."""


def draw(figure: Figure) -> dict[str, bytes]:
    """Draw a figure.

    Args:
        figure: its data.

    Returns:
        The content of each file by its name: '000-variance.png', '000-variance.svg'.
    """
    files = {}
    with matplotlib.style.context(["default", dict(_STYLE)], after_reset=True):
        canvas = _canvas(figure)
        for kind, metadata in _METADATA.items():
            content = io.BytesIO()
            canvas.savefig(content, format=kind, metadata=dict(metadata))
            files[f"{figure.name}.{kind}"] = content.getvalue()
    return files


def _canvas(figure: Figure) -> Canvas:
    """Return a figure's panels one below another, each with a legend of the curves not yet explained."""
    heights = [_PATH_HEIGHT_IN if panel.equal else _PANEL_HEIGHT_IN for panel in figure.panels]
    canvas = Canvas(figsize=(_WIDTH_IN, sum(heights)))
    canvas.suptitle(figure.title)
    rows = canvas.subplots(len(heights), squeeze=False, height_ratios=heights)[:, 0]
    looks = _looks(figure)
    explained: set[str] = set()
    for axes, panel in zip(rows, figure.panels, strict=True):
        _plot(axes, panel, looks)
        unexplained = [curve for curve in axes.lines if curve.get_label() not in explained]
        if unexplained:
            axes.legend(handles=unexplained, loc="upper left", bbox_to_anchor=(1.0, 1.0))
        explained |= {line.label for line in panel.lines}
    return canvas


def _looks(figure: Figure) -> dict[str, Look]:
    """Return how the curves of each label are drawn: alike in all panels."""
    labels = dict.fromkeys(line.label for panel in figure.panels for line in panel.lines)
    others = [label for label in labels if label not in _KNOWN_LOOKS]
    free = cycle({"color": colour, "linestyle": dash} for dash, colour in product(_DASHES, SERIES))
    return {**_KNOWN_LOOKS, **dict(zip(others, free, strict=False))}


def _plot(axes: Axes, panel: Panel, looks: Mapping[str, Look]) -> None:
    """Draw a panel's curves."""
    for line in panel.lines:
        axes.plot(line.x, line.y, label=line.label, **looks[line.label])
    axes.set_xlabel(panel.x_label)
    axes.set_ylabel(textwrap.fill(panel.y_label, _Y_LABEL_LETTERS))
    if panel.equal:
        axes.set_aspect("equal", adjustable="datalim")

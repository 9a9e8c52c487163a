"""Decodes the output's frames into obstacles, as a reader on the bus does."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from candaemon.arrays import Floats
from candaemon.binding.bind_reader import bind_reader
from candaemon.binding.bound import BoundOutput
from candaemon.binding.numbered_names import numbered_names
from candaemon.config.base import SignalRef
from candaemon.frames.bodies import BODY, CLASSES
from candaemon.tracking.obstacles import MOTION

_NUMBERS = (*MOTION, "age", *BODY, "existence", "class_likelihood")

FIRST_STATE = 1
"""Value on the wire of the tables' state code 0; 0 on the wire is an empty slot."""


@dataclass(frozen=True, slots=True)
class DecodedCycle:
    """Obstacles of one cycle as decoded from the wire.

    Attributes:
        number: of the cycle, from 0.
        time_ns: the time they are valid for; 0 where it is not known.
        quantities: by name, shape (n,), SI and vehicle axes; NaN where they are unknown.
    """

    number: int
    time_ns: int
    quantities: dict[str, Floats]

    def at(self, time_ns: int) -> DecodedCycle:
        """Return the cycle with the time it is valid for."""
        return replace(self, time_ns=time_ns)

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return the obstacles as columns of the table of tracks."""
        quantities = self.quantities
        columns: dict[str, NDArray[Any]] = {
            "id": quantities["id"].astype(np.int64),
            "state": quantities["state"].astype(np.int64) - FIRST_STATE,
            **{name: quantities[name] for name in _NUMBERS if name in quantities},
        }
        for center, difference, reference in (("center_x", "center_dx", "x"), ("center_y", "center_dy", "y")):
            if {difference, reference} <= quantities.keys():
                columns.setdefault(center, quantities[reference] + quantities[difference])
        if "class" in quantities:  # an optional message may be missing; a code that nobody knows is of no known class
            kind = np.nan_to_num(quantities["class"])
            columns["class"] = np.where(kind < len(CLASSES), kind, 0).astype(np.int8)
        return columns


class OutputDecoder:
    """Assembles the frames of an output into cycles. A status message begins each cycle.

    Args:
        output: the bound output; it must have a status message, and id and state among its quantities.
    """

    def __init__(self, output: BoundOutput) -> None:
        settings = output.settings
        signals: dict[str, SignalRef] = {str(name): refs[0] for name, refs in settings.signals.items()}
        self._reader = bind_reader(
            settings.objects,
            signals,
            output.database,
            units=settings.units,
            names=numbered_names(settings.signals, settings.protection),
        )
        self._status_id = None if output.status is None else output.status.message.can_id
        self._payloads: list[list[bytes | None]] = []
        self._clear()
        self._cycles = -1

    def push(self, can_id: int, data: bytes) -> Iterator[DecodedCycle]:
        """Process a frame; yield the cycle that it completes."""
        if can_id == self._status_id:
            yield from self.flush()
            self._cycles += 1
            return
        route = self._reader.routes.get(can_id)
        if route is not None:
            part, slot = route
            self._payloads[part][slot] = data

    def flush(self) -> Iterator[DecodedCycle]:
        """Yield the open cycle."""
        if self._cycles < 0:
            return
        objects = self._reader.read(self._payloads)
        values = objects.values[:, objects.valid]
        self._clear()
        yield DecodedCycle(self._cycles, 0, dict(zip(self._reader.quantities, values, strict=True)))

    def _clear(self) -> None:
        """Discard the frames of the cycle."""
        self._payloads = [[None] * self._reader.places for _ in self._reader.layouts]

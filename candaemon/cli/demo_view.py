"""Obstacles as they live: a table that changes on a terminal, plain lines elsewhere."""

from __future__ import annotations

from types import TracebackType
from typing import TYPE_CHECKING, Self

from candaemon.output.decoder import FIRST_STATE, DecodedCycle
from candaemon.tracking.obstacles import STATE_NAMES

if TYPE_CHECKING:
    from rich.table import Table

_COLUMNS = (("x", "m"), ("y", "m"), ("vx", "m/s"), ("vy", "m/s"), ("ax", "m/s²"), ("age", "s"))
_REFRESH_HZ = 10
_SECOND_NS = 1_000_000_000


class LinesShow:
    """A line when an obstacle comes or goes, and one a second with where they are."""

    def __init__(self) -> None:
        self._first_ns: int | None = None
        self._next_ns = 0
        self._known: set[int] = set()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Nothing is open."""

    def cycle(self, told: DecodedCycle) -> None:
        """Print what is worth a line."""
        if self._first_ns is None:
            self._first_ns = self._next_ns = told.time_ns
        time = f"{(told.time_ns - self._first_ns) / _SECOND_NS:6.2f} s"
        quantities = {name: values.tolist() for name, values in told.quantities.items()}
        there = {int(identity): row for row, identity in enumerate(quantities["id"])}
        for identity in sorted(there.keys() - self._known):
            print(f"{time}  obstacle {identity} confirmed at {_place(quantities, there[identity])}", flush=True)
        for identity in sorted(self._known - there.keys()):
            print(f"{time}  obstacle {identity} gone", flush=True)
        self._known = set(there)
        if told.time_ns >= self._next_ns:
            self._next_ns += _SECOND_NS
            where = "; ".join(f"{identity} {_place(quantities, row)}" for identity, row in sorted(there.items()))
            print(f"{time}  {len(there)} obstacles" + (f": {where}" if where else ""), flush=True)


def _place(quantities: dict[str, list[float]], row: int) -> str:
    """Say where an obstacle is and how fast it goes."""
    x, y, vx = (quantities[name][row] for name in ("x", "y", "vx"))
    return f"({x:.1f}, {y:.1f}) m {vx:.1f} m/s"


class TableShow:
    """A table of all obstacles, drawn anew some times a second."""

    def __init__(self) -> None:
        from rich.console import Console  # noqa: PLC0415 - costs time that a pipe need not spend
        from rich.live import Live  # noqa: PLC0415 - likewise

        self._first_ns: int | None = None
        self._table: Table | None = None
        self._live = Live(console=Console(), auto_refresh=False, refresh_per_second=_REFRESH_HZ)
        self._next_s = 0.0

    def __enter__(self) -> Self:
        self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._live.stop()

    def cycle(self, told: DecodedCycle) -> None:
        """Draw the table if it is time."""
        if self._first_ns is None:
            self._first_ns = told.time_ns
        now_s = self._live.console.get_time()
        if now_s >= self._next_s:
            self._next_s = now_s + 1 / _REFRESH_HZ
            self._live.update(_table(told, (told.time_ns - self._first_ns) / _SECOND_NS), refresh=True)


def _table(told: DecodedCycle, seconds: float) -> Table:
    """Return obstacles as a table, the nearest first."""
    from rich.table import Table  # noqa: PLC0415 - as above

    table = Table(title=f"{seconds:5.1f} s · x ahead, y to the left, speeds over ground", title_justify="left")
    table.add_column("id", justify="right")
    table.add_column("state", min_width=9)
    columns = [(name, unit) for name, unit in _COLUMNS if name in told.quantities]
    for name, unit in columns:
        table.add_column(f"{name} ({unit})", justify="right", min_width=9)
    quantities = {name: values.tolist() for name, values in told.quantities.items()}
    for row in sorted(range(len(quantities["id"])), key=quantities["x"].__getitem__):
        state = STATE_NAMES[int(quantities["state"][row]) - FIRST_STATE]
        cells = (f"{quantities[name][row]:.1f}" for name, _ in columns)
        table.add_row(f"{quantities['id'][row]:.0f}", state, *cells, style="dim" if state == "coasting" else None)
    return table

"""Values along and across the direction of travel; a single number applies to both."""

from __future__ import annotations

from typing import Annotated, Any, Final

from pydantic import AfterValidator, BeforeValidator, Field

from candaemon.config.base import Settings

SHORTEST_SETTLING: Final = 0.02
"""s, the shortest time constant."""


_Magnitude = Annotated[float, Field(ge=0, le=1e6, strict=True)]


class AlongAcross(Settings):
    """A number for each direction: along and across the direction of travel."""

    along: _Magnitude
    across: _Magnitude


def _long_enough(value: float) -> float:
    """Refuse time constants that are neither 0 nor at least `SHORTEST_SETTLING`."""
    if 0 < value < SHORTEST_SETTLING:
        raise ValueError(f"a time constant is at least {SHORTEST_SETTLING:g} s, or 0 where nothing settles")
    return value


_TimeConstant = Annotated[float, Field(ge=0, le=1e4, strict=True), AfterValidator(_long_enough)]


class SettlingSettings(Settings):
    """A time constant for each direction, s; 0: nothing settles."""

    along: _TimeConstant
    across: _TimeConstant


def _both_from_number(value: Any) -> Any:
    """Convert a single number to a value for each direction."""
    return {"along": value, "across": value} if isinstance(value, int | float) else value


Pair = Annotated[AlongAcross, BeforeValidator(_both_from_number, json_schema_input_type=_Magnitude | AlongAcross)]
Settling = Annotated[
    SettlingSettings, BeforeValidator(_both_from_number, json_schema_input_type=_TimeConstant | SettlingSettings)
]

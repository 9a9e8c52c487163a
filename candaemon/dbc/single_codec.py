"""Single frames: each message becomes one Python function, generated from its layout at start.

The function converts the payload to one integer for each byte order in use and takes every signal from it by shift and
mask. What a signal does not need (sign, scale, offset, mask at the integer's top) is left out of the text. No name of
the DBC enters the text.
"""

from __future__ import annotations

import math
import operator
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final, cast

from candaemon.dbc import bits
from candaemon.dbc.bits import Gate
from candaemon.dbc.types import MessageSpec, SignalSpec
from candaemon.errors import ConfigError
from candaemon.printable import printable

Decoder = Callable[[bytes], "tuple[float, ...] | None"]
"""Payload → the signals' values; see `compile_decoder`."""

Encoder = Callable[[Sequence[float]], "tuple[bytes, int]"]
"""The signals' values → payload and number of values that were saturated; see `compile_encoder`."""

FLOAT_CODES: Final = {16: "<e", 32: "<f", 64: "<d"}


def compile_decoder(message: MessageSpec, signals: Iterable[str] | None = None) -> Decoder:
    """Generate the decoder of a message's single frames.

    Args:
        message: the layout.
        signals: the names wanted, in the order wanted; None for all of the message's.

    Returns:
        A function of the payload. It gives one value a signal as cantools' `decode(..., decode_choices=False)` does,
        integers exact; NaN for a signal that this frame does not carry, by its multiplexer or because its bits lie
        outside the message. It gives None for a payload shorter than `message.length`, and for a multiplexer value
        unknown to the DBC; a caller that counts distinguishes the two by `len(payload) < message.length`. Bytes beyond
        `message.length` are ignored. It raises on no bytes.

    Raises:
        ConfigError: the message lacks a signal.
    """
    wanted = message.select(signals)
    selectors = bits.multiplexers(message)
    carried = [s for s in (*wanted, *selectors) if bits.readable(message, s)]
    lines = ["def decode(data):", f" if len(data) < {message.length}: return None"]
    lines += [
        f' {order} = from_bytes(data[:{message.length}], "{order}")'
        for order in ("little", "big")
        if any(s.byte_order == order for s in carried)
    ]
    scope: dict[str, Any] = {"from_bytes": int.from_bytes, "nan": math.nan, "whole": _whole}
    conditions = _Conditions({selector.name: index for index, selector in enumerate(selectors)}, scope)
    for index, selector in enumerate(selectors):
        value = _value(message, selector, scope)
        if selector.is_float or not (bits.is_integral(selector.scale) and bits.is_integral(selector.offset)):
            value = f"whole({value})"
        scope[f"K{index}"] = bits.known_ids(message, selector)
        present = conditions.text(bits.gates(message, selector))
        lines += conditions.take()
        lines.append(f" m{index} = {value}")
        lines.append(f" if {present + ' and ' if present else ''}m{index} not in K{index}: return None")
    values = [_gated(message, signal, conditions, scope) for signal in wanted]
    lines += conditions.take()
    lines.append(f" return ({''.join(value + ', ' for value in values)})")
    return cast("Decoder", _build("decode", lines, scope, message))


def compile_field_reader(message: MessageSpec, signal: SignalSpec) -> Callable[[bytes], int]:
    """Make a function that reads one integer signal (a counter, an id) from a payload long enough.

    It gives −1 where the payload does not carry the signal.
    """
    byte, before = divmod(bits.first_bit(signal), 8)
    plain = not signal.signed and not signal.is_float and (signal.scale, signal.offset) == (1, 0)
    if plain and signal.multiplexer_signal is None and before + signal.length <= 8:
        if signal.length == 8:
            return operator.itemgetter(byte)
        shift = before if signal.byte_order == "little" else 8 - before - signal.length
        mask = (1 << signal.length) - 1
        return lambda data: data[byte] >> shift & mask
    decode = compile_decoder(message, [signal.name])

    def read(data: bytes) -> int:
        values = decode(data)
        return -1 if values is None or not math.isfinite(values[0]) else int(values[0])

    return read


def compile_encoder(message: MessageSpec, signals: Iterable[str] | None = None) -> Encoder:
    """Generate the encoder of a message's single frames.

    Args:
        message: the layout.
        signals: the names of the values that will be given, in their order; None for all of the message's.

    Returns:
        A function of the values, one a signal. It gives the payload of `message.length` bytes, rounded half to even as
        cantools does, bits of no given signal 0, and how many values were saturated: brought to the tighter of the
        signal's [min|max] and what its bits hold. ±inf goes to the nearer limit, NaN to the start value or else zero,
        brought into the limits; both count. A value whose multiplexer does not select it is ignored. Overlapping
        signals are or-ed.

    Raises:
        ConfigError: the message lacks a signal, or a signal cannot be encoded (outside the message, scale 0, or
            multiplexed by a signal that is not given).
    """
    given = encodable(message, signals)
    names = {signal.name for signal in given}
    selectors = {
        signal.name: index
        for index, signal in enumerate(each for each in bits.multiplexers(message) if each.name in names)
    }
    scope: dict[str, Any] = {"from_bytes": int.from_bytes, "settle": _settle, "whole": _whole}
    conditions = _Conditions(selectors, scope)
    column = {signal.name: f"v{index}" for index, signal in enumerate(given)}
    lines = ["def encode(values):", *([f" {', '.join(column.values())}, = values"] if given else [])]
    lines.append(" little = big = saturated = 0")
    for signal in sorted(given, key=lambda s: (len(bits.gates(message, s) or ()), s.name not in selectors)):
        condition = conditions.text(bits.gates(message, signal))
        lines += conditions.take()
        indent = "  " if condition else " "
        lines += [f" if {condition}:"] if condition else []
        lines += [indent + text for text in _encoding(message, signal, column[signal.name], scope)]
        if signal.name in selectors:
            value = _scaled(signal, "x" if signal.is_float else "r")
            lines.append(f"{indent}m{selectors[signal.name]} = whole({value})")
    if {signal.byte_order for signal in given} == {"little", "big"}:
        lines.append(f' big |= from_bytes(little.to_bytes({message.length}, "little"), "big")')
    order = "big" if any(signal.byte_order == "big" for signal in given) else "little"
    lines.append(f' return {order}.to_bytes({message.length}, "{order}"), saturated')
    return cast("Encoder", _build("encode", lines, scope, message))


def encodable(message: MessageSpec, signals: Iterable[str] | None) -> tuple[SignalSpec, ...]:
    """Select the signals and make sure that each can be encoded.

    Raises:
        ConfigError: the message lacks one, or one cannot be encoded.
    """
    given = message.select(signals)
    names = {signal.name for signal in given}
    for signal in given:
        chain = bits.gates(message, signal)
        reason = None
        if not bits.readable(message, signal):
            reason = f"its bits lie outside the {message.length} bytes of the message"
        elif signal.scale == 0:
            reason = "its scale is 0"
        elif chain is None:
            reason = f"no frame carries it, as its multiplexer '{signal.multiplexer_signal}' is not one"
        elif missing := [gate.multiplexer for gate in chain if gate.multiplexer not in names]:
            reason = f"it is selected by '{missing[0]}', which must be given too"
        if reason is not None:
            raise ConfigError(
                f"signal '{signal.name}' of message '{message.name}' cannot be encoded: {reason}",
                file=message.file,
                line=signal.line or message.line or None,
            )
    return given


class _Conditions:
    """Names each distinct chain of gates once, as a local boolean `g…` of the generated function.

    Args:
        index: number of each multiplexer by name, in its local `m…`.
        scope: the function's globals.
    """

    def __init__(self, index: Mapping[str, int], scope: dict[str, Any]) -> None:
        self._index = index
        self._scope = scope
        self._names: dict[tuple[Gate, ...], str] = {}
        self._lines: list[str] = []

    def text(self, chain: tuple[Gate, ...] | None) -> str:
        """Name the condition: "" for none at all; its computation waits in `take`."""
        if not chain:
            return ""
        if chain not in self._names:
            outer, (multiplexer, ids) = self.text(chain[:-1]), chain[-1]
            name = f"g{len(self._names)}"
            self._names[chain] = name
            if len(ids) == 1:
                test = f"m{self._index[multiplexer]} == {next(iter(ids))}"
            else:
                self._scope[f"I{name}"] = ids
                test = f"m{self._index[multiplexer]} in I{name}"
            self._lines.append(f" {name} = {outer + ' and ' if outer else ''}{test}")
        return self._names[chain]

    def take(self) -> list[str]:
        """Return the lines that compute the conditions named since the last call."""
        lines, self._lines = self._lines, []
        return lines


def _gated(message: MessageSpec, signal: SignalSpec, conditions: _Conditions, scope: dict[str, Any]) -> str:
    chain = bits.gates(message, signal)
    if chain is None or not bits.readable(message, signal):
        return "nan"
    condition = conditions.text(chain)
    value = _value(message, signal, scope)
    return f"{value} if {condition} else nan" if condition else value


def _value(message: MessageSpec, signal: SignalSpec, scope: dict[str, Any]) -> str:
    """Text of a signal's value: its raw bits, sign or float, then the cheapest scaling that does."""
    below = bits.shift(message, signal)
    raw = f"{signal.byte_order} >> {below}" if below else signal.byte_order
    if below + signal.length < 8 * message.length:
        raw = f"{raw} & {(1 << signal.length) - 1}"
    if signal.is_float:
        code = f"unpack{signal.length}"
        scope[code] = struct.Struct(FLOAT_CODES[signal.length]).unpack
        return _scaled(signal, f'{code}(({raw}).to_bytes({signal.length // 8}, "little"))[0]')
    if signal.signed:
        sign = 1 << signal.length - 1
        return _scaled(signal, f"((({raw}) ^ {sign}) - {sign})")
    return _scaled(signal, f"({raw})")


def _scaled(signal: SignalSpec, raw: str) -> str:
    scale = "" if signal.scale == 1 else f" * {_literal(signal.scale)}"
    offset = "" if signal.offset == 0 else f" + {_literal(signal.offset)}"
    return raw + scale + offset


def _literal(number: float) -> str:
    """Write whole scales of integers as int, so that 64-bit values stay exact."""
    return f"({int(number) if bits.is_integral(number) else number!r})"


def _encoding(message: MessageSpec, signal: SignalSpec, value: str, scope: dict[str, Any]) -> list[str]:
    """Lines that turn a value into raw `r` and set its bits."""
    low, high = bits.sendable_raw(signal)
    offset = "" if signal.offset == 0 else f" - {_literal(signal.offset)}"
    scale = "" if signal.scale == 1 else f" / {_literal(signal.scale)}"
    fallback, below = bits.raw_fallback(signal), bits.shift(message, signal)
    lines = [f"x = ({value}{offset}){scale}"]
    settle = f"settle(x, {low!r}, {high!r}, {fallback!r}, {not signal.is_float})"
    if signal.is_float:
        scope[f"pack{signal.length}"] = struct.Struct(FLOAT_CODES[signal.length]).pack
        lines.append(f"if not {low!r} <= x <= {high!r}: x, s = {settle}; saturated += s")
        lines.append(f'r = from_bytes(pack{signal.length}(x), "little")')
    else:
        lines.append(f"if {low!r} <= x <= {high!r}: r = round(x)")
        lines.append(f"else: r, s = {settle}; saturated += s")
    raw = f"(r & {(1 << signal.length) - 1})" if signal.signed and not signal.is_float else "r"
    lines.append(f"{signal.byte_order} |= {raw} << {below}" if below else f"{signal.byte_order} |= {raw}")
    return lines


def _settle(x: float, low: float, high: float, fallback: float, integral: bool) -> tuple[float, int]:
    """Bring a raw value outside [low, high] into it; return with it whether that changed more than rounding would."""
    if math.isnan(x):
        return fallback, 1
    if integral and math.isfinite(x) and low <= round(x) <= high:
        return round(x), 0
    return (low, 1) if x < low else (high, 1)


def _whole(value: float) -> int | None:
    """Truncate a multiplexer's value; None for one that is not a finite number."""
    return int(value) if math.isfinite(value) else None


def _build(name: str, lines: Sequence[str], scope: dict[str, Any], message: MessageSpec) -> object:
    code = compile("\n".join(lines), f"<codec of {printable(message.name)}>", "exec")
    exec(code, scope)  # noqa: S102 - the text is made above, of numbers from checked layouts alone
    return scope[name]

"""Writes whole messages from quantities: headers, triggers and the messages of the ego's sensors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from candaemon.arrays import Floats
from candaemon.dbc.batch_codec import BatchEncoder
from candaemon.dbc.types import MessageSpec
from candaemon.objects.signals import SignalBinding


class MessageWriter:
    """Writes one message; signals not named are sent as 0.

    Args:
        message: its layout.
        bindings: the quantities in it, in the order of the rows to write.
        fixed: signal → constant value, in the DBC's unit.

    """

    def __init__(
        self, message: MessageSpec, bindings: Sequence[SignalBinding], fixed: Mapping[str, float] | None = None
    ) -> None:
        fixed = fixed or {}
        named = [*(binding.signal.name for binding in bindings), *fixed]
        self.message = message
        self._encoder = BatchEncoder(message, named)
        self._gain = np.array([[binding.gain] for binding in bindings]).reshape(-1, 1)
        self._bias = np.array([[binding.bias] for binding in bindings]).reshape(-1, 1)
        self._fixed = np.array([[value] for value in fixed.values()]).reshape(-1, 1)

    def payloads(self, values: Floats) -> list[bytes]:
        """Return n payloads of quantities in SI units, shape (bindings, n)."""
        count = values.shape[1]
        rows = np.concatenate([(values - self._bias) / self._gain, np.repeat(self._fixed, count, axis=1)])
        coded, _ = self._encoder.encode(rows)
        joined, length = coded.tobytes(), self.message.length
        return [joined[k * length : (k + 1) * length] for k in range(count)]

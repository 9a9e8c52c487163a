"""Receive time stamps of SocketCAN, as SO_TIMESTAMPING gives them."""

from __future__ import annotations

from typing import Final, Literal

SO_TIMESTAMPING: Final = 37
RX_HARDWARE: Final = 1 << 2
RX_SOFTWARE: Final = 1 << 3
SOFTWARE: Final = 1 << 4
RAW_HARDWARE: Final = 1 << 6

_WINDOW_NS: Final = 1_000_000_000
_STEP_NS: Final = 100_000_000


class HardwareClockOffset:
    """Brings a controller's time stamps to the system's clock, whatever it counts from.

    A frame reaches the kernel some time after the controller has stamped it, but never before. So the least difference
    of the two clocks is the offset between them, and what a frame has more of it is its delay on the way, which is what
    a time stamp of hardware is free of. The least of one to two seconds is taken, so that it follows the drift. Time
    does not run backwards where the offset shrinks.

    A difference that is off by more than 0.1 s is a clock that was set, or a controller that was started anew: the
    offset is found afresh.
    """

    def __init__(self) -> None:
        self._least_ns = self._former_ns = 0
        self._since_ns: int | None = None
        self._last_ns = 0

    def system_ns(self, hardware_ns: int, kernel_ns: int) -> int:
        """Return a frame's time in the system's clock, in ns.

        Args:
            hardware_ns: the controller's time stamp.
            kernel_ns: the kernel's.
        """
        offset_ns = kernel_ns - hardware_ns
        if self._since_ns is None or abs(offset_ns - min(self._least_ns, self._former_ns)) > _STEP_NS:
            self._least_ns = self._former_ns = offset_ns
            self._since_ns = hardware_ns
            self._last_ns = kernel_ns
            return kernel_ns
        if hardware_ns - self._since_ns > _WINDOW_NS:
            self._former_ns, self._least_ns, self._since_ns = self._least_ns, offset_ns, hardware_ns
        self._least_ns = min(self._least_ns, offset_ns)
        time_ns = hardware_ns + min(self._least_ns, self._former_ns)
        self._last_ns = max(time_ns, self._last_ns)
        return self._last_ns


def timestamping_flags(kind: Literal["hardware", "kernel"]) -> int:
    """Return SO_TIMESTAMPING's flags: the kernel's time stamps always, and the controller's where they are wanted."""
    kernel = RX_SOFTWARE | SOFTWARE
    return kernel if kind == "kernel" else kernel | RX_HARDWARE | RAW_HARDWARE

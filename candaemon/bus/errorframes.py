"""Error frames of SocketCAN: what a CAN controller says of the bus and of itself.

Bits and bytes after linux/can/error.h.
"""

from __future__ import annotations

from candaemon.bus.ports import BusCounts, Controller

ERROR_FLAG = 0x2000_0000
"""CAN_ERR_FLAG in the identifier of an error frame."""
EVERY_ERROR = 0x1FFF_FFFF
"""CAN_ERR_MASK: the filter that takes every class of error."""

_LOST_ARBITRATION = 0x002
_CONTROLLER = 0x004
_NO_ACKNOWLEDGE = 0x020
_BUS_OFF = 0x040
_RESTARTED = 0x100

_OVERFLOW = 0x03  # CAN_ERR_CRTL_RX_OVERFLOW | CAN_ERR_CRTL_TX_OVERFLOW, in byte 1
_WARNING = 0x0C
_PASSIVE = 0x30
_ACTIVE = 0x40


def take_error(can_id: int, data: bytes, counts: BusCounts, before: Controller) -> Controller:
    """Count what an error frame tells.

    Args:
        can_id: with the classes of error in its bits.
        data: its 8 bytes; byte 1 details a problem of the controller.
        counts: counted there.
        before: state of the controller up to this frame.

    Returns:
        state of the controller from this frame on.
    """
    counts.error_frames += 1
    if can_id & _LOST_ARBITRATION:
        counts.arbitration_lost += 1
    if can_id & _NO_ACKNOWLEDGE:
        counts.no_acknowledge += 1
    if can_id & _BUS_OFF:
        counts.bus_off += 1
        return "bus-off"
    if can_id & _RESTARTED:
        counts.restarts += 1
        return "active"
    return _controller_state(data[1], counts, before) if can_id & _CONTROLLER else before


def _controller_state(detail: int, counts: BusCounts, before: Controller) -> Controller:
    """Count a problem of the controller; return its state."""
    if detail & _OVERFLOW:
        counts.controller_overflows += 1
    if detail & _PASSIVE:
        counts.error_passive += before != "passive"
        return "passive"
    if detail & _WARNING:
        counts.error_warning += before != "warning"
        return "warning"
    return "active" if detail & _ACTIVE else before

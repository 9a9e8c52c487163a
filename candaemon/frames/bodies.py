"""Names by which obstacles, tables and scenarios describe the body of a road user."""

from __future__ import annotations

from typing import Final

BODY: Final = ("heading", "yaw_rate", "length", "width", "center_x", "center_y")
"""Direction of the body's x axis (rad, in vehicle axes, positive to the left), its yaw rate over ground (rad/s), the
size of its box (m), and the box's centre (m, vehicle axes)."""

CLASSES: Final = ("unknown", "car", "truck", "two-wheeler", "pedestrian", "standing")
"""What an obstacle can be, each with its index as code; `standing` is what is no road user: a post, a rail, a drain."""

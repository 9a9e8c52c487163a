"""Obstacles into slots, slots into frames."""

"""Metrics of tracks, against truth and without it, and the tables that hold them.

Knows nothing of the bus.
"""

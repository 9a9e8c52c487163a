"""Recorded logs by format: candump text decoded in blocks, and the formats that python-can reads and writes.

Knows nothing of live buses.
"""

"""Recorded logs by format: candump text in blocks, and what python-can reads and writes.

Knows nothing of live buses.
"""

"""The experiments of the five papers, run again beside their printed tables.

Knows nothing of the bus.
"""

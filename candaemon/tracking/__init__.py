"""Identity over time: association, initiation, reflections of one obstacle, life cycle, what is reported of it.

Knows nothing of CAN and DBC files.
"""

"""Frames in and out: live buses, ports, SocketCAN, python-can's interfaces, the transmit queue, order in time, logs.

Knows nothing of DBC files, objects and tracks.
"""

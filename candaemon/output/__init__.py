"""Obstacles → output slots → quantities → frames, and decoding of these frames for readers of the bus.

Knows nothing of estimation, sockets and clocks.
"""

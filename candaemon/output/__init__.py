"""Obstacles → output slots → quantities → frames, and back again for who listens.

Knows nothing of estimation, sockets and clocks.
"""

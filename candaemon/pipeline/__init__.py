"""The way of a frame as one picture: scans, ego motion, tracking, output; a cycle's results and counts.

Knows nothing of sockets and clocks.
"""

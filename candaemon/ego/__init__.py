"""Ego motion: from an INS or odometry, with biases; the pose at any instant; the local frame's place on earth.

Knows nothing of objects and tracks.
"""

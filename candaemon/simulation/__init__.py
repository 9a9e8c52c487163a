"""A scenario into truth, detections and the frames of any configured sensor.

Knows nothing of tracking and estimation.
"""

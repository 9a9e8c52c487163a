"""A scenario into truth, detections and the frames of any configured sensor.

Knows nothing of tracking, and of estimation only which point of a body the reference point is.
"""

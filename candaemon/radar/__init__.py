"""Frames of a sensor into scans, scans into detections: what closes a scan, mounting, plausibility, valid-frame ratio.

Knows nothing of identity and of files.
"""

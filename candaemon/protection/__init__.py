"""What says whether a frame is valid: counters, checksums, AUTOSAR E2E, rates and silence.

Knows nothing of objects and tracks.
"""

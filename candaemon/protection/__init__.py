"""What says whether a frame can be believed: counters, checksums, AUTOSAR E2E, rates and silence.

Knows nothing of objects and tracks.
"""

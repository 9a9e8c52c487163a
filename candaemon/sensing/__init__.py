"""Signals into measurements: scans, own motion, mounting. Knows nothing of tracks and CAN identifiers."""

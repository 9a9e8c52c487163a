"""Metrics of tracks, against truth and without it. Knows nothing of the bus."""

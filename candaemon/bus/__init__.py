"""Frames: DBC files, codecs, logs, live buses, protection. Knows nothing of objects and tracks."""

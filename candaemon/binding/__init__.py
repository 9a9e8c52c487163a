"""Settings × DBC, once at start: every name checked, with file and line, and resolved to a codec's column.

Nothing of it runs per frame. Knows nothing of sockets and tracks.
"""

"""The YAML as typed, frozen settings with file and line, and the configurations that come with candaemon.

Knows nothing of DBC files, sockets and tracks.
"""

"""The YAML file as typed, frozen settings with file and line, and the configurations shipped with candaemon.

Knows nothing of DBC files, sockets and tracks.
"""

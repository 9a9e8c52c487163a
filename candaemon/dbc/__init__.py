"""A DBC file as types and bit layouts: tolerant loading and repair, and codecs for one frame or a whole batch.

Knows nothing of objects and tracks, of sockets and of the YAML.
"""

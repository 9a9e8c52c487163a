"""The payloads of a scan ⇄ its objects as arrays, vectorised, for reading and for writing alike.

Knows nothing of tracks, sockets and the daemon.
"""

"""The ring of what the service took of late, and the archive of what happened around an event.

Knows nothing of mathematics and of sockets.
"""

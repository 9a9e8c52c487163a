"""What crosses borders: a CAN frame, a tick of time, frames read or to be sent at once, names of a body's quantities.

Knows nothing of DBC files, sockets, sensors and tracks.
"""

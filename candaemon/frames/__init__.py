"""What crosses every border: a CAN frame, a tick of time, a block of frames read at once, a batch of frames to send.

Knows nothing of DBC files, sockets, sensors and tracks.
"""

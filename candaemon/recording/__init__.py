"""The ring of what the service took of late, and the archive of what happened around an event.

What a recording did is counted in `RecordingCounts` and nowhere else: each frame and tick that it was given is written,
lost, or waits still. Messages, status and metrics take their figures from there.

Knows nothing of mathematics and of sockets.
"""

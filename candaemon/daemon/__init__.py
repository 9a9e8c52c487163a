"""The core loop on live buses: lifecycle, signals, reload, systemd, the service's log.

Knows nothing of mathematics.
"""

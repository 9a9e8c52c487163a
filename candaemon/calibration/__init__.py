"""Self-calibration: latency and yaw of each sensor, speed scale and yaw rate bias, from what stands still.

Knows nothing of CAN, DBC files or the state of any filter.
"""

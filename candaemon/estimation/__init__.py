"""Motion models and filters: pure numpy, batched over tracks. Kalman, IMM, information, adaptive, federated, smoothing.

Knows nothing of CAN, identity, configuration files and sensors.
"""

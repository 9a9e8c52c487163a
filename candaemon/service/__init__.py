"""The service: lifecycle, signals, supervision. Knows nothing of mathematics."""

"""candaemon side by side with the naive chain: `python -m tests.benchmarks` prints it, pytest holds it."""

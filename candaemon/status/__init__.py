"""One model of how the service is: its status socket, the metrics endpoint, the health summary.

Knows nothing of mathematics and of the terminal.
"""

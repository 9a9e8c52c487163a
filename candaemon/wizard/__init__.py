"""From a strange radar's DBC files and a log to a configuration, with the evidence for each line.

Knows nothing of terminals and live buses.
"""

"""A drive as files of other tools: columns in Parquet, messages in MCAP.

Knows nothing of logs, clocks and commands.
"""

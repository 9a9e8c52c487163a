"""A recorded drive through the pipeline: logs or recordings in; obstacles, tables and figures out.

Knows nothing of live buses.
"""

"""Many drives: spread over processes and machines, kept as one dataset, reported and compared.

Knows nothing of live buses, or of what the tables of a drive hold beyond the names of their columns.
"""

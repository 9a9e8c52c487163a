"""A drive as one page that needs nothing else: figures, drawings, worst moments.

Knows nothing of live buses.
"""

"""Files that are written whole or not at all, and folders that are made ready for them.

Knows nothing of what the files hold.
"""

"""The commands, one short file each, and their output on a terminal or into a pipe.

Knows nothing but the calls it makes.
"""

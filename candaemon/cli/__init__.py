"""The commands: one short file each, and what they print on a terminal or into a pipe.

Knows nothing but the calls it makes.
"""

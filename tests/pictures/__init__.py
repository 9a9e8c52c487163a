"""The pictures of the documentation: made by the commands themselves, and known by what they show.

`python -m tests.pictures` makes them anew; a test compares digests of the data drawn, not pixels.
"""

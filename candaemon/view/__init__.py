"""What people look at: the scene of each cycle, a page in the browser that draws it, and a picture made of characters.

A *picture* is one cycle as it is drawn. A source makes pictures of live buses or of a log, a store keeps them, and each
browser plays them at its own pace. It runs in a process of its own: the service never waits for a picture.

Knows nothing of how filters work, of files that are written, and of the command line.
"""

"""`python -m candaemon`."""

from __future__ import annotations

import sys

from candaemon.cli.main import main

if __name__ == "__main__":
    sys.exit(main())

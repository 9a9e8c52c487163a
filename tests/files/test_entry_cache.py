"""Where entries of caches are kept; how, is tested with DBC files and configurations."""

from __future__ import annotations

from pathlib import Path

from candaemon.files.entry_cache import cache_folder


def test_where_the_cache_is() -> None:
    assert cache_folder("dbc", {"CACHE_DIRECTORY": "/c/a:/c/b", "XDG_CACHE_HOME": "/x", "HOME": "/h"}) == Path(
        "/c/a/dbc"
    )
    assert cache_folder("dbc", {"XDG_CACHE_HOME": "/x", "HOME": "/h"}) == Path("/x/candaemon/dbc")
    assert cache_folder("dbc", {"XDG_CACHE_HOME": "relative", "HOME": "/h"}) == Path("/h/.cache/candaemon/dbc")
    assert cache_folder("dbc", {}) is None

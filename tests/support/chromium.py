"""A real browser: Debian's Chromium without a screen, driven by Playwright."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import pytest

from tests.beds.outside import REQUIRE

EXECUTABLE = shutil.which("chromium") or "/usr/bin/chromium"
_WAIT_MS = 60_000
"""How long a busy machine may take for anything."""


@dataclass
class Tab:
    """A page, and what it did beside what was asked of it.

    Attributes:
        page: as Playwright drives it.
        errors: that it wrote to its console, or raised.
        asked: addresses that it asked for.
    """

    page: Any
    errors: list[str] = field(default_factory=list)
    asked: list[str] = field(default_factory=list)

    def table(self) -> list[list[str]]:
        """Return the rows of the table of obstacles."""
        found: list[list[str]] = self.page.evaluate(
            "[...document.querySelectorAll('#obstacles tbody tr')].map(r => [...r.cells].map(c => c.textContent))"
        )
        return found

    def shown(self) -> dict[str, float]:
        """Return where the canvas draws what: scale and origin in px, and the time of the picture."""
        data = self.page.evaluate("({...document.getElementById('road').dataset})")
        return {name: float(data[name] or "nan") for name in ("scale", "cx", "cy", "time")}

    def do(self, script: str, argument: Any = None) -> Any:
        """Run a script in the page."""
        return self.page.evaluate(script, argument)

    def wait(self, condition: str, argument: Any = None) -> None:
        """Wait until a condition holds in the page."""
        end_s = time.monotonic() + _WAIT_MS / 1e3
        while not self.page.evaluate(condition, argument):  # the page's policy forbids what Playwright would wait by
            assert time.monotonic() < end_s, (condition, argument)
            self.page.wait_for_timeout(20)

    def seek(self, time_s: float) -> None:
        """Move the slider to a time from the beginning, and wait until the page shows it.

        Args:
            time_s: s from the beginning.
        """
        self.do(
            "t => { const s = document.getElementById('seek'); s.value = t;"
            " s.dispatchEvent(new Event('input')); s.dispatchEvent(new Event('change')); }",
            time_s,
        )


@contextmanager
def chromium() -> Iterator[Any]:
    """Start Chromium; skip where there is none, unless the environment says that there must be one."""
    sync_api = pytest.importorskip("playwright.sync_api")
    if shutil.which(EXECUTABLE) is None:
        message = "no Chromium: apt install chromium"
        if os.environ.get(REQUIRE):
            pytest.fail(message)
        pytest.skip(message)
    rules = "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"
    quiet = ["--disable-background-networking", "--disable-component-update", "--no-first-run"]
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=EXECUTABLE, args=["--no-sandbox", rules, *quiet])
        try:
            yield browser
        finally:
            browser.close()


@contextmanager
def tab(
    browser: Any, url: str, *, width: int = 1280, height: int = 800, dark: bool = False, touch: bool = False
) -> Iterator[Tab]:
    """Open a page in a browser that knows of no other page."""
    context = browser.new_context(
        viewport={"width": width, "height": height}, color_scheme="dark" if dark else "light", has_touch=touch
    )
    try:
        page = context.new_page()
        page.set_default_timeout(_WAIT_MS)
        opened = Tab(page)
        page.on("console", lambda said: opened.errors.append(said.text) if said.type in {"error", "warning"} else None)
        page.on("pageerror", lambda error: opened.errors.append(str(error)))
        page.on("request", lambda request: opened.asked.append(request.url))
        page.on("websocket", lambda socket: opened.asked.append(socket.url))
        page.goto(url)
        page.wait_for_selector("#obstacles tbody tr")
        yield opened
    finally:
        context.close()

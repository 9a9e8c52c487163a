"""The pages of the documentation, as text and as blocks of code."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from tests.support.paths import ROOT

BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
INLINE = re.compile(r"`([^`\n]+)`")


@dataclass(frozen=True, slots=True)
class Page:
    """A page of Markdown.

    Attributes:
        name: path below the project's root.
        text: all of it.
    """

    name: str
    text: str

    @property
    def path(self) -> Path:
        return ROOT / self.name

    def blocks(self, kind: str) -> list[str]:
        """Return the code blocks of a language."""
        return [block for language, block in BLOCK.findall(self.text) if language == kind]

    def commands(self) -> list[str]:
        """Return the lines of all blocks of shell commands."""
        return [line for block in self.blocks("sh") for line in block.splitlines() if line.strip()]

    def inline(self) -> list[str]:
        """Return what stands as code within the text."""
        return INLINE.findall(BLOCK.sub("", self.text))


def _page(path: Path) -> Page:
    return Page(path.relative_to(ROOT).as_posix(), path.read_text(encoding="utf-8"))


PAGES = {
    page.name: page
    for page in map(_page, [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))])
}
"""Every page by its name."""

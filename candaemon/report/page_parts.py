"""What the pages of reports are made of: the page itself, tiles, tables, drawings with captions."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Sequence
from html import escape
from typing import Any

from candaemon.report.page_style import SCRIPT, STYLE


def whole_page(title: str, sections: Sequence[tuple[str, str]], name: str, figures: Any) -> str:
    """Return a page of HTML that fetches nothing.

    Args:
        title: of the page.
        sections: headings, each with its content as HTML.
        name: of the figures in the page.
        figures: for programs, as JSON.
    """
    anchors = [heading.lower().split(",")[0].replace(" ", "-") for heading, _ in sections]
    links = " · ".join(
        f'<a href="#{anchor}">{escape(heading)}</a>' for anchor, (heading, _) in zip(anchors, sections, strict=True)
    )
    body = "".join(
        f'<section id="{anchor}"><h2>{escape(heading)}</h2>{content}</section>'
        for anchor, (heading, content) in zip(anchors, sections, strict=True)
    )
    whole = json.dumps(figures, allow_nan=False, ensure_ascii=False).replace("<", "\\u003c")
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none';style-src 'unsafe-inline';"
        "script-src 'unsafe-inline'\">"
        f"<title>{escape(title)}</title><style>{STYLE}</style></head><body>"
        f"<h1>{escape(title)}</h1><nav>{links}</nav>{body}"
        f'<script type="application/json" id="{name}">{whole}</script><script>{SCRIPT}</script></body></html>\n'
    )


def tile(value: str, about: str) -> str:
    """Return a figure with what it is."""
    return f'<div class="tile"><b>{value}</b><span>{about}</span></div>'


def table(head: Sequence[str], rows: Iterable[Sequence[str]], text: Collection[str] = ()) -> str:
    """Return a table of cells that are HTML; the first column is text, and those named, the others are numbers."""
    kinds = ["" if k == 0 or name in text else " class=n" for k, name in enumerate(head)]
    top = "".join(f"<th{kind}>{cell}</th>" for kind, cell in zip(kinds, head, strict=True))
    lines = (
        "<tr>" + "".join(f"<td{kind}>{cell}</td>" for kind, cell in zip(kinds, row, strict=True)) + "</tr>"
        for row in rows
    )
    return f"<table><tr>{top}</tr>{''.join(lines)}</table>"


def drawn(svg: str, caption: str) -> str:
    """Return a drawing with its caption."""
    return f"<figure>{svg}<figcaption>{caption}</figcaption></figure>"

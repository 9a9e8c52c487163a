"""How a report looks: light, dark, and on paper; the colours are those of all drawings."""

from __future__ import annotations

from typing import Final

from candaemon.exports.palette import SERIES, STATES

_LIGHT: Final = "--paper:#ffffff;--ink:#1c1e21;--soft:#5c6370;--grid:#e3e6ea;--card:#f5f6f8"
_DARK: Final = "--paper:#15171a;--ink:#e8eaed;--soft:#a0a6b0;--grid:#2c3036;--card:#1e2125"

STYLE: Final = (
    f":root{{color-scheme:light dark;{_LIGHT}}}"
    f"@media (prefers-color-scheme:dark){{:root{{{_DARK}}}}}"
    f"@media print{{:root{{color-scheme:light;{_LIGHT}}}section{{break-inside:avoid}}nav,.screen{{display:none}}}}"
    "body{margin:0 auto;max-width:1000px;padding:1rem;background:var(--paper);color:var(--ink);"
    "font:15px/1.45 'DejaVu Sans',system-ui,sans-serif}"
    "h1{font-size:1.5rem;margin:.2rem 0}h2{font-size:1.15rem;margin:2rem 0 .5rem;border-bottom:1px solid var(--grid)}"
    "p,figcaption{color:var(--soft);margin:.3rem 0}figure{margin:0 0 1rem}svg{width:100%;height:auto;display:block}"
    "svg text{font:11px 'DejaVu Sans',system-ui,sans-serif;fill:var(--soft)}"
    ".grid{stroke:var(--grid);stroke-width:1}.tiles{display:grid;gap:.6rem;"
    "grid-template-columns:repeat(auto-fit,minmax(175px,1fr))}.tile{background:var(--card);padding:.6rem .8rem;"
    "border-radius:6px}.tile b{display:block;font-size:1.35rem;font-weight:600}.tile span{color:var(--soft)}"
    "table{border-collapse:collapse;width:100%;font-variant-numeric:tabular-nums}th,td{text-align:left;"
    "padding:.2rem .6rem .2rem 0;border-bottom:1px solid var(--grid)}td.n,th.n{text-align:right}"
    "pre{background:var(--card);padding:.8rem;overflow:auto;font-size:12px;white-space:pre-wrap}"
    "button{font:inherit;color:inherit;background:var(--card);border:1px solid var(--grid);border-radius:4px;"
    "cursor:pointer}a{color:inherit}"
    ".own{stroke:var(--ink);color:var(--ink)}.own.fill{fill:var(--ink);stroke:none}"
    ".others{stroke:" + SERIES[0] + ";opacity:.55}"
    ".first{stroke:" + SERIES[0] + "}.second{stroke:" + SERIES[1] + "}.third{stroke:" + SERIES[2] + "}"
    "i.first{background:" + SERIES[0] + "}i.second{background:" + SERIES[1] + "}i.third{background:" + SERIES[2] + "}"
    ".first.fill{fill:" + SERIES[0] + "}.expected{stroke:var(--soft)}.band{stroke:none;opacity:.3}"
    ".band.expected{fill:" + SERIES[4] + "}.fill{stroke:none}"
    + "".join(f".{name}.fill,i.{name}{{fill:{colour};background:{colour}}}" for name, colour in
              zip(("tentative", "confirmed", "coasting"), STATES, strict=True))
    + "i{display:inline-block;width:.8em;height:.8em;border-radius:2px;margin:0 .3em 0 .8em}"
)  # fmt: skip
"""The page's style sheet."""

SCRIPT: Final = (
    "for(const b of document.querySelectorAll('button[data-at]'))b.onclick=()=>"
    "window.open(document.getElementById('view').value+b.dataset.at,'candaemon-view')"
)
"""Opens the view at a moment, at the address that stands on the page; nothing is fetched from anywhere."""

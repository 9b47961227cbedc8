"""The fit report: one HTML page without outside files, words before numbers, and the same numbers as JSON."""

from __future__ import annotations

import base64
import html
from collections.abc import Sequence
from typing import Any

STYLE = (
    "body{font:15px/1.5 system-ui,sans-serif;color:#222;max-width:64rem;margin:2rem auto;padding:0 1rem}"
    "h1{font-size:1.7rem}h2{font-size:1.2rem;margin-top:2.2rem;border-bottom:1px solid #ddd}"
    "img{max-width:100%}figcaption{color:#555;font-size:.9rem}figure{margin:1rem 0}"
    "table{border-collapse:collapse;font-size:.9rem}td,th{padding:.15rem .7rem;border-bottom:1px solid #e5e5e5;"
    "text-align:right;white-space:nowrap}td:first-child,th:first-child{text-align:left}td:first-child{white-space:normal}"
    ".warn{background:#fff4d6;border-left:4px solid #d90;padding:.4rem .9rem;margin:.4rem 0}"
    ".good{background:#e9f6ec;border-left:4px solid #3a5;padding:.4rem .9rem;margin:.4rem 0}"
    "figure svg{max-width:100%;height:auto}.sign{display:flex;gap:2rem;margin:3rem 0 1rem}"
    ".sign div{flex:1;border-top:1px solid #222;font-size:.9rem;color:#555}"
    "@media print{body{margin:0;max-width:none}figure,tr,.warn,.good{break-inside:avoid}figure svg{max-width:none}}"
)


class Page:
    """A page that grows section by section."""

    def __init__(self, title: str) -> None:
        self.title = title
        self._parts = [f"<h1>{html.escape(title)}</h1>"]

    def section(self, title: str) -> None:
        """A heading."""
        self._parts.append(f"<h2>{html.escape(title)}</h2>")

    def say(self, *sentences: str) -> None:
        """A paragraph."""
        self._parts.append(f"<p>{html.escape(' '.join(sentences))}</p>")

    def notes(self, lines: Sequence[str], *, good: bool = False) -> None:
        """A box for each line: what to look at, or with ``good`` what is well."""
        kind = "good" if good else "warn"
        self._parts += [f'<div class="{kind}">{html.escape(line)}</div>' for line in lines]

    def picture(self, payload: bytes, caption: str) -> None:
        """A PNG inside the page."""
        data = base64.b64encode(payload).decode("ascii")
        text = html.escape(caption)
        self._parts.append(
            f'<figure><img src="data:image/png;base64,{data}" alt="{text}"><figcaption>{text}</figcaption></figure>'
        )

    def drawing(self, svg: str, caption: str) -> None:
        """An SVG drawing inside the page, as text that this program wrote."""
        self._parts.append(f"<figure>{svg}<figcaption>{html.escape(caption)}</figcaption></figure>")

    def signature(self, fields: Sequence[str]) -> None:
        """A line to be filled in by hand for each of ``fields``."""
        cells = "".join(f"<div>{html.escape(field)}</div>" for field in fields)
        self._parts.append(f'<div class="sign">{cells}</div>')

    def table(self, heads: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
        """A table; the first column is text."""
        top = "".join(f"<th>{html.escape(head)}</th>" for head in heads)
        body = "".join("<tr>" + "".join(f"<td>{html.escape(str(cell))}</td>" for cell in row) + "</tr>" for row in rows)
        self._parts.append(f"<table><tr>{top}</tr>{body}</table>")

    def text(self) -> str:
        """The whole page."""
        head = f'<meta charset="utf-8"><title>{html.escape(self.title)}</title><style>{STYLE}</style>'
        return f'<!doctype html><html lang="en"><head>{head}</head><body>{"".join(self._parts)}</body></html>\n'

"""The HTML elements that every section is made of; all text from outside is escaped here."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path


@dataclass(frozen=True)
class Cell:
    """A table cell: text, before a bar of length `share` (0 to 1) when that is given."""

    text: str
    share: float | None = None
    kind: str = ""


def text(value: object) -> str:
    """Convert a value to escaped text."""
    return escape(str(value), quote=True)


def prose(value: object) -> str:
    """A sentence as escaped text, with what stands between backticks as code."""
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", text(value))


def number(value: float | int | None, digits: int = 2) -> str:
    """Format a number with `digits` decimals and thin spaces at thousands; an en dash for None or NaN."""
    if value is None or value != value:
        return "–"
    return f"{value:,.{digits}f}".replace(",", "\u202f")


def table(
    header: Sequence[str], rows: Sequence[Sequence[str | Cell]], *, left: int = 1, kinds: Sequence[str] = ()
) -> str:
    """A table; the first `left` columns are text, the others numbers. `kinds` are classes of the rows."""
    head = "".join(f"<th{_align(i, left)}>{text(title)}</th>" for i, title in enumerate(header))
    body = []
    for n, row in enumerate(rows):
        cells = "".join(_cell(value, _align(i, left)) for i, value in enumerate(row))
        kind = f' class="{text(kinds[n])}"' if n < len(kinds) and kinds[n] else ""
        body.append(f"<tr{kind}>{cells}</tr>")
    return (
        f'<div class="wide"><table><thead><tr>{head}</tr></thead><tbody>{"".join(body)}</tbody></table></div>'
    )


def _align(column: int, left: int) -> str:
    return "" if column < left else ' class="n"'


def _cell(value: str | Cell, align: str) -> str:
    if isinstance(value, str):
        return f"<td{align}>{text(value)}</td>"
    kind = f' class="{text(value.kind)}"' if value.kind else align
    if value.share is None:
        return f"<td{kind}>{text(value.text)}</td>"
    width = 100 * min(max(value.share, 0.0), 1.0)
    return f'<td class="meter"><i style="width:{width:.1f}%"></i><span>{text(value.text)}</span></td>'


def section(identity: str, title: str, body: str, *, note: str = "") -> str:
    """A titled part of the page; `note` is a line of explanation under the title."""
    line = f'<p class="note">{prose(note)}</p>' if note else ""
    return f'<section id="{text(identity)}"><h2>{text(title)}</h2>{line}{body}</section>'


def folded(title: str, body: str) -> str:
    """A part of the page that is closed until it is clicked."""
    return f"<details><summary>{text(title)}</summary>{body}</details>"


def chip(rgb: tuple[int, int, int], words: str, *, faded: bool = False) -> str:
    """A coloured dot with words beside it."""
    style = f"background:rgb({rgb[0]},{rgb[1]},{rgb[2]})"
    return f'<span class="chip{" faded" if faded else ""}"><i style="{style}"></i>{text(words)}</span>'


def page(title: str, body: str) -> str:
    """The whole document."""
    style = (Path(__file__).parent / "page.css").read_text(encoding="utf-8")
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<meta name="color-scheme" content="light dark"><link rel="icon" href="data:,">'
        f"<title>{text(title)}</title><style>{style}</style></head><body><main>{body}</main></body></html>\n"
    )


def body_of(document: str) -> str:
    """The body that `page` was given, from the whole document."""
    return document.partition("<main>")[2].rpartition("</main>")[0]

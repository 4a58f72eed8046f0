"""What every experiment leaves behind: numbers as JSON, figures as PNG, and one page that shows both."""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rpl_data.files import write_bytes, write_json, write_text
from rpl_data.report.html import page, text

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def write_results(
    out: Path,
    name: str,
    *,
    title: str,
    data: Mapping[str, Any],
    sections: Sequence[str],
    note: str = "",
    figures: Mapping[str, bytes] | None = None,
) -> Path:
    """Write `<name>.json`, `<name>.html` and one PNG per figure into `out`; the page's path comes back.

    Args:
        data: the numbers; NaN is written as null.
        sections: parts of the page, made of `rpl_data.report.html.section` and `picture`.
        note: a line under the title.
        figures: PNG bytes by file name without suffix.
    """
    write_json(out / f"{name}.json", finite_or_none(dict(data)))
    for figure, content in (figures or {}).items():
        write_bytes(out / f"{figure}.png", content)
    head = f'<header><h1>{text(title)}</h1><p class="sub">{text(note)}</p></header>'
    path = out / f"{name}.html"
    write_text(path, page(title, head + "".join(sections)))
    return path


def picture(png: bytes, caption: str) -> str:
    """Embed a figure in the page, so that the page can be passed on alone."""
    source = "data:image/png;base64," + base64.b64encode(png).decode("ascii")
    return f'<figure class="chart"><img alt="{text(caption)}" src="{source}">' + (
        f"<figcaption>{text(caption)}</figcaption></figure>"
    )


def png_of(figure: Figure) -> bytes:
    """Render a matplotlib figure as PNG; the same figure gives the same bytes."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=150, bbox_inches="tight", metadata={"Software": None})
    return buffer.getvalue()


def finite_or_none(value: Any) -> Any:
    """Make values ready for JSON: NaN becomes null, tuples become lists."""
    if isinstance(value, Mapping):
        return {str(key): finite_or_none(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite_or_none(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value

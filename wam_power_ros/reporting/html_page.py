# SPDX-License-Identifier: Apache-2.0
"""Self-contained HTML page of a report, in light or dark mode, on a wide screen or a phone.

The parts are the macros of `page.html.j2`. They escape every text; what is HTML is `Markup`:

    page(title, body): a complete document of the parts in `body`
    section(title, text, content): paragraphs, of which empty ones are omitted, then `content`
    items(text): a list
    figure(content, caption)
    image(data, alt, kind, style): a picture within the page, of a media type; the style "drawn" is
        of lines and text on white, whose colours are inverted in dark mode
    cards(values): a row of large values: (label, value)
    table(head, rows, caption, good, best): numbers are aligned to the right; `good` are indices of
        tinted rows, `best` highlighted cells (row, column).
"""

from __future__ import annotations

import base64
import re
from collections.abc import Sequence

import jinja2
from markupsafe import Markup

TEXT = re.compile(r"\W*[^\W\d]|.*[^\W\d]{4}")  # begins with a letter, or contains a word


def anchor(title: str) -> str:
    """Anchor of the section with this title."""
    return "-".join("".join(c if c.isalnum() else " " for c in title.lower()).split())


def _columns(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Style of each column: of text, or of numbers."""
    return ["text" if any(TEXT.match(row[k]) for row in rows) else "" for k in range(len(head))]


TEMPLATES = jinja2.Environment(
    loader=jinja2.PackageLoader("wam_power_ros", "reporting"),
    autoescape=True,
    undefined=jinja2.StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
    extensions=["jinja2.ext.do"],
)
TEMPLATES.filters |= {
    "anchor": anchor,
    "base64": lambda data: base64.b64encode(data).decode(),
    "classed": lambda name: Markup(' class="{}"').format(name) if name else "",
    "columns": _columns,
}
_PARTS = TEMPLATES.get_template("page.html.j2").module
page, section, items, figure = _PARTS.page, _PARTS.section, _PARTS.items, _PARTS.figure
image, cards, table = _PARTS.image, _PARTS.cards, _PARTS.table

# SPDX-License-Identifier: Apache-2.0
"""Self-contained HTML page of a report, in light or dark mode, on a wide screen or a phone.

Text arguments are escaped here; arguments that are HTML are documented as such.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Collection, Sequence
from html import escape
from string import Template

TEXT = re.compile(r"\W*[^\W\d]|.*[^\W\d]{4}")  # begins with a letter, or contains a word


def page(title: str, body: Sequence[str]) -> str:
    """A complete HTML document; `body` is HTML."""
    return PAGE.substitute(title=escape(title), body="\n".join(part for part in body if part))


def section(title: str, text: Sequence[str] = (), content: str = "") -> str:
    """HTML of a titled section: paragraphs, then `content`, which is HTML."""
    return (
        f'<section id="{anchor(title)}"><h2>{escape(title)}</h2>'
        f"{paragraphs(text)}{content}</section>"
    )


def anchor(title: str) -> str:
    """Anchor of the section with this title."""
    return "-".join("".join(c if c.isalnum() else " " for c in title.lower()).split())


def paragraphs(text: Sequence[str]) -> str:
    """HTML of paragraphs; empty ones are omitted."""
    return "".join(f"<p>{escape(part)}</p>" for part in text if part)


def items(text: Sequence[str]) -> str:
    """HTML of a list."""
    return f"<ul>{''.join(f'<li>{escape(part)}</li>' for part in text)}</ul>"


def image(data: bytes, alt: str, kind: str = "image/svg+xml", style: str = "") -> str:
    """HTML of a picture embedded in the page.

    Args:
        data: Content of the picture.
        alt: Description for who does not see it.
        kind: Media type.
        style: Class of the element; "drawn" for lines and text on white, whose colours are
            inverted in dark mode.
    """
    coded = base64.b64encode(data).decode()
    img = f'<img alt="{escape(alt)}"{_class(style)} src="data:{kind};base64,{coded}">'
    return f'<div class="wide picture" tabindex="0">{img}</div>' if style == "drawn" else img


def figure(content: str, caption: str) -> str:
    """HTML of `content`, which is HTML, with a caption below it."""
    return f"<figure>{content}<figcaption>{escape(caption)}</figcaption></figure>"


def cards(values: Sequence[tuple[str, str]]) -> str:
    """HTML of a row of large values with their labels: (label, value)."""
    items = "".join(f"<div><b>{escape(v)}</b><span>{escape(k)}</span></div>" for k, v in values)
    return f'<div class="cards">{items}</div>'


def table(
    head: Sequence[str],
    rows: Sequence[Sequence[str]],
    caption: str = "",
    good: Collection[int] = (),
    best: Collection[tuple[int, int]] = (),
) -> str:
    """HTML of a table that scrolls horizontally if too wide; numbers are aligned to the right.

    Args:
        head: Names of the columns.
        rows: Cells; each row as long as the head.
        caption: Text above the table.
        good: Indices of tinted rows.
        best: Highlighted cells (row, column).

    Raises:
        ValueError: A row and the head differ in length.
    """
    for row in rows:
        if len(row) != len(head):
            raise ValueError(f"row of {len(row)} cells in a table of {len(head)} columns: {row}")
    text = [any(TEXT.match(row[k]) for row in rows) for k in range(len(head))]

    def cell(kind: str, content: str, column: int, marked: bool = False) -> str:
        style = " ".join(["text"] * text[column] + ["best"] * marked)
        return f"<{kind}{_class(style)}>{escape(content)}</{kind}>"

    top = "".join(cell("th", name, k) for k, name in enumerate(head))
    body = "".join(
        f"<tr{_class('good' if r in good else '')}>"
        + "".join(cell("td", content, k, (r, k) in best) for k, content in enumerate(row))
        + "</tr>"
        for r, row in enumerate(rows)
    )
    above = f"<caption>{escape(caption)}</caption>" if caption else ""
    return f'<div class="wide" tabindex="0"><table>{above}<tr>{top}</tr>{body}</table></div>'


def _class(name: str) -> str:
    return f' class="{name}"' if name else ""


PAGE = Template("""<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>$title</title>
<style>
  :root { color-scheme: light dark; --ink: #24292f; --paper: #fff; --quiet: #57606a;
          --line: #e3e6ea; --blue: #3b6ea5; --tint: #f6f8fa; --green: #2f855a;
          --red: #b4455a; --shade: #0003; }
  @media (prefers-color-scheme: dark) {
    :root { --ink: #dfe3e8; --paper: #15191e; --quiet: #98a2ad; --line: #30363d; --blue: #7fb0e3;
            --tint: #1d232a; --green: #6cc497; --red: #e58a9b;
            --shade: #fff5; }
    img { background: #fff; }
    img.drawn { filter: invert(.92) hue-rotate(180deg); }
  }
  body { font: 16px/1.55 system-ui, sans-serif; color: var(--ink); background: var(--paper);
         max-width: 62rem; margin: 2.5rem auto; padding: 0 1.2rem; }
  h1 { font-size: 1.7rem; line-height: 1.25; margin: 0 0 1.2rem; }
  h2 { font-size: 1.25rem; margin: 3rem 0 .5rem; }
  h3 { font-size: 1.02rem; margin: 2rem 0 .3rem; }
  p, li { margin: .4rem 0 .8rem; max-width: 46rem; }
  li { margin: .15rem 0; }
  ul { padding-left: 1.2rem; }
  a { color: var(--blue); }
  img { display: block; max-width: 100%; height: auto; margin: .6rem 0; border-radius: .4rem; }
  figure { margin: 1.2rem 0 1.8rem; }
  figcaption, caption { color: var(--quiet); font-size: .85rem; max-width: 46rem; }
  caption { text-align: left; white-space: normal; padding-bottom: .4rem; }
  .cards { display: flex; flex-wrap: wrap; gap: .8rem; margin-bottom: 1.2rem; }
  .cards div { flex: 1 1 7rem; padding: .8rem 1rem; border: 1px solid var(--line);
               border-radius: .5rem; }
  .cards b { display: block; font-size: 1.5rem; color: var(--blue); }
  .cards span, .quiet { color: var(--quiet); font-size: .85rem; }
  nav { display: flex; flex-wrap: wrap; gap: .3rem 1.2rem; margin: 0 0 1.4rem;
        font-size: .9rem; }
  .wide { overflow-x: auto; margin: 1rem 0 1.4rem; scrollbar-width: thin;
          background: linear-gradient(90deg, var(--paper) 30%, transparent) 0 0,
                      linear-gradient(270deg, var(--paper) 30%, transparent) 100% 0,
                      linear-gradient(90deg, var(--shade), transparent) 0 0,
                      linear-gradient(270deg, var(--shade), transparent) 100% 0;
          background-repeat: no-repeat; background-attachment: local, local, scroll, scroll;
          background-size: 2rem 100%, 2rem 100%, .8rem 100%, .8rem 100%; }
  .picture { background: none; }
  table { border-collapse: collapse; font-size: .82rem; white-space: nowrap;
          font-variant-numeric: tabular-nums; }
  th, td { text-align: right; padding: .26rem .7rem; border-bottom: 1px solid var(--line); }
  th:first-child, td:first-child { padding-left: .2rem; }
  th { color: var(--quiet); font-weight: 600; vertical-align: bottom; }
  .text { text-align: left; }
  td.text:last-child { white-space: normal; min-width: 16rem; }
  .best { font-weight: 700; color: var(--green); }
  .good td { background: color-mix(in srgb, var(--green) 12%, transparent); }
  .claims { width: 100%; white-space: normal; font-size: .86rem; }
  .claims td, .claims th { text-align: left; vertical-align: top; padding: .5rem .6rem; }
  .claims th[colspan] { color: var(--ink); padding-top: 1.3rem; }
  .claims small { display: block; color: var(--quiet); margin-top: .2rem; }
  .met { color: var(--green); font-weight: 700; white-space: nowrap; }
  .missed { color: var(--red); font-weight: 700; white-space: nowrap; }
  .reported { color: var(--quiet); white-space: nowrap; }
  @media screen and (max-width: 46rem) {
    body { margin-top: 1.2rem; }
    img.drawn { min-width: 34rem; }
    td.text:last-child { min-width: 12rem; }
    .claims thead { display: none; }
    .claims th[colspan] { display: block; border: 0; padding: .8rem 0 0; font-size: 1rem; }
    .claims tr { display: block; border-bottom: 1px solid var(--line); padding: .7rem 0; }
    .claims td { display: flex; gap: .8rem; border: 0; padding: .08rem 0; }
    .claims td::before { content: attr(data-head); flex: 0 0 5.2rem; color: var(--quiet);
                        font-weight: 400; }
    .claims td:first-child { display: block; font-weight: 600; padding-bottom: .3rem; }
    .claims td:first-child::before { content: none; }
    .claims small { font-weight: 400; }
    .claims td:empty { display: none; }
  }
  @media screen and (max-width: 36rem) {
    caption { max-width: calc(100vw - 2.6rem); }
    .picture::before { content: "↔ scroll sideways"; position: sticky; left: 0;
                       color: var(--quiet); font-size: .8rem; }
  }
  @media print { .wide { overflow: visible; background: none; }
                 table { font-size: .62rem; white-space: normal; }
                 th, td { padding: .2rem .3rem; } td.text:last-child { min-width: 0; }
                 img, tr { break-inside: avoid; }
                 body { max-width: none; } section { break-inside: auto; }
                 figure { break-inside: avoid; } }
  pre { font-size: .8rem; overflow-x: auto; background: var(--tint); padding: 1rem; }
  summary { cursor: pointer; margin-top: 2rem; color: var(--quiet); }
</style>
<h1>$title</h1>
$body
</html>
""")

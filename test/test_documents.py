# SPDX-License-Identifier: Apache-2.0
"""The documents are short: words of a page, sentences, paragraphs, tables; and figures are true."""

import importlib.util
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
DOORS = ["docs/tutorial.md", "docs/hardware.md", "docs/research.md", "CONTRIBUTING.md"]
INDEX = (ROOT / "docs/index.md").read_text()
PAGES = [
    "README.md",
    "CONTRIBUTING.md",
    *(str(p.relative_to(ROOT)) for p in ROOT.glob("docs/**/*.md")),
]
AS_THEY_ARE = ("docs/decisions", "docs/references.md")  # records of their time; citations
PROSE = [page for page in PAGES if not page.startswith(AS_THEY_ARE)]
CODE = re.compile(r"^( *)```.*?^ *```|^<!--.*?-->", re.DOTALL | re.MULTILINE)
# Words; "how" has the requirements. Arms that take positions: a page, three rows, a table.
# +350, +149: a second way to an FR3, the drivers that are served, the makers' libraries.
BUDGET = {"use": 12572, "how": 8240, "evidence": 6000}
WORDS, SENTENCES, WIDTH = 25, 5, 200  # of a sentence, a paragraph, a line of a table


def read(page: str) -> str:
    return (ROOT / page).read_text()


def count(*pages: str) -> int:
    """Words of pages, tables included; bars of tables and blocks of code are not words."""
    texts = (CODE.sub("\n", read(page)) for page in pages)
    return sum(bool(re.search(r"\w", word)) for text in texts for word in text.split())


def listed(part: str) -> list[str]:
    """Pages of a table of the index, by a word of its head."""
    table = re.search(rf"\| [^|]*{part}.*?\n\n", f"{INDEX}\n\n", re.DOTALL)
    assert table is not None
    names = re.findall(r"\]\(([^)#]+\.md)\)", table[0])
    return [f"docs/{name}" for name in names if not name.startswith("../")]


def paragraphs(text: str) -> list[str]:
    """Paragraphs and entries of lists, without code, tables, headings and figures."""
    text = CODE.sub("\n", text)
    found: list[list[str]] = [[]]
    for line in text.splitlines():
        entry = re.match(r"\s*(?:[*-]|\d+\.)\s", line)
        apart = not line.strip() or line.startswith(("#", "|", "![")) or line[:4].isspace()
        if apart or entry:
            found.append([])
        if not apart or (line.strip() and found[-1]):
            found[-1].append(line.strip(" >*-" if entry else " >"))
    return [" ".join(lines) for lines in found if lines]


def sentences(paragraph: str) -> list[str]:
    """Sentences of a paragraph; code counts as a word."""
    plain = re.sub(r"!?\[([^]]*)\]\([^)]*\)", r"\1", paragraph)
    plain = re.sub(r"`[^`]*`", "Code", plain).replace("*", "")
    return re.split(r"(?<=[.?!])(?<![a-z,.] [A-Z]\.)[)\"]?\s+(?=[A-Z0-9(\"'])", plain)


def too_long(text: str) -> list[str]:
    parts = paragraphs(text)
    long = [s for part in parts for s in sentences(part) if len(s.split()) > WORDS]
    return long + [part for part in parts if len(sentences(part)) > SENTENCES]


@pytest.mark.parametrize("page", PROSE)
def test_a_sentence_has_at_most_25_words_and_a_paragraph_five_sentences(page: str) -> None:
    assert too_long(read(page)) == []


def test_a_long_sentence_and_a_long_paragraph_are_found() -> None:
    assert too_long(f"* One. {'word ' * 26}end.\n") and too_long("A is b. " * 6)
    assert not too_long(f"```\n{'word ' * 40}\n```\n\n{'Word ' * 24}`a b c`.\n\n# {'head ' * 40}\n")


# Rows of requirements say all that is required.
@pytest.mark.parametrize("page", [page for page in PROSE if page != "docs/safety.md"])
def test_no_line_of_a_table_is_longer_than_200_characters(page: str) -> None:
    rows = [line for line in read(page).splitlines() if line.startswith("|")]
    assert [row for row in rows if len(row) > WIDTH] == []


def test_the_readme_has_at_most_900_words_and_every_door_1500_with_three_figures() -> None:
    assert count("README.md") <= 900
    assert {door: count(door) for door in DOORS if count(door) > 1500} == {}
    figures = {door: len(re.findall(r"!\[[^]]+\]\(|```mermaid", read(door))) for door in DOORS}
    assert {door: n for door, n in figures.items() if n < 3} == {}


def test_what_there_is_to_read_keeps_its_budget() -> None:
    assert count(*DOORS[:-1], *listed("how to use it")) <= BUDGET["use"]
    assert count(*listed("how it works")) <= BUDGET["how"]
    evidence = [page for page in PAGES if page.startswith("docs/evidence")]
    assert count(*evidence) <= BUDGET["evidence"]


def test_where_it_fails_is_as_long_as_where_it_works() -> None:
    fails, works = (count(f"docs/evidence/where_it_{verb}.md") for verb in ("fails", "works"))
    assert fails >= works > 300


def test_every_page_is_in_the_index_and_every_picture_in_a_page() -> None:
    pages = {page for page in PAGES if page.startswith("docs/")} - {"docs/index.md"}
    decisions = {page for page in pages if page.startswith("docs/decisions/")}
    named = {f"docs/{name}" for name in re.findall(r"\]\(([^)#]+\.md)", INDEX)}
    assert pages - decisions <= named
    shown = "".join(map(read, PAGES))
    unused = [
        p.name for p in (ROOT / "docs/pictures").iterdir() if f"pictures/{p.name}" not in shown
    ]
    assert unused == []


def test_every_page_is_found_from_the_navigation_of_the_site() -> None:
    shown = read("docs/mkdocs.yml")
    others = ["bags/README.md", "benchmark/README.md", "examples/README.md"]
    pages = [page for page in PAGES if not re.match(r"docs/decisions/\d", page)]
    assert [page for page in [*pages, *others] if f" {page}\n" not in shown] == []


def test_a_term_that_a_door_introduces_is_in_the_glossary() -> None:
    entries = re.findall(r"^\| ([^|]+) \|", read("docs/glossary.md"), re.MULTILINE)
    known = [word.strip() for entry in entries for word in entry.split(",")]
    shown = "".join(CODE.sub("\n", read(door)) for door in ["README.md", *DOORS])
    terms = re.findall(r"(?<![*\w])\*(?!\*)([A-Za-z][^*\n]{1,30})\*(?!\*)", shown)
    assert len(terms) > 5
    assert [term for term in terms if not any(term.startswith(word) for word in known)] == []


def test_every_table_of_results_is_that_of_its_file() -> None:
    if importlib.util.find_spec("joblib") is None:
        pytest.skip("the studies need joblib")
    from reproduction.documents import TABLE, with_tables

    pages = [page for page in PAGES if TABLE.search(read(page))]
    assert pages == ["docs/evidence/flip.md"]
    assert [page for page in pages if with_tables(read(page)) != read(page)] == []

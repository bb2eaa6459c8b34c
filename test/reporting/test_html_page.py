# SPDX-License-Identifier: Apache-2.0
"""The page of a report escapes every text and needs no other file."""

from wam_power_ros.reporting import html_page


def test_every_text_is_escaped_and_html_is_not() -> None:
    html = html_page.section("a < b", ["c & d", ""], html_page.table(["<x>"], [["1 > 0"]]))
    assert "<h2>a &lt; b</h2>" in html and "<p>c &amp; d</p>" in html
    assert html.count("<p>") == 1  # no empty paragraph
    assert "&lt;x&gt;" in html and "1 &gt; 0" in html and "<table>" in html


def test_a_column_of_text_is_set_left_and_one_of_numbers_is_not() -> None:
    html = html_page.table(["name", "value"], [["full", "0.7"], ["0.5", "-1"]], best={(0, 1)})
    assert '<th class="text">name</th>' in html and "<th>value</th>" in html
    assert '<td class="best">0.7</td>' in html


def test_a_page_is_one_document_whose_sections_are_found_by_their_anchors() -> None:
    html = html_page.page("R & D", [html_page.items(["x"]), "", "a < b"])
    assert "<ul><li>x</li></ul>\na &lt; b" in html
    assert html.startswith("<!doctype html>") and "<title>R &amp; D</title>" in html
    assert html_page.image(b"x", '"', "image/png").startswith('<img alt="&#34;" src="data:image/')
    title = "Taught on the arm, and executed by it"
    assert html_page.anchor(title) == "taught-on-the-arm-and-executed-by-it"
    assert f'id="{html_page.anchor(title)}"' in html_page.section(title)

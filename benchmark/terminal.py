# SPDX-License-Identifier: Apache-2.0
"""Options and tables of the benchmarks."""

from __future__ import annotations

import argparse


def options(doc: str | None, **wanted: float | list[str]) -> argparse.Namespace:
    """Read the options of a benchmark from the command line; `doc` is the text of `--help`.

    `wanted` has the default of each option. False makes it a switch; of a list the user may name
    some words.
    """
    kind = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=doc, formatter_class=kind)
    for name, default in wanted.items():
        if default is False:
            parser.add_argument(f"--{name}", action="store_true")
        elif isinstance(default, list):
            parser.add_argument(f"--{name}", nargs="+", choices=default, default=default)
        else:
            parser.add_argument(f"--{name}", type=type(default), default=default)
    return parser.parse_args()


def table_row(*cells: object) -> str:
    """Line of a Markdown table."""
    return f"| {' | '.join(map(str, cells))} |"


def table_head(*titles: str) -> str:
    """First two lines of a Markdown table."""
    return f"{table_row(*titles)}\n|{'---|' * len(titles)}"

# SPDX-License-Identifier: Apache-2.0
"""The notebook runs from its first cell to its last, and shows what it says."""

import contextlib
import io
import json
import re
from typing import Any

import pytest
from conftest import ROOT

CELLS = json.loads((ROOT / "examples/skills.ipynb").read_text())["cells"]
CODE = [cell for cell in CELLS if cell["cell_type"] == "code"]


def shown(cell: dict[str, Any]) -> str:
    """What a cell printed when the notebook was saved."""
    return "".join("".join(output.get("text", "")) for output in cell["outputs"])


def test_the_notebook_was_saved_with_its_figures_and_without_an_error() -> None:
    kinds = [kind for cell in CODE for output in cell["outputs"] for kind in output.get("data", ())]
    assert kinds.count("image/png") == 3
    assert "error" not in {output["output_type"] for cell in CODE for output in cell["outputs"]}


@pytest.mark.long
def test_every_cell_runs_and_prints_lines_like_those_that_were_saved(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("MPLBACKEND", "agg")  # nbclient is none of the requirements of the tests
    names: dict[str, Any] = {}
    for number, cell in enumerate(CODE):
        with contextlib.redirect_stdout(io.StringIO()) as printed:
            exec(compile("".join(cell["source"]), f"cell {number}", "exec"), names)
        # A session may need one rollout more on another machine: each kind of line counts once.
        without = [re.sub(r"[\d.]+", "0", text) for text in (printed.getvalue(), shown(cell))]
        assert {*without[0].splitlines()} == {*without[1].splitlines()}
    found = {key: float(value) for key, value in re.findall(r"'(\w+)': ([\d.]+)", shown(CODE[3]))}
    assert names["finals"] == pytest.approx(found, abs=0.1)
    assert names["miss"](names["learnt"]) < 0.03

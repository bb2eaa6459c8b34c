# SPDX-License-Identifier: Apache-2.0
"""Errors of `wam-power view`; `test/view` tests the page itself."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from wam_power_ros.cli import main


def refusal(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main.main(["view", *arguments]) == 2
    return capsys.readouterr().err


def test_without_viser_it_says_how_to_install_it(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in [name for name in sys.modules if name.startswith("wam_power_ros.view")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "viser", None)
    assert refusal(capsys).endswith('pip install "wam_power_ros[view]"\n')


def test_what_is_neither_a_session_nor_a_bag_is_refused(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    pytest.importorskip("viser", reason="no viser")
    assert "typo holds no session" in refusal(capsys, str(tmp_path / "typo"))
    assert "is not a bag" in refusal(capsys, str(tmp_path), "--port", "0")


def test_an_address_that_is_not_of_this_machine_is_refused(
    capsys: pytest.CaptureFixture[str],
) -> None:
    pytest.importorskip("viser", reason="no viser")
    bag = Path(__file__).resolve().parents[2] / "bags/reach_20261121_141024"
    assert "192.0.2.1" in refusal(capsys, str(bag), "--address", "192.0.2.1")


def test_nothing_of_the_library_is_printed_with_a_refusal(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    pytest.importorskip("viser", reason="no viser")
    (tmp_path / "README.md").write_text("# no bag\n")
    assert main.main(["view", str(tmp_path / "README.md"), "--port", "0"]) == 2
    out, err = capsys.readouterr()
    assert out == "" and "README.md" in err and "bag" in err

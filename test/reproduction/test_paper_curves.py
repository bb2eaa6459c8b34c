# SPDX-License-Identifier: Apache-2.0
"""Results of the paper, digitised."""

import pytest

from reproduction.paper_curves import FIG5, K33


def test_the_papers_tables_hold_its_anchors() -> None:
    assert FIG5.shape == (50, 2)
    assert FIG5[:5, 1].mean() == pytest.approx(0.683, abs=0.001)
    assert FIG5[-5:, 1].mean() == pytest.approx(1.034, abs=0.001)
    assert K33[0].tolist() == [0.0, 322.6]

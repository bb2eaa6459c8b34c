# SPDX-License-Identifier: Apache-2.0
"""Invalid paths are refused with value and rule; faults are attributed to policies."""

from typing import Any

import numpy as np
import pytest

from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath, Rollout

T = np.array([0.0, 0.01, 0.03])
LEVEL = np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))


def path(kind: type[EndEffectorPath] | type[BodyPath] = BodyPath, **change: object) -> Any:  # noqa: ANN401
    return kind(**{"id": "a", "t": T, "position": np.zeros((3, 3)), "quat_xyzw": LEVEL, **change})


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"id": "a/b"}, "id 'a/b'"),
        ({"t": [0.0, 0.02, 0.02]}, r"path a: t\[2\] = 0.02 follows 0.02; it must increase"),
        ({"t": [0.0, np.nan, 1.0]}, r"path a: t\[1\] = nan"),
        ({"position": np.zeros((2, 3))}, r"path a: position has shape \(2, 3\)"),
        ({"quat_xyzw": LEVEL * [[1.0], [1.002], [0.9]]}, r"quat_xyzw\[1\] has length 1.002"),
        ({"quat_xyzw": LEVEL * [[1.0], [1.0], [0.998]]}, r"quat_xyzw\[2\] has length 0.998"),
    ],
)
def test_a_wrong_path_cannot_exist(change: dict[str, Any], words: str) -> None:
    for kind in (EndEffectorPath, BodyPath):
        with pytest.raises(ValueError, match=words):
            path(kind, **change)


def test_a_body_may_never_have_been_seen_and_a_tool_has_at_least_one_pose() -> None:
    nothing = {"t": np.zeros(0), "position": np.zeros((0, 3)), "quat_xyzw": np.zeros((0, 4))}
    assert len(path(**nothing).t) == 0
    with pytest.raises(ValueError, match="end-effector path a is empty"):
        path(EndEffectorPath, **nothing)
    one = {"t": T[:1], "position": np.zeros((1, 3)), "quat_xyzw": LEVEL[:1]}
    assert len(path(EndEffectorPath, **one).t) == 1


def test_the_two_paths_of_a_rollout_are_of_one_policy() -> None:
    tool = path(EndEffectorPath)
    assert Rollout(tool).body is None and Rollout(tool).fault is None
    assert Rollout(tool, path()).body.id == "a"
    with pytest.raises(ValueError, match="body path of rollout 'b', but tool path of 'a'"):
        Rollout(tool, path(id="b"))

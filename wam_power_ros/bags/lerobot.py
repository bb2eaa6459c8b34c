# SPDX-License-Identifier: Apache-2.0
"""Sets of LeRobot, format 3.0: written from movements, and read as a demonstration, without torch.

The format is that of `LeRobotDataset` in lerobot 0.4. A frame has "observation.state": angle [rad],
speed [rad/s] of each joint, and pose of the tool; and "action": the angles of the next frame. A
recording by hand has no commands, so that only the angles that follow mean the same in every set.
"""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from wam_power_ros import durable_files, plain_json
from wam_power_ros.bags import table

STATE, ACTION, EPISODE, TIME = "observation.state", "action", "episode_index", "timestamp"
INFO = "meta/info.json"
PATH, FIRST = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet", "chunk-000/file-000.parquet"
QUANTILES = (0.01, 0.1, 0.5, 0.9, 0.99)


class Episode(NamedTuple):
    """An evenly sampled movement: states (N, m), actions (N, n), and its task in a sentence."""

    task: str
    state: np.ndarray
    action: np.ndarray


def episode(
    task: str,
    t: np.ndarray,
    q: np.ndarray,
    fps: int,
    tool_pose: Callable[[np.ndarray], Sequence[float]] | None,
) -> Episode:
    """Sample a smooth movement, of times from 0 [s] (K,) and joint angles [rad] (K, n), evenly.

    `tool_pose` maps angles to a position [m] and a quaternion xyzw, whose sign may jump.
    """
    at = np.arange(int(t[-1] * fps + 1e-9) + 1) / fps
    speeds = np.gradient(q, t, axis=0)
    angles, qd = (np.column_stack([np.interp(at, t, of) for of in x.T]) for x in (q, speeds))
    state = [angles, qd]
    if tool_pose:
        poses = np.array([tool_pose(row) for row in angles])
        turned = np.sum(poses[1:, 3:] * poses[:-1, 3:], axis=1) < 0.0
        poses[1:, 3:] *= np.where(np.cumsum(turned) % 2, -1.0, 1.0)[:, None]
        state.append(poses)
    return Episode(task, np.hstack(state), np.vstack([angles[1:], angles[-1:]]))


def write(
    episodes: Sequence[Episode], to: Path, joint_names: Sequence[str], fps: int, robot: str
) -> int:
    """Write a set into a new folder, which has its name when it is complete.

    Returns:
        Number of frames.

    Raises:
        ValueError: pyarrow is missing.
        OSError: The folder exists or cannot be written; what was written is removed.
    """
    check_new(to)
    tasks = list(dict.fromkeys(each.task for each in episodes))
    each, rows, count = [], [], 0
    for number, of in enumerate(episodes):
        each.append(found := _frames(of, number, count, fps, tasks))
        first, count = count, count + len(of.state)
        row: dict[str, Any] = {EPISODE: number, "tasks": [of.task], "length": len(of.state)}
        row |= {"dataset_from_index": first, "dataset_to_index": count}
        for file in ("data", "meta/episodes"):
            row |= {f"{file}/chunk_index": 0, f"{file}/file_index": 0}
        for key, statistics in _statistics(found).items():
            row |= {f"stats/{key}/{name}": value for name, value in statistics.items()}
        rows.append(row)
    frames = {key: np.concatenate([of[key] for of in each]) for key in each[0]}
    names = [f"{name}.{part}" for part in ("pos", "vel") for name in joint_names]
    names += [f"tool.{part}" for part in table.POSE]
    named = {STATE: names[: frames[STATE].shape[1]], ACTION: names[: len(joint_names)]}
    features = {}
    for key, values in frames.items():
        shape = [math.prod(values.shape[1:])]
        features[key] = {"dtype": str(values.dtype), "shape": shape, "names": named.get(key)}
    info = {
        "codebase_version": "v3.0",
        "robot_type": robot,
        "total_episodes": len(episodes),
        "total_frames": count,
        "total_tasks": len(tasks),
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": fps,
        "splits": {"train": f"0:{len(episodes)}"},
        "data_path": f"data/{PATH}",
        "video_path": None,
        "features": features,
    }
    part = to.with_name(f".{to.name}.part")
    try:
        _write_files(part, frames, rows, tasks)
        for name, value in ((INFO, info), ("meta/stats.json", _statistics(frames))):
            (part / name).write_text(json.dumps(value, indent=4), encoding="utf-8")
        for path in (*part.rglob("*"), part):
            durable_files.sync(path)
        part.rename(to)
    finally:
        shutil.rmtree(part, ignore_errors=True)
    durable_files.sync(to.parent)
    return count


def check_new(to: Path) -> None:
    """Check that a set can be written.

    Raises:
        ValueError: pyarrow is missing.
        FileExistsError: The folder exists.
    """
    if to.exists():
        raise FileExistsError(f"{to} exists already; name another folder")
    table.require_pyarrow()


def _frames(
    of: Episode, number: int, first: int, fps: int, tasks: Sequence[str]
) -> dict[str, np.ndarray]:
    """Columns of the frames of an episode, whose first one has this index in the set."""
    index = np.arange(len(of.state))
    return {
        STATE: of.state.astype(np.float32),
        ACTION: of.action.astype(np.float32),
        TIME: (index / fps).astype(np.float32),
        "frame_index": index,
        EPISODE: np.full_like(index, number),
        "task_index": np.full_like(index, tasks.index(of.task)),
        "index": first + index,
    }


def _statistics(frames: Mapping[str, np.ndarray]) -> dict[str, dict[str, list[float]]]:
    """Statistics of each column, by which LeRobot normalizes."""
    found = {}
    for key, values in frames.items():
        rows = values.reshape(len(values), -1).astype(float)
        of = {name: getattr(rows, name)(axis=0) for name in ("min", "max", "mean", "std")}
        of["count"] = np.array([len(rows)])
        of |= {f"q{100 * p:02.0f}": np.quantile(rows, p, axis=0) for p in QUANTILES}
        found[key] = {name: value.tolist() for name, value in of.items()}
    return found


def _write_files(
    to: Path,
    frames: Mapping[str, np.ndarray],
    episodes: Sequence[Mapping[str, Any]],
    tasks: Sequence[str],
) -> None:
    import pyarrow
    from pyarrow import parquet

    def array(values: np.ndarray) -> pyarrow.Array:
        flat = pyarrow.array(values.ravel())
        width = values.shape[1:]
        return pyarrow.FixedSizeListArray.from_arrays(flat, *width) if width else flat

    task = {"name": "task", "field_name": "task", "pandas_type": "unicode", "numpy_type": "object"}
    index = {"index_columns": ["task"], "column_indexes": [], "columns": [task | {"metadata": {}}]}
    columns = {"task_index": range(len(tasks)), "task": tasks}  # the frame of pandas that it reads
    tables = {
        f"data/{FIRST}": pyarrow.table({key: array(of) for key, of in frames.items()}),
        f"meta/episodes/{FIRST}": pyarrow.Table.from_pylist(episodes),
        "meta/tasks.parquet": pyarrow.table(columns).replace_schema_metadata(
            {"pandas": json.dumps(index)}
        ),
    }
    for name, of in tables.items():
        (to / name).parent.mkdir(parents=True, exist_ok=True)
        parquet.write_table(of, to / name)


def is_set(path: Path) -> bool:
    """Whether a folder is a set of LeRobot."""
    return (path / INFO).is_file()


def as_bag(path: Path, folder: Path, number: int | None, unit: float = 1.0) -> Path:
    """Write the joint angles of an episode, format 2.1 or 3.0, into a folder, as a bag.

    The episode has a number from 0, None for the only one; its angles are in that many rad.

    Raises:
        ValueError: The set is damaged, or has no such episode or no state.
    """
    try:
        return table.to_bag(_columns(path, number), folder / path.resolve().name, unit)
    except (KeyError, TypeError, AttributeError) as error:
        why = f"{type(error).__name__}: {error}"
        raise ValueError(f"{path} cannot be read as a set of LeRobot: {why}") from error
    except ValueError as error:
        raise ValueError(f"{path}: {str(error).removeprefix(f'{path}: ')}") from error


def _columns(path: Path, number: int | None) -> list[tuple[str, Sequence[Any]]]:
    """Time [s] and state of an episode, each value with its name."""
    table.require_pyarrow()
    from pyarrow import ArrowException, parquet

    info = plain_json.read(path / INFO)
    last = info["total_episodes"] - 1
    if number is None and last == 0:
        number = 0
    if number is None or not 0 <= number <= last:
        given = "" if number is None else f", and no {number}"
        raise ValueError(f"has {last + 1} episodes{given}; name one: --episode 0 to {last}")
    if STATE not in info["features"]:
        raise ValueError(f"has no {STATE}; its features: {', '.join(info['features'])}")
    names = info["features"][STATE]["names"]
    if isinstance(names, dict):  # as {"motors": [...]}
        names = [name for of in names.values() for name in of]
    try:
        of_episode = [(EPISODE, "=", number)]
        found = parquet.read_table(path / "data", columns=[TIME, STATE], filters=of_episode)
    except (ArrowException, OSError) as error:
        raise ValueError(f"has no readable data: {error}") from None
    states = np.asarray(found[STATE].to_pylist(), dtype=float).reshape(found.num_rows, -1)
    if not states.size or states.shape[1] != len(names or states.T):
        raise ValueError(f"episode {number} has states of shape {states.shape} for {names}")
    names = names or [f"{STATE}.{place}" for place in range(states.shape[1])]
    return [(TIME, found[TIME].to_pylist()), *zip(names, states.T.tolist(), strict=True)]

# SPDX-License-Identifier: Apache-2.0
"""A table of time and joint angles becomes a bag bit for bit, or is refused with what it needs."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from bag_samples import NAMES, START, demonstration, random_q

from wam_power_ros.bags import importing, table
from wam_power_ros.bags.bag import Bag
from wam_power_ros.bags.reader import read_states

Q = random_q(60)
T = 0.004 * np.arange(len(Q))


def written(path: Path, columns: dict[str, object], delimiter: str = ",") -> Path:
    rows = zip(*columns.values(), strict=True)
    lines = [delimiter.join(columns), *(delimiter.join(map(str, row)) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def angles(form: str = "{}") -> dict[str, object]:
    return {form.format(name): q.tolist() for name, q in zip(NAMES, Q.T, strict=True)}


def bag_of(path: Path) -> Bag:
    folder = path.with_suffix(".made")
    folder.mkdir()
    return Bag(table.as_bag(path, folder))


FORMS = ("{}", "q.{}", "{}.pos", "/joint_states/{}/position")


@pytest.mark.parametrize(
    ("time", "form", "delimiter"),
    [
        *((time, "{}", ",") for time in table.TIMES),
        *((table.TIMES[0], form, ",") for form in FORMS[1:]),
        *((table.TIMES[0], "{}", delimiter) for delimiter in (";", "\t")),
    ],
)
def test_a_table_is_read_bit_for_bit(time: str, form: str, delimiter: str, tmp_path: Path) -> None:
    others = {"task": ["pour"] * 60, "qd.wam_j1": [0.5] * 60, "grip": [""] * 60}
    columns = {time: T.tolist(), **others, **angles(form)}
    states = read_states(bag_of(written(tmp_path / "t.csv", columns, delimiter)), NAMES)
    np.testing.assert_array_equal(states.q, Q)
    np.testing.assert_array_equal(states.stamps, 10**9 + 4_000_000 * np.arange(60))


def test_rows_of_other_devices_and_decimal_commas_are_read(tmp_path: Path) -> None:
    lines = [";".join(("", "time", "imu", *NAMES))]
    for number, (t, q) in enumerate(zip(T.tolist(), Q.tolist(), strict=True)):
        lines.append(
            ";".join(map(repr, (number, t, *q))).replace(";", ";;", 2).replace(";;", ";", 1)
        )
        lines.append(f"{number};{t + 0.001!r};0.5" + ";" * len(NAMES))
    (file := tmp_path / "t.csv").write_text("\n".join(lines).replace(".", ","))
    np.testing.assert_array_equal(read_states(bag_of(file), NAMES).q, Q)


@pytest.mark.parametrize("suffix", table.TABLES)
def test_an_exported_bag_comes_back_bit_for_bit(suffix: str, tmp_path: Path) -> None:
    if suffix == ".parquet" and importlib.util.find_spec("pyarrow") is None:
        pytest.skip("needs pyarrow")
    bag = Bag(demonstration(tmp_path / "demo", Q))
    states = read_states(bag, NAMES)
    file = tmp_path / f"t{suffix}"
    table.write(table.joint_columns(bag, states), file)
    made, _ = importing.import_bag(bag_of(file), tmp_path / "ours", NAMES)
    back = read_states(Bag(made), NAMES)
    np.testing.assert_array_equal(back.q, Q)
    np.testing.assert_array_equal(back.stamps, START + 2_000_000 * np.arange(60))


@pytest.mark.parametrize(
    ("columns", "why"),
    [
        ({"clock": T, **angles()}, "a table needs a time, stamp_ns"),
        ({"t": T}, "a column of angles"),
        ({"t": T, "observation.state": ["[0.1 0.2]"] * 60}, r"others: \['observation.state'\]"),
        ({"t": [*T[:30], *T[:30]], **angles()}, "row 32 is 0.0 and follows 0.116.*file of its own"),
        ({"t": [*T[:-1], "inf"], **angles()}, "row 61 is inf"),
        ({"t": [*T[:-1], T[-2]], **angles()}, "row 61 is 0.232 and follows 0.232"),
        ({"t": [*T[:-1], 1e40], **angles()}, "no time of ROS"),
        ({"stamp_ns": [*range(59), 70.5], **angles()}, "stamp_ns of row 61 is '70.5'"),
        ({"t": T, **angles(), "wam_j1": [*[0.0] * 30, *["lost"] * 30]}, "row 32 is 'lost'"),
    ],
)
def test_what_is_no_movement_is_refused_by_row_and_column(
    columns: dict[str, object], why: str, tmp_path: Path
) -> None:
    file = written(tmp_path / "t.csv", columns)
    with pytest.raises(ValueError, match=why) as refusal:
        bag_of(file)
    assert str(refusal.value).startswith(f"{file}: ")


@pytest.mark.parametrize("content", [b"", b"t,a\n", b"t,a\n1\n", b"\xff\xfe\0t", b"\0" * 300])
def test_a_file_that_is_no_table_is_refused(content: bytes, tmp_path: Path) -> None:
    (file := tmp_path / "t.csv").write_bytes(content)
    with pytest.raises(ValueError, match=str(file)):
        bag_of(file)


def test_a_parquet_file_is_read_by_pyarrow_or_not_at_all(tmp_path: Path) -> None:
    (file := tmp_path / "t.parquet").write_bytes(b"PAR1")
    installed = importlib.util.find_spec("pyarrow") is not None
    with pytest.raises(ValueError, match="no Parquet file" if installed else "pip install"):
        bag_of(file)


def test_numbers_in_a_list_are_joints_by_their_place_if_a_person_names_them(tmp_path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    columns = {"timestamp": T, "observation.state": Q.tolist(), "index": [*range(60)]}
    parquet.write_table(pyarrow.table(columns), file := tmp_path / "t.parquet")
    bag = bag_of(file)
    with pytest.raises(ValueError, match=r"it has .*'observation.state.0'.*--joints"):
        read_states(bag, NAMES)
    states = read_states(bag, [f"observation.state.{i}" for i in range(3)])
    np.testing.assert_array_equal(states.q, Q)
